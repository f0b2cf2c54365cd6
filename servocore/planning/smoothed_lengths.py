"""Smoothed lengths: square roots that are differentiable at zero."""

from __future__ import annotations

import casadi as ca

_ROUNDED = 1e-5  # a length that counts as none: a cone is rounded off so far from its tip


def rounded(expression: ca.SX) -> ca.SX:
    """Return an expression with every square root rounded off at zero, a little larger than it was."""
    symbols = ca.symvar(expression)
    function = ca.Function("sc_rounded", symbols, [expression])
    work: dict[int, ca.SX] = {}
    result = ca.SX(0)
    for k in range(function.n_instructions()):
        operation, into = function.instruction_id(k), function.instruction_output(k)
        operands = function.instruction_input(k)
        if operation == ca.OP_INPUT:
            work[into[0]] = symbols[operands[0]][operands[1]]
        elif operation == ca.OP_CONST:
            work[into[0]] = ca.SX(function.instruction_constant(k))
        elif operation == ca.OP_OUTPUT:
            result = work[operands[0]]
        elif operation == ca.OP_SQRT:
            work[into[0]] = ca.sqrt(work[operands[0]] + _ROUNDED**2)
        elif len(operands) == 1:
            work[into[0]] = ca.SX.unary(operation, work[operands[0]])
        else:
            work[into[0]] = ca.SX.binary(operation, work[operands[0]], work[operands[1]])
    return result
