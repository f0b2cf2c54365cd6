"""Operations that jump, as `floor` does: CasADi takes their derivative for zero, and what holds them for linear.

An equation x + sign(x) = 1 has a constant Jacobian and is not linear. So that nobody takes it for linear, structure is
read off a *stand-in*: the same expression with curved functions in the places of those that jump.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

_COMPARISONS = {ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE}
_LOGIC = {ca.OP_NOT, ca.OP_AND, ca.OP_OR, ca.OP_IF_ELSE_ZERO}
_STEPS = {ca.OP_FLOOR, ca.OP_CEIL, ca.OP_SIGN, ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_COPYSIGN}
JUMPS = _COMPARISONS | _LOGIC | _STEPS
"""Operations whose values jump, by their numbers in CasADi."""

KINKS = JUMPS | {ca.OP_FABS, ca.OP_FMIN, ca.OP_FMAX, ca.OP_CALL}
"""Operations with a jump or a kink; a function that is called, such as a table, may have either."""

Rule = Callable[[int, Sequence[ca.SX]], ca.SX]


def holds_any(expression: ca.SX, operations: set[int]) -> bool:
    """Whether an expression holds one of some operations, given by their numbers in CasADi."""
    function = ca.Function("sc_operations", [], [expression], {"allow_free": True})
    return any(function.instruction_id(k) in operations for k in range(function.n_instructions()))


def without_jumps(expression: ca.SX) -> ca.SX:
    """Return an expression of the same shape that depends on the same symbols, curved wherever the given one jumps.

    Its values mean nothing; which of its derivatives are constant, does. An expression that does not jump is returned
    as it is.
    """
    return rebuilt(expression, _stand_in) if holds_any(expression, JUMPS) else expression


def switching_levels(expression: ca.SX) -> list[ca.SX]:
    """Return what the jumps and kinks of an expression depend on, such that they are where it passes a whole number.

    Functions that are called are left out: nothing is known of them.
    """
    levels: list[ca.SX] = []

    def collected(operation: int, taken: Sequence[ca.SX]) -> ca.SX:
        if operation in {ca.OP_SIGN, ca.OP_FABS}:
            levels.append(_at_zero_alone(taken[0]))
        elif operation in {ca.OP_FLOOR, ca.OP_CEIL}:
            levels.append(taken[0])
        elif operation == ca.OP_COPYSIGN:
            levels.append(_at_zero_alone(taken[1]))
        elif operation in {*_COMPARISONS, ca.OP_FMIN, ca.OP_FMAX}:
            levels.append(_at_zero_alone(taken[0] - taken[1]))
        elif operation == ca.OP_FMOD:
            levels.append(taken[0] / taken[1])
        elif operation == ca.OP_REMAINDER:
            levels.append(taken[0] / taken[1] + 0.5)
        return computed(operation, taken)

    if holds_any(expression, KINKS):
        rebuilt(expression, collected)
    different: dict[int, ca.SX] = {each.element_hash(): each for each in levels if not each.is_constant()}
    return list(different.values())


def _at_zero_alone(argument: ca.SX) -> ca.SX:
    """Return an expression of the sign of an argument that passes no other whole number."""
    return ca.atan(argument) / np.pi


def rebuilt(expression: ca.SX, rule: Rule) -> ca.SX:
    """Return an expression computed anew, operation by operation, as a rule says."""
    arguments = ca.symvar(expression)
    function = ca.Function("sc_jumping", [ca.vertcat(ca.SX(0, 1), *arguments)], [expression])
    work: dict[int, ca.SX] = {}
    result = ca.SX(function.sparsity_out(0), ca.SX.zeros(function.nnz_out(0)))
    for k in range(function.n_instructions()):
        operation, out = function.instruction_id(k), function.instruction_output(k)
        if operation == ca.OP_CONST:
            work[out[0]] = ca.SX(function.instruction_constant(k))
        elif operation == ca.OP_INPUT:
            work[out[0]] = arguments[function.instruction_input(k)[1]]
        elif operation == ca.OP_OUTPUT:
            result.nz[out[1]] = work[function.instruction_input(k)[0]]
        else:
            taken = [work[place] for place in function.instruction_input(k)]
            for place in out:
                work[place] = rule(operation, taken)
    return result


def _stand_in(operation: int, taken: Sequence[ca.SX]) -> ca.SX:
    """Return an operation's result, or a curved function of the same arguments where it jumps."""
    if operation == ca.OP_IF_ELSE_ZERO:  # linear in what it chooses, and not in what it chooses by
        return taken[0] * taken[1]
    return _curved(taken) if operation in JUMPS else computed(operation, taken)


def computed(operation: int, taken: Sequence[ca.SX]) -> ca.SX:
    """Return an operation's result; a curved function of its arguments where what is called is not known."""
    if operation == ca.OP_CALL:  # what is called is not known here
        return _curved(taken)
    return ca.SX.unary(operation, taken[0]) if len(taken) == 1 else ca.SX.binary(operation, taken[0], taken[1])


def _curved(taken: Sequence[ca.SX]) -> ca.SX:
    return ca.sin(sum((ca.sin(each) for each in taken), ca.SX(1)))
