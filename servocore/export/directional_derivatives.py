"""Directional derivatives of exported functions, as functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca

from servocore.methods.base import Discretization
from servocore.numerics.square_systems import SquareSystem


def tangent(name: str, arguments: Sequence[ca.MX], results: Sequence[ca.MX], by: Sequence[ca.MX]) -> ca.Function:
    """Compile (arguments, directions of some of them) -> derivatives of the results along them."""
    directions = [ca.MX.sym(f"d{k}", *each.shape) for k, each in enumerate(by)]
    return ca.Function(name, [*arguments, *directions], _along(results, by, directions))


def tangent_of_step(
    name: str,
    step: Discretization,
    arguments: Sequence[ca.MX],
    by: Sequence[ca.MX],
    givens: ca.MX,
    after: ca.MX,
    results: Callable[[ca.MX], Sequence[ca.MX]],
) -> ca.Function:
    """Compile (arguments, directions of some of them) -> derivatives of the next state and of results along them.

    Those of the solution of the step's equations follow from the implicit function theorem, see `_compile_implicit`.

    Parameters
    ----------
    name : str
        Name of the function.
    step : Discretization
        The step; its next state contains its unknowns.
    arguments, by : sequence of casadi.MX
        Symbols, and those among them with directions.
    givens, after : casadi.MX
        Givens of the step's equations and its next state, as expressions of the arguments.
    results : callable
        Next state -> further differentiated results, expressions of it and the arguments.
    """
    equations = step.equations
    directions = [ca.MX.sym(f"d{k}", *each.shape) for k, each in enumerate(by)]
    unknowns = after[_places(equations.unknowns, step.next_state)]
    unknowns_along = _compile_implicit(equations)(unknowns, givens, *_along([givens], by, directions))
    advance = ca.Function("sc_next_state", [equations.unknowns, equations.givens], [step.next_state])
    free = ca.MX.sym("unknowns", equations.unknowns.numel())
    state = advance(free, givens)
    explicit = tangent("sc_results_tangent", [*arguments, free], [state, *results(state)], [*by, free])
    return ca.Function(
        name, [*arguments, *directions], list(explicit(*arguments, unknowns, *directions, unknowns_along))
    )


def _along(results: Sequence[ca.MX], by: Sequence[ca.MX], directions: Sequence[ca.MX]) -> list[ca.MX]:
    x, direction = ca.veccat(*by), ca.veccat(*directions)
    return [ca.densify(ca.jtimes(result, x, direction)) if result.numel() else result for result in results]


def _places(symbols: ca.SX, within: ca.SX) -> list[int]:
    """Return the places of symbols in a vector."""
    places = {element.element_hash(): k for k, element in enumerate(ca.vertsplit(within))}
    return [places[symbol.element_hash()] for symbol in ca.vertsplit(symbols)]


def _compile_implicit(equations: SquareSystem) -> ca.Function:
    """Compile (solution, givens, their direction) -> direction of the solution, refined once.

    A change of the path at one end of a step h causes accelerations of order 1/h^2 at the stages, which cancel in the
    result. A factorization spreads their round-off to all rows; one refinement in the same precision removes it (Skeel,
    1980), which gains two to four digits at steps of 0.01 s.
    """
    unknowns, givens = equations.unknowns, equations.givens
    direction = ca.SX.sym("direction", givens.numel())
    scale, rows = equations.unknown_scale, equations.residual_scale
    matrix = ca.mtimes(ca.mtimes(ca.diag(1 / rows), ca.jacobian(equations.residual, unknowns)), ca.diag(scale))
    right = -ca.jtimes(equations.residual, givens, direction) / rows
    linear = ca.Function(
        "sc_linearized", [unknowns, givens, direction], [matrix, ca.densify(right), ca.densify(scale)], {"cse": True}
    )
    at = [ca.MX.sym(f"at{k}", each.numel()) for k, each in enumerate((unknowns, givens, direction))]
    J, b, unit = linear(*at)
    found = ca.solve(J, b, "qr")
    found += ca.solve(J, b - ca.mtimes(J, found), "qr")
    return ca.Function("sc_implicit", at, [found * unit])
