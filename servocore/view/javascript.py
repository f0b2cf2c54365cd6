"""Expressions as JavaScript: a function of CasADi written out, one statement an operation."""

from __future__ import annotations

import math
from collections.abc import Sequence

import casadi as ca

from servocore.errors import InvalidModel
from servocore.numerics.step_operations import operations_of

MOST_OPERATIONS = 30_000
"""Longer functions are not written out: browsers would interpret them instead of compiling them."""

_ON_A_LINE = 8  # statements

_FORMS = {
    ca.OP_ADD: "{0}+{1}", ca.OP_SUB: "{0}-{1}", ca.OP_MUL: "{0}*{1}", ca.OP_DIV: "{0}/{1}",
    ca.OP_POW: "Math.pow({0},{1})", ca.OP_CONSTPOW: "Math.pow({0},{1})", ca.OP_ATAN2: "Math.atan2({0},{1})",
    ca.OP_LT: "+({0}<{1})", ca.OP_LE: "+({0}<={1})", ca.OP_EQ: "+({0}==={1})", ca.OP_NE: "+({0}!=={1})",
    ca.OP_AND: "+({0}!==0&&{1}!==0)", ca.OP_OR: "+({0}!==0||{1}!==0)", ca.OP_IF_ELSE_ZERO: "{0}!==0?{1}:0",
    ca.OP_FMIN: "{0}<{1}||{1}!=={1}?{0}:{1}", ca.OP_FMAX: "{0}>{1}||{1}!=={1}?{0}:{1}", ca.OP_FMOD: "{0}%{1}",
    ca.OP_COPYSIGN: "Object.is(Math.sign({1}),-0)||{1}<0?-Math.abs({0}):Math.abs({0})",
    ca.OP_HYPOT: "Math.sqrt({0}*{0}+{1}*{1})",
    ca.OP_ASSIGN: "{0}", ca.OP_NEG: "-{0}", ca.OP_SQ: "{0}*{0}", ca.OP_TWICE: "2*{0}", ca.OP_INV: "1/{0}",
    ca.OP_NOT: "+({0}===0)", ca.OP_FABS: "Math.abs({0})",
    **{getattr(ca, f"OP_{name.upper()}"): f"Math.{name}({{0}})" for name in (
        "exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh",
        "atanh", "floor", "ceil", "sign", "log1p", "expm1")},
}  # fmt: skip


def javascript(function: ca.Function) -> str:
    """Return a function as an expression of JavaScript: ``(a0, a1, ..., r0, r1, ...) => {...}``.

    Arguments and results are arrays of numbers, matrices column by column. Operations are those of the function in
    their order, on the same doubles: only functions such as a sine may differ, in the last digit.

    Parameters
    ----------
    function : casadi.Function
        Of expressions (`casadi.SX`), with dense arguments and results.

    Raises
    ------
    InvalidModel
        If it is none, is too long, or has an operation that JavaScript lacks.
    """
    if not function.is_a("SXFunction"):
        raise InvalidModel(f"{function.name()} is no function of expressions, and cannot be written as JavaScript")
    name, count = function.name(), function.n_instructions()
    if count > MOST_OPERATIONS:
        raise InvalidModel(f"{name} takes {count} operations, more than the {MOST_OPERATIONS} of a page")
    statements = [_statement(name, *operation) for operation in operations_of(function)]
    lines = [";".join(statements[k : k + _ON_A_LINE]) for k in range(0, count, _ON_A_LINE)]
    arguments = [f"a{k}" for k in range(function.n_in())] + [f"r{k}" for k in range(function.n_out())]
    held = ",".join(f"w{k}" for k in range(function.sz_w()))
    return f"({','.join(arguments)})=>{{{f'let {held};' if held else ''}\n" + ";\n".join(lines) + "}"


def _statement(name: str, operation: int, given: list[int], taken: list[int], constant: float) -> str:
    """Return one operation."""
    if operation == ca.OP_INPUT:
        return f"w{given[0]}=a{taken[0]}[{taken[1]}]"
    if operation == ca.OP_OUTPUT:
        return f"r{given[0]}[{given[1]}]=w{taken[0]}"
    if operation == ca.OP_CONST:
        return f"w{given[0]}={number(constant)}"
    form = _FORMS.get(operation)
    if form is None:
        raise InvalidModel(f"{name} has an operation that JavaScript lacks, number {operation} of CasADi")
    return f"w{given[0]}={form.format(*(f'w{register}' for register in taken))}"


def number(value: float) -> str:
    """Return a number in as many digits as it takes to read back the same one."""
    if math.isfinite(value):
        return repr(int(value)) if value == int(value) and abs(value) < 1e15 and str(value)[0] != "-" else repr(value)
    return "NaN" if math.isnan(value) else f"{'-' if value < 0 else ''}Infinity"


def written(name: str, symbols: Sequence[ca.SX], results: Sequence[ca.SX]) -> str:
    """Return expressions of symbols as JavaScript; common subexpressions are computed once."""
    return javascript(ca.Function(name, list(symbols), [ca.densify(result) for result in results], {"cse": True}))
