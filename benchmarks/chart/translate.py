"""CasADi expressions in other languages: applied to any objects with operators, or written as Python source."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

_BINARY: dict[int, str] = {ca.OP_ADD: "{} + {}", ca.OP_SUB: "{} - {}", ca.OP_MUL: "{} * {}", ca.OP_DIV: "{} / {}"}
_UNARY: dict[int, str] = {
    ca.OP_NEG: "-{0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2.0 * {0}", ca.OP_INV: "1.0 / {0}",
    ca.OP_SQRT: "sqrt({0})", ca.OP_SIN: "sin({0})", ca.OP_COS: "cos({0})", ca.OP_ASSIGN: "{0}",
}  # fmt: skip
_CASES: dict[int, str] = {
    ca.OP_LT: "({} < {})", ca.OP_LE: "({} <= {})", ca.OP_FABS: "abs({0})", ca.OP_FMAX: "max({}, {})",
    ca.OP_FMIN: "min({}, {})", ca.OP_NOT: "(not {0})", ca.OP_IF_ELSE_ZERO: "({1} if {0} else 0.0)",
}  # fmt: skip
_POWERS = (ca.OP_POW, ca.OP_CONSTPOW)

Functions = Mapping[str, Callable[[Any], Any]]


def source(name: str, arguments: Sequence[ca.SX], expressions: Sequence[ca.SX]) -> str:
    """Write a function of sequences of floats that returns one flat list of floats an expression.

    It is what `sympy.lambdify` with common subexpressions would give: straight-line Python on scalars, which for a
    few dozen unknowns is faster than NumPy on small arrays.
    """
    function = ca.Function("f", list(arguments), [ca.densify(each) for each in expressions], {"cse": True})
    lines = [f"def {name}({', '.join(f'a{k}' for k in range(len(arguments)))}):"]
    results = [["0.0"] * function.numel_out(k) for k in range(function.n_out())]
    for k in range(function.n_instructions()):
        operation, into, of = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if operation == ca.OP_INPUT:
            lines.append(f"    w{into[0]} = a{of[0]}[{of[1]}]")
        elif operation == ca.OP_OUTPUT:
            lines.append(f"    r{into[0]}_{into[1]} = w{of[0]}")
            results[into[0]][into[1]] = f"r{into[0]}_{into[1]}"
        elif operation == ca.OP_CONST:
            lines.append(f"    w{into[0]} = {function.instruction_constant(k)!r}")
        else:
            lines.append(f"    w{into[0]} = {_template(operation).format(*(f'w{i}' for i in of))}")
    lines.append("    return " + ", ".join("[" + ", ".join(each) + "]" for each in results) + ",")
    return "\n".join(lines) + "\n"


def compiled(name: str, arguments: Sequence[ca.SX], expressions: Sequence[ca.SX]) -> Callable[..., Any]:
    """Return the function whose `source` this is."""
    space: dict[str, Any] = {each: getattr(math, each) for each in ("sqrt", "sin", "cos")}
    exec(source(name, arguments, expressions), space)  # our own text
    function: Callable[..., Any] = space[name]
    return function


def _template(operation: int) -> str:
    if operation in _POWERS:
        return "{} ** {}"
    for table in (_BINARY, _UNARY, _CASES):
        if operation in table:
            return table[operation]
    raise NotImplementedError(f"CasADi operation {operation} has no translation")


def apply(
    arguments: Sequence[ca.SX],
    expression: ca.SX,
    values: Sequence[Sequence[Any]],
    functions: Functions,
    keep: Callable[[Any], Any] | None = None,
) -> list[Any]:
    """Evaluate an expression on objects that know the four operations and powers.

    Parameters
    ----------
    arguments, expression : casadi.SX
        As of a `casadi.Function`.
    values : sequence of sequences
        What stands for the entries of each argument.
    functions : mapping
        ``sqrt``, ``sin`` and ``cos`` of such objects.
    keep : callable, optional
        Applied to every result that is used more than once: a modelling language may give it a name.
    """
    function = ca.Function("f", list(arguments), [ca.densify(expression)], {"cse": True})
    used = _uses(function)
    work: dict[int, Any] = {}
    results: list[Any] = [0.0] * function.numel_out(0)
    for k in range(function.n_instructions()):
        operation, into, of = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if operation == ca.OP_INPUT:
            work[into[0]] = values[of[0]][of[1]]
        elif operation == ca.OP_OUTPUT:
            results[into[1]] = work[of[0]]
        elif operation == ca.OP_CONST:
            work[into[0]] = float(function.instruction_constant(k))
        else:
            found = _operate(operation, [work[i] for i in of], functions)
            work[into[0]] = keep(found) if keep and used[k] > 1 and not isinstance(found, float) else found
    return results


def _uses(function: ca.Function) -> list[int]:
    """Count for every instruction how often its result is read."""
    counts = [0] * function.n_instructions()
    writer: dict[int, int] = {}
    for k in range(function.n_instructions()):
        if function.instruction_id(k) not in (ca.OP_INPUT, ca.OP_CONST):
            for i in function.instruction_input(k):
                if i in writer:
                    counts[writer[i]] += 1
        if function.instruction_id(k) != ca.OP_OUTPUT:
            writer[function.instruction_output(k)[0]] = k
    return counts


def _operate(operation: int, of: list[Any], functions: Functions) -> Any:
    named = {ca.OP_SQRT: "sqrt", ca.OP_SIN: "sin", ca.OP_COS: "cos"}
    if operation in named:
        return functions[named[operation]](of[0])
    simple: dict[int, Callable[..., Any]] = {
        ca.OP_ADD: lambda a, b: a + b, ca.OP_SUB: lambda a, b: a - b, ca.OP_MUL: lambda a, b: a * b,
        ca.OP_DIV: lambda a, b: a / b, ca.OP_NEG: lambda a: -a, ca.OP_SQ: lambda a: a * a,
        ca.OP_TWICE: lambda a: 2.0 * a, ca.OP_INV: lambda a: 1.0 / a, ca.OP_ASSIGN: lambda a: a,
        ca.OP_POW: lambda a, b: a ** _whole(b), ca.OP_CONSTPOW: lambda a, b: a ** _whole(b),
    }  # fmt: skip
    if operation not in simple:
        raise NotImplementedError(f"CasADi operation {operation} has no translation")
    return simple[operation](*of)


def _whole(exponent: Any) -> Any:
    return int(exponent) if isinstance(exponent, float) and np.floor(exponent) == exponent else exponent
