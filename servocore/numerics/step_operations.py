"""Analysis of expressions operation by operation: jumps, and bounds of rounding errors.

In CasADi the derivative of functions that jump, such as `floor`, is zero. An equation x + sign(x) = 1 has a constant
Jacobian and is not linear. So linearity is tested on a *stand-in*: the same expression with smooth nonlinear functions
in place of those that jump.

Bounds of rounding errors reveal terms that cancel, by running error analysis (Higham, *Accuracy and Stability
of Numerical Algorithms*, 2nd ed. (2002), section 3.3): every operation propagates the errors of its arguments and adds
its own.
"""

from __future__ import annotations

import contextlib
import math
import operator
from collections.abc import Callable, Iterator, Sequence

import casadi as ca
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Bounded = tuple[float, float]
Operation = tuple[int, list[int], list[int], float]
"""CasADi's number of the operation, places of results and arguments, and the value of a constant."""

UNIT = 2e-15
"""Relative error of an operation and of a constant: some ten roundings, since constants are computed as well."""

_COMPARISONS = {ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE}
_LOGIC = {ca.OP_NOT, ca.OP_AND, ca.OP_OR, ca.OP_IF_ELSE_ZERO}
_STEPS = {ca.OP_FLOOR, ca.OP_CEIL, ca.OP_SIGN, ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_COPYSIGN}
JUMPS = _COMPARISONS | _LOGIC | _STEPS
"""Operations whose values jump, by their numbers in CasADi."""

KINKS = JUMPS | {ca.OP_FABS, ca.OP_FMIN, ca.OP_FMAX, ca.OP_CALL}
"""Operations with a jump or a kink; an external function, such as a table, may have either."""

Rule = Callable[[int, Sequence[ca.SX]], ca.SX]


def operations_of(function: ca.Function) -> Iterator[Operation]:
    """Yield the operations of a function of expressions, in their order."""
    for k in range(function.n_instructions()):
        number = function.instruction_id(k)
        constant = function.instruction_constant(k) if number == ca.OP_CONST else 0.0
        yield number, function.instruction_output(k), function.instruction_input(k), constant


def holds_any(expression: ca.SX, operations: set[int]) -> bool:
    """Whether an expression holds one of some operations, given by their numbers in CasADi."""
    return bool(operations & operations_in(expression))


def operations_in(expression: ca.SX) -> set[int]:
    """Return the operations of an expression, by their numbers in CasADi."""
    function = ca.Function("sc_operations", [], [expression], {"allow_free": True})
    return {function.instruction_id(k) for k in range(function.n_instructions())}


def without_jumps(expression: ca.SX) -> ca.SX:
    """Return an expression of the same shape that depends on the same symbols, curved wherever the given one jumps.

    Only the pattern of its constant derivatives is meaningful, not its values. An expression without jumps is returned
    unchanged.
    """
    return rebuilt(expression, _stand_in) if holds_any(expression, JUMPS) else expression


def switching_levels(expression: ca.SX) -> list[ca.SX]:
    """Return switching functions of an expression, which has its jumps and kinks where one of them passes an integer.

    External functions are left out: their kinks are unknown.
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
    """Return an expression with the sign of an argument that passes no integer but zero."""
    return ca.atan(argument) / np.pi


def rebuilt(expression: ca.SX, rule: Rule) -> ca.SX:
    """Return an expression rebuilt operation by operation with a rule."""
    arguments = ca.symvar(expression)
    function = ca.Function("sc_jumping", [ca.vertcat(ca.SX(0, 1), *arguments)], [expression])
    work: dict[int, ca.SX] = {}
    result = ca.SX(function.sparsity_out(0), ca.SX.zeros(function.nnz_out(0)))
    for operation, out, places, constant in operations_of(function):
        if operation == ca.OP_CONST:
            work[out[0]] = ca.SX(constant)
        elif operation == ca.OP_INPUT:
            work[out[0]] = arguments[places[1]]
        elif operation == ca.OP_OUTPUT:
            result.nz[out[1]] = work[places[0]]
        else:
            taken = [work[place] for place in places]
            for place in out:
                work[place] = rule(operation, taken)
    return result


def _stand_in(operation: int, taken: Sequence[ca.SX]) -> ca.SX:
    """Return an operation's result, or a curved function of the same arguments where it jumps."""
    if operation == ca.OP_IF_ELSE_ZERO:  # linear in the value, nonlinear in the condition
        return taken[0] * taken[1]
    return _curved(taken) if operation in JUMPS else computed(operation, taken)


def computed(operation: int, taken: Sequence[ca.SX]) -> ca.SX:
    """Return an operation's result; a nonlinear function of the arguments in place of an external function."""
    if operation == ca.OP_CALL:
        return _curved(taken)
    return ca.SX.unary(operation, taken[0]) if len(taken) == 1 else ca.SX.binary(operation, taken[0], taken[1])


def _curved(taken: Sequence[ca.SX]) -> ca.SX:
    return ca.sin(sum((ca.sin(each) for each in taken), ca.SX(1)))


# Rounding errors ------------------------------------------------------------------------------------------------------


def evaluate(function: ca.Function, points: Sequence[Sequence[Array]]) -> tuple[Array, Array]:
    """Evaluate the first result of a function of `casadi.SX` at several points, with bounds of its rounding errors.

    Parameters
    ----------
    function : casadi.Function
        Made of scalar operations.
    points : sequence of sequences of ndarray
        The arguments at every point: exact numbers but for the last one, which are constants of a model.

    Returns
    -------
    values, errors : ndarray, shape (points, rows, columns)
    """
    program = list(operations_of(function))
    rows, columns = function.sparsity_out(0).get_triplet()
    dense = np.zeros((2, len(points), *function.size_out(0)))
    for place, point in enumerate(points):
        arguments = [np.ravel(argument, order="F").tolist() for argument in point]
        dense[:, place, rows, columns] = np.array(_run(program, arguments, function.sz_w())).reshape(-1, 2).T
    return dense[0], dense[1]


def _run(program: list[Operation], arguments: list[list[float]], size: int) -> list[Bounded]:
    """Evaluate the operations at one point in Python floats: arrays of a few points take far longer."""
    work, results = [(0.0, 0.0)] * size, {}
    for operation, to, operands, constant in program:
        if operation == ca.OP_CONST:
            work[to[0]] = constant, 0.0 if constant.is_integer() else UNIT * abs(constant)
        elif operation == ca.OP_INPUT:
            value = arguments[operands[0]][operands[1]]
            work[to[0]] = value, UNIT * abs(value) if operands[0] == len(arguments) - 1 else 0.0
        elif operation == ca.OP_OUTPUT:
            results[to[1]] = work[operands[0]]
        else:
            work[to[0]] = _result(operation, [work[operand] for operand in operands])
    return [results[k] for k in sorted(results)]


def _result(operation: int, operands: list[Bounded]) -> Bounded:
    """Return value and error of one operation from those of its arguments."""
    (a, a_error), (b, b_error) = operands[0], operands[-1]
    if operation == ca.OP_NEG:
        return -a, a_error
    if operation == ca.OP_ADD:
        value, error = a + b, a_error + b_error
    elif operation == ca.OP_SUB:
        value, error = a - b, a_error + b_error
    elif operation in (ca.OP_MUL, ca.OP_SQ):
        # First order in the errors, whose product is 1e-30 relative.
        value, error = a * b, abs(a) * b_error + abs(b) * a_error
    elif len(operands) == 1:
        value = _elementary(operation, a)
        # By difference rather than by derivative, which may be infinite, as that of sqrt at 0.
        error = abs(_elementary(operation, a + a_error) - value)
    else:
        value = _elementary(operation, a, b)
        error = abs(_elementary(operation, a + a_error, b) - value)
        error += abs(_elementary(operation, a, b + b_error) - value)
    return value, error + UNIT * abs(value)


_FREQUENT: dict[int, Callable[..., float]] = {
    ca.OP_DIV: operator.truediv,
    ca.OP_SIN: math.sin,
    ca.OP_COS: math.cos,
    ca.OP_SQRT: math.sqrt,
}


def _elementary(operation: int, *arguments: float) -> float:
    """Return the result of CasADi's `operation`; frequent ones by Python, since a call of CasADi takes far longer."""
    if operation in _FREQUENT:
        with contextlib.suppress(ArithmeticError, ValueError):  # infinite or not a number: CasADi returns it
            return float(_FREQUENT[operation](*arguments))
    return float((ca.DM.unary if len(arguments) == 1 else ca.DM.binary)(operation, *arguments))
