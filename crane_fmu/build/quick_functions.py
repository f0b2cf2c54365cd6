"""CasADi functions of short expressions in which nothing is computed twice, and nothing divided by the same twice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import casadi as ca


def function(name: str, arguments: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    """Return a function of expressions in which nothing is computed twice, and nothing divided by the same twice.

    A division takes as long as some ten products. Where several numbers are divided by the same one they are multiplied
    by its reciprocal, which moves last digits only.
    """
    plain = ca.Function(name, arguments, results, {"cse": True})
    symbols = [ca.SX.sym(f"i{k}", plain.sparsity_in(k)) for k in range(plain.n_in())]
    with _as_written():
        return ca.Function(name, symbols, _by_reciprocals(plain, symbols))


@contextmanager
def _as_written() -> Iterator[None]:
    """Let CasADi keep expressions as they are written: it makes a division of a product with a reciprocal."""
    before = ca.GlobalOptions.getSimplificationOnTheFly()
    ca.GlobalOptions.setSimplificationOnTheFly(False)
    try:
        yield
    finally:
        ca.GlobalOptions.setSimplificationOnTheFly(before)


def _by_reciprocals(plain: ca.Function, arguments: list[ca.SX]) -> list[ca.SX]:
    """Return the results of a function; what several numbers are divided by is inverted once."""
    divisors = _divisors(plain)
    often = {each for each, count in Counter(divisors.values()).items() if count > 1}
    entries = [each.nonzeros() for each in arguments]
    found = [[ca.SX(0)] * plain.nnz_out(k) for k in range(plain.n_out())]
    work: dict[int, ca.SX] = {}
    inverse: dict[int, ca.SX] = {}  # by the instruction that computes what is inverted
    for k in range(plain.n_instructions()):
        operation, into, operands = plain.instruction_id(k), plain.instruction_output(k), plain.instruction_input(k)
        if operation == ca.OP_INPUT:
            work[into[0]] = entries[operands[0]][operands[1]]
        elif operation == ca.OP_CONST:
            work[into[0]] = ca.SX(plain.instruction_constant(k))
        elif operation == ca.OP_OUTPUT:
            found[into[0]][into[1]] = work[operands[0]]
        elif divisors.get(k) in often:
            inverted = inverse.setdefault(divisors[k], 1 / work[operands[-1]])
            work[into[0]] = inverted if operation == ca.OP_INV else work[operands[0]] * inverted
        elif len(operands) == 1:
            work[into[0]] = ca.SX.unary(operation, work[operands[0]])
        else:
            work[into[0]] = ca.SX.binary(operation, work[operands[0]], work[operands[1]])
    return [ca.SX(plain.sparsity_out(k), ca.vertcat(*each)) for k, each in enumerate(found)]


def _divisors(plain: ca.Function) -> dict[int, int]:
    """Return, for each instruction of a function that divides, the one that computes what it divides by."""
    computed: dict[int, int] = {}  # by place: places are used again
    found: dict[int, int] = {}
    for k in range(plain.n_instructions()):
        operation = plain.instruction_id(k)
        if operation in (ca.OP_DIV, ca.OP_INV):
            found[k] = computed[plain.instruction_input(k)[-1]]
        if operation != ca.OP_OUTPUT:
            computed[plain.instruction_output(k)[0]] = k
    return found
