"""Derivatives of exported functions along directions, as functions of their own."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca


def tangent(name: str, arguments: Sequence[ca.MX], results: Sequence[ca.MX], by: Sequence[ca.MX]) -> ca.Function:
    """Compile (arguments, directions of some of them) -> derivatives of the results along them."""
    directions = [ca.MX.sym(f"d{k}", *each.shape) for k, each in enumerate(by)]
    x, direction = ca.veccat(*by), ca.veccat(*directions)
    tangents = [ca.densify(ca.jtimes(result, x, direction)) if result.numel() else result for result in results]
    return ca.Function(name, [*arguments, *directions], tangents)
