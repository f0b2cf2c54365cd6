"""Quantities of exact inversions by name, as functions of the path."""

from __future__ import annotations

from typing import TypeVar

import casadi as ca

from servocore.formulations.reduced import Reduced
from servocore.methods.base import instantaneous
from servocore.model.quantity import Quantity
from servocore.problem import ResolvedSystem
from servocore.stepping.observation import compile_observation
from servocore.structure.inversion import inversion

Symbol = TypeVar("Symbol", ca.SX, ca.MX)


def compile_inverted_quantities(
    resolved: ResolvedSystem, wanted: list[tuple[Quantity, ca.SX]]
) -> tuple[ca.Function | None, ca.Function]:
    """Compile (gamma, p) -> quantities by exact inversion: as one expression, and by Newton's method.

    The first is NaN where the guess is not exact; None where `Inversion` has no such expression.
    """
    system, dae, inverse = resolved.system, resolved.dae(Reduced()), resolved.once(inversion)
    order = resolved.array.reference_order
    read = compile_observation(system, dae, instantaneous(dae), wanted, order)

    def reading(name: str, inverted: ca.Function, kind: type[Symbol]) -> ca.Function:
        gamma, p = kind.sym("gamma", system.gamma.size1(), order + 1), kind.sym("p", system.p.numel())
        return ca.Function(name, [gamma, p], [read(inverted(gamma, p)[0], gamma, p)[0]], {"cse": kind is ca.SX})

    by_expression = inverse.expression and reading("sc_quick_cases", inverse.expression, ca.SX)
    return by_expression, reading("sc_cases", inverse.function, ca.MX)
