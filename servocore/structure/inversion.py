"""Exact inversion: every unknown of the derivative array from the reference at one instant."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from servocore.structure.derivative_array import DerivativeArray, array_system, compile_array_solver, first_guess
from servocore.numerics.square_systems import compile_flat_solver

_LARGEST_RESIDUAL = 1e-9
_MOST_OPERATIONS = 2500  # beyond, evaluating takes longer than calling


def compile_inversion(array: DerivativeArray, name: str = "sc_inversion") -> ca.Function:
    """Compile (gamma, p) -> (unknowns of the array, counts, residual), by Newton from the system's guess.

    gamma has shape (m, reference_order + 1). Configurations start from ``system.guess``, multipliers and inputs from
    the static equilibrium there (with no force in the rope the equations would be singular), the rest from zero.
    States of the internal dynamics keep their guess.

    Where the guess is exact the inversion is one expression, see `compile_flat_inversion`; its answer is taken if it
    satisfies all equations, and else Newton's method goes to work.
    """
    system = array.system
    gamma = ca.MX.sym("gamma", system.gamma.size1(), array.reference_order + 1)
    p = ca.MX.sym("p", system.p.numel())
    searched = ca.Function(
        "sc_search", [gamma, p], list(compile_array_solver(array)(gamma, p, first_guess(array)(gamma, p)))
    )
    flat = compile_flat_inversion(array)
    if flat is None:
        found = searched(gamma, p)
    else:
        quick = flat(gamma, p)
        given = [ca.MX.sym("given", *each.shape) for each in (*quick, gamma, p)]
        accept = ca.Function("sc_accept", given, given[:3])
        search = ca.Function("sc_reject", given, list(searched(*given[3:])))
        choose = ca.Function.if_else("sc_choose", accept, search)
        found = choose(quick[2] < _LARGEST_RESIDUAL, *quick, gamma, p)
    return ca.Function(name, [gamma, p], list(found), ["gamma", "p"], ["y", "counts", "residual"])


@lru_cache(maxsize=64)
def compile_flat_inversion(array: DerivativeArray) -> ca.Function | None:
    """Compile the inversion as one expression, with NaN where the guess is not exact; None where that does not pay.

    Such an expression costs a quarter of calling Newton's method block by block.
    """
    if array.states:
        return None  # they are followed from step to step
    flat = compile_flat_solver("sc_array", *array_system(array))
    if flat is None:
        return None
    system = array.system
    gamma, p = ca.SX.sym("gamma", system.gamma.size1(), array.reference_order + 1), ca.SX.sym("p", system.p.numel())
    found = flat.call([ca.vertcat(ca.vec(gamma), p, first_guess(array)(gamma, p))])
    function = ca.Function("sc_flat_inversion", [gamma, p], [ca.densify(each) for each in found], {"cse": True})
    return function if function.n_instructions() <= _MOST_OPERATIONS else None
