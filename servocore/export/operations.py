"""Floating-point operations of CasADi functions, iterations of Newton's method included: bounds for real-time hosts."""

from __future__ import annotations

from typing import cast

import casadi as ca

from servocore.numerics.newton import MAX_ITERATIONS, QUICK_ITERATIONS

_FREE = (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_PARAMETER)


def operations(function: ca.Function, at_most: bool) -> int:
    """Return how many floating-point operations a call takes; an elementary function counts as one.

    Parameters
    ----------
    function : casadi.Function
        Of the kinds that exported models consist of.
    at_most : bool
        With all permitted iterations of Newton's method, and where functions branch with the longest way; otherwise
        with a single iteration, and no damped ones.
    """
    kind = function.class_name()
    if kind == "SXFunction":
        return sum(function.instruction_id(k) not in _FREE for k in range(function.n_instructions()))
    if kind == "MXFunction":
        return sum(_instruction(function, k, at_most) for k in range(function.n_instructions()))
    if kind == "FastNewton":
        step = function.get_function("jac_g_x")
        n, first = function.numel_out(0), "careful" not in function.name()
        times = (QUICK_ITERATIONS if first else MAX_ITERATIONS - QUICK_ITERATIONS) if at_most else 1
        return times * (operations(step, at_most) + _solved(n))
    if kind == "Switch":
        found = function.info()
        every = *cast("list[ca.Function]", found["f"]), cast("ca.Function", found["f_def"])
        ways = [each for each in every if not each.is_null()]
        return (max if at_most else min)(operations(each, at_most) for each in ways)
    return sum(function.nnz_out(k) for k in range(function.n_out()))  # copies


def _instruction(function: ca.Function, k: int, at_most: bool) -> int:
    number = function.instruction_id(k)
    if number in _FREE:
        return 0
    node = function.instruction_MX(k)
    if number == ca.OP_CALL:
        return operations(node.which_function(), at_most)
    if number == ca.OP_SOLVE:
        return _solved(node.numel())
    if number == ca.OP_MTIMES:
        return 2 * node.numel() * node.dep(1).size2()
    return node.nnz()


def _solved(n: int) -> int:
    """Return the operations of a QR factorization of n equations, and of a solution by it."""
    return 4 * n**3 // 3 + 3 * n**2
