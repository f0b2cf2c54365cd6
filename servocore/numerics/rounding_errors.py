"""Expressions evaluated with bounds of their rounding errors, to recognize terms that cancel.

Running error analysis (Higham, *Accuracy and Stability of Numerical Algorithms*, 2nd ed. (2002), section 3.3): every
operation passes the errors of its arguments on and adds its own.
"""

from __future__ import annotations

import contextlib
import math
import operator
from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Bounded = tuple[float, float]
Program = list[tuple[int, list[int], list[int], float]]

UNIT = 2e-15
"""Relative error of an operation and of a constant: some ten roundings, for constants of a model are computed too."""


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
    operations = [function.instruction_id(k) for k in range(function.n_instructions())]
    program = [
        (operation, function.instruction_output(k), function.instruction_input(k),
         function.instruction_constant(k) if operation == ca.OP_CONST else 0.0)
        for k, operation in enumerate(operations)
    ]  # fmt: skip
    rows, columns = function.sparsity_out(0).get_triplet()
    dense = np.zeros((2, len(points), *function.size_out(0)))
    for place, point in enumerate(points):
        arguments = [np.ravel(argument, order="F").tolist() for argument in point]
        dense[:, place, rows, columns] = np.array(_run(program, arguments, function.sz_w())).reshape(-1, 2).T
    return dense[0], dense[1]


def _run(program: Program, arguments: list[list[float]], size: int) -> list[Bounded]:
    """Go through the operations at one point, in plain numbers: arrays of a few points take far longer."""
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
        # By difference rather than by derivative: right as well where the derivative is infinite, as of sqrt at 0.
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
    """Do what CasADi calls `operation`; by Python what is frequent, for calling CasADi takes far longer."""
    if operation in _FREQUENT:
        with contextlib.suppress(ArithmeticError, ValueError):  # infinite or not a number, as CasADi will say
            return float(_FREQUENT[operation](*arguments))
    return float((ca.DM.unary if len(arguments) == 1 else ca.DM.binary)(operation, *arguments))
