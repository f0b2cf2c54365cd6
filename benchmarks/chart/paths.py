"""gamma(t) as an expression of t: what solvers need that ask for a DAE in t rather than for the path at instants."""

from __future__ import annotations

import math

import casadi as ca

from servocore.model.scene import Scene
from servocore.references.profiles import PolynomialProfile
from servocore.references.rest_to_rest import RestToRest


def straight(scene: Scene) -> RestToRest:
    """Return the path of a scene; raises TypeError if it does not go straight from rest to rest."""
    if not isinstance(scene.reference, RestToRest):
        raise TypeError(f"{scene.name} follows no straight line from rest to rest")
    return scene.reference


def path_jet(reference: RestToRest, t: ca.SX, order: int, *, near_end: bool = True) -> list[ca.SX]:
    """Return gamma, gamma', ..., gamma^(order) as expressions of `t`, each of shape (m,).

    Parameters
    ----------
    reference : RestToRest
        A straight line with a polynomial profile.
    t : casadi.SX
        Symbol of the time; beyond the ends the polynomial goes on, so that solvers may step past them.
    order : int
        Highest derivative.
    near_end : bool
        Expand about the nearer end, which keeps round-off at 1e-16 of the way but needs a case distinction. Without
        it, expand about the start (noise of 1e-12 of the way near the end).

    Raises
    ------
    TypeError
        If the reference is another.
    """
    if not isinstance(reference, RestToRest) or not isinstance(reference.profile, PolynomialProfile):
        raise TypeError("only straight lines with a polynomial profile can be written as expressions")
    start, end = ca.DM(reference.start), ca.DM(reference.end)
    duration, k = reference.duration, reference.profile.smoothness
    elapsed, remaining = (t - reference.start_time) / duration, (reference.end_time - t) / duration
    early = elapsed < remaining if near_end else ca.SX(1)
    x = ca.if_else(early, elapsed, remaining) if near_end else elapsed
    sign = ca.if_else(early, 1, -1) if near_end else ca.SX(1)
    jet = []
    for j in range(order + 1):
        value = _derivative(reference.profile.coefficients, x, j, k) / duration**j
        if j:
            jet.append((end - start) * value * sign ** (j + 1))
        else:
            jet.append(ca.if_else(early, start, end) + sign * (end - start) * value if near_end
                       else start + (end - start) * value)  # fmt: skip
    return jet


def _derivative(coefficients: tuple[int, ...], x: ca.SX, j: int, k: int) -> ca.SX:
    """Return the j-th derivative of a polynomial that starts with x^(k+1), by Horner's rule behind that power."""
    differentiated = [math.perm(i, j) * c for i, c in enumerate(coefficients)][j:]
    lowest = max(k + 1 - j, 0)
    value = ca.SX(0)
    for c in reversed(differentiated[lowest:]):
        value = value * x + c
    return value * x**lowest
