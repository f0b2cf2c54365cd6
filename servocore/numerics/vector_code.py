"""C source of expressions for many instants at once: eight lie side by side in one register, or in two or four.

Every operation of an expression becomes one statement on vectors. Arithmetic and square roots give the same digits as
scalar ones; other functions are those of the C library, lane by lane, since vector libraries round differently. But
`atan2`, of which the C library needs a hundred nanoseconds for eight instants, is off by up to 1.5 units in the last
place. Values that do not depend on the instant are computed once per case.

    void sc_run(long cases, long count, double const* const* in, long const* row, long const* lane,
                double* const* out, long columns)

`in` has an array for every argument. If it varies with the instant, entry i of instant k of case c is at
c*lane + i*row + k; if the instants of a case share it, entry i is at c*lane + i. `out` has an array for every
result, entry i of instant k of case c at (c*rows + i)*columns + k.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce

import casadi as ca

from servocore.numerics.just_in_time import LANES, NAME
from servocore.numerics.machine_code import Build
from servocore.numerics.step_operations import operations_of

_MOST_OPERATIONS = 30_000  # of all expressions of a source; beyond, a compilation takes minutes

_VECTOR = {
    "ADD": "{0} + {1}", "SUB": "{0} - {1}", "MUL": "{0} * {1}", "DIV": "{0} / {1}", "TWICE": "{0} + {0}",
    "SQ": "{0} * {0}", "NEG": "-{0}", "INV": "1.0 / {0}", "ASSIGN": "{0}", "LT": "one({0} < {1})",
    "LE": "one({0} <= {1})", "EQ": "one({0} == {1})", "NE": "one({0} != {1})", "NOT": "one({0} == 0.0)",
    "AND": "one(({0} != 0.0) & ({1} != 0.0))", "OR": "one(({0} != 0.0) | ({1} != 0.0))",
    "IF_ELSE_ZERO": "where({0}, {1})", "FABS": "magnitude({0})", "FMAX": "larger({0}, {1})",
    "FMIN": "smaller({0}, {1})", "SIGN": "sign({0})", "ATAN2": "angle({0}, {1})",
}  # fmt: skip
_LIBRARY = {
    name: name.lower()
    for name in ("SQRT", "SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN", "SINH", "COSH", "TANH", "ASINH", "ACOSH", "ATANH",
                 "EXP", "LOG", "POW", "ATAN2", "FLOOR", "CEIL", "COPYSIGN", "FMOD", "ERF", "LOG1P", "EXPM1", "HYPOT")
} | {"CONSTPOW": "pow"}  # fmt: skip
_NAMES: dict[int, str] = {getattr(ca, name): name[3:] for name in dir(ca) if name.startswith("OP_")}


def _series(first: int, last: int) -> str:
    """Return the sum of q^k/(first + 4k) up to 1/last, as C; the arc tangent of z is z - z^3/3 + z^5/5 - ..."""
    return reduce(lambda inner, k: f"1.0/{k} + q*({inner})", range(last - 4, first - 1, -4), f"1.0/{last}")


# The angle of a point (x, y), from the smaller coordinate n and the larger d: n/d is turned by the angle whose tangent
# c is 0, 1/2 or 1, and z = (n/d - c)/(1 + c n/d) is short. Each constant is followed by what it lacks. Zeros,
# infinities and points that are very far away are left to the C library.
HEAD = f"""#include <math.h>
#define LANES {LANES}
typedef double vec __attribute__((vector_size({8 * LANES})));
typedef double mem __attribute__((vector_size({8 * LANES}), aligned(8), may_alias));
typedef long long bits __attribute__((vector_size({8 * LANES})));
#define all(x) ((vec){{0}} + (x))
#define load(p) ((vec)*(const mem*)(p))
#define one(c) ((vec)((bits)(c) & (bits)all(1.0)))
#define where(c, x) ((vec)((bits)((c) != 0.0) & (bits)(x)))
#define either(c, x, y) ((vec)(((bits)(c) & (bits)(x)) | (~(bits)(c) & (bits)(y))))
#define magnitude(x) ((vec)((bits)(x) & 0x7fffffffffffffffLL))
#define larger(x, y) either(((x) >= (y)) | ((y) != (y)), x, y)
#define smaller(x, y) either(((x) <= (y)) | ((y) != (y)), x, y)
#define raised(most, x) either((x) > (most), x, most)
#define lowered(least, x) either((x) < (least), x, least)
#define first_of(x) ((x)[0])
#define sign(x) either((x) < 0.0, all(-1.0), either((x) > 0.0, all(1.0), x))
#define each1(f, to, x) vec to; for (int i = 0; i < LANES; ++i) to[i] = f(x[i])
#define each2(f, to, x, y) vec to; for (int i = 0; i < LANES; ++i) to[i] = f(x[i], y[i])
static inline vec angle(vec y, vec x) {{
 const vec a = magnitude(y), b = magnitude(x), n = either(a > b, b, a), d = either(a > b, a, b);
 bits odd = ~((d > 1e-290) & (d < 1e290));
 for (int i = 1; i < LANES; ++i) odd[0] |= odd[i];
 if (odd[0]) {{ each2(atan2, r, y, x); return r; }}
 const vec near = one(n > 0.72*d), half = one(n > 0.3*d) - near, c = near + 0.5*half;
 const vec z = (n - c*d)/(d + c*n), s = z*z, q = s*s, of_z = z - z*s*(({_series(3, 31)}) - s*({_series(5, 29)}));
 vec r = 0x1.921fb54442d18p-1*near + 0x1.dac670561bb4fp-2*half;
 r += of_z + (0x1.1a62633145c07p-55*near + 0x1.a2b7f222f65e2p-56*half);
 r = either(a > b, 0x1.921fb54442d18p+0 - (r - 0x1.1a62633145c07p-54), r);
 r = either(x < 0.0, 0x1.921fb54442d18p+1 - (r - 0x1.1a62633145c07p-53), r);
 return (vec)((bits)r | ((bits)y & ~0x7fffffffffffffffLL));
}}
"""

_EXTREMES = """static void extremes(vec most, vec least, vec total, double *high, double *low) {
 double a = most[0], b = least[0], sum = total[0];
 for (int i = 1; i < LANES; ++i) {
  a = most[i] > a ? most[i] : a;
  b = least[i] < b ? least[i] : b;
  sum += total[i];
 }
 const int number = sum - sum == 0.0;
 *high = number ? a : (double)NAN;
 *low = number ? b : (double)NAN;
}
"""


class NoCounterpart(Exception):
    """An operation has no vector counterpart, or a function is not one of expressions."""


def build_of_source(source: Callable[[], str], of_what: str, *functions: ca.Function) -> Build | None:
    """Return the build of the source of functions; None if they cannot be written as vector code, or are too long."""
    try:
        plain = all(each.is_a("SXFunction") for each in functions)  # machine code has no operations to count
        short = plain and sum(each.n_instructions() for each in functions) <= _MOST_OPERATIONS
        return Build(source(), of_what, True) if short else None
    except NoCounterpart:
        return None


def vector_source(function: ca.Function, along: Sequence[bool]) -> str:
    """Return C source of a function for many instants and cases.

    Parameters
    ----------
    function : casadi.Function
        Of expressions, its arguments and results dense.
    along : sequence of bool
        Which arguments vary with the instant; the others are shared by all instants of a case.

    Raises
    ------
    NoCounterpart
        If an operation has none.
    """
    return HEAD + vector_part(NAME, function, along)


def vector_part(name: str, function: ca.Function, along: Sequence[bool]) -> str:
    """Return the function `name` of a source as in `vector_source`: eight instants at once, written where they belong.

    If fewer than eight are left, the last eight are evaluated again.
    """
    of = _Statements(function, along)
    return of.function(name, [
        *[f"  double *const to{k} = out[{k}] + c*{size}*columns;" for k, size in enumerate(of.sizes)],
        "  for (long next = 0; next < count; next += LANES) {",
        "   const long k = next + LANES <= count ? next : count - LANES;",
        *[f"   {statement}" for statement in of.block],
        *[f"   *(mem*)(to{which} + {i}*columns + k) = {value};" for which, i, value in of.results],
        "  }",
    ])  # fmt: skip


def extremes_source(function: ca.Function, along: Sequence[bool]) -> str:
    """Return C source of the highest and lowest values over the instants of the results of `vector_source`.

    Only these leave the registers. Of result entry i of case c the highest value lies at c*2*rows + i of its
    array and the lowest at c*2*rows + rows + i; both are NaN where the value is no finite number at some instant.
    """
    of = _Statements(function, along)
    entries = sum(of.sizes)
    return HEAD + _EXTREMES + of.function(NAME, [
        f"  vec most[{entries}], least[{entries}], total[{entries}];",
        f"  for (int i = 0; i < {entries}; ++i)",
        "   most[i] = all(-INFINITY), least[i] = all(INFINITY), total[i] = all(0.0);",
        "  for (long next = 0; next < count; next += LANES) {",
        "   const long k = next + LANES <= count ? next : count - LANES; (void)k;",
        *[f"   {statement}" for statement in of.block],
        *[
            f"   {{ const vec x = {value}; const int i = {of.first[which] + i}; total[i] += x;"
            " most[i] = raised(most[i], x); least[i] = lowered(least[i], x); }"
            for which, i, value in of.results
        ],
        "  }",
        *[
            f"  for (int i = 0; i < {size}; ++i) extremes(most[{of.first[k]} + i], least[{of.first[k]} + i],"
            f" total[{of.first[k]} + i], out[{k}] + (c*2)*{size} + i, out[{k}] + (c*2 + 1)*{size} + i);"
            for k, size in enumerate(of.sizes)
        ],
    ])  # fmt: skip


class _Statements:
    """The operations of a function as C statements: those per case, and those per eight instants."""

    def __init__(self, function: ca.Function, along: Sequence[bool]) -> None:
        if not function.is_a("SXFunction"):
            raise NoCounterpart
        self.sizes = [function.numel_out(k) for k in range(function.n_out())]
        self.first = [sum(self.sizes[:k]) for k in range(len(self.sizes))]
        self.once: list[str] = []
        self.block: list[str] = []
        self.results: list[tuple[int, int, str]] = []
        self._along = along
        self._values: dict[int, tuple[str, bool]] = {}  # by place: variable, and whether all instants share it
        for k, (number, made, operands, constant) in enumerate(operations_of(function)):
            if number == ca.OP_OUTPUT:
                name, single = self._values[operands[0]]
                self.results.append((made[0], made[1], f"all({name})" if single else name))
            else:
                self._values[made[0]] = self._state(f"a{k}", _NAMES[number], operands, constant)

    def function(self, name: str, body: list[str]) -> str:
        """Return the function `name`: statements per case, then a body for every case."""
        seen = "" if name == NAME else "static "
        return "\n".join([
            f"{seen}void {name}(long cases, long count, const double *const *in, const long *row, const long *lane,",
            "            double *const *out, long columns) {",
            " for (long c = 0; c < cases; ++c) {",
            *[f"  const double *in{k} = in[{k}] + c*lane[{k}]; (void)in{k};" for k in range(len(self._along))],
            *[f"  const long row{k} = row[{k}]; (void)row{k};" for k, moves in enumerate(self._along) if moves],
            *[f"  {statement}" for statement in self.once],
            *body,
            " }",
            "}",
            "",
        ])  # fmt: skip

    def _state(self, name: str, operation: str, arguments: list[int], constant: float) -> tuple[str, bool]:
        """Add the statement of an operation; return its variable, and whether all instants share it."""
        if operation == "CONST":
            return _number(constant), True
        if operation == "INPUT":
            argument, i = arguments
            if self._along[argument]:
                self.block.append(f"const vec {name} = load(in{argument} + {i}*row{argument} + k);")
                return name, False
            self.once.append(f"const double {name} = in{argument}[{i}];")
            return name, True
        operands = [self._values[argument] for argument in arguments]
        single = all(alone for _, alone in operands)
        taken = [f"all({value})" if one and not single else value for value, one in operands]
        if operation in _LIBRARY and single:
            self.once.append(f"const double {name} = {_LIBRARY[operation]}({', '.join(taken)});")
        elif operation in _LIBRARY and operation not in _VECTOR:
            words = ", ".join(f"({word})" for word in taken)
            self.block.append(f"each{len(taken)}({_LIBRARY[operation]}, {name}, {words});")
        elif operation not in _VECTOR:
            raise NoCounterpart(operation)
        elif not single:
            self.block.append(f"const vec {name} = {_VECTOR[operation].format(*taken)};")
        elif "(" in _VECTOR[operation]:  # a macro of vectors: a shared value takes the first lane
            lanes = [f"all({word})" for word in taken]
            self.once.append(f"const double {name} = first_of({_VECTOR[operation].format(*lanes)});")
        else:
            self.once.append(f"const double {name} = {_VECTOR[operation].format(*taken)};")
        return name, single


def _number(value: float) -> str:
    if value != value:  # noqa: PLR0124 - true for NaN only
        return "(double)NAN"
    if value in (float("inf"), -float("inf")):
        return f"({'-' if value < 0 else ''}(double)INFINITY)"
    return f"({value.hex()})"
