"""Enclosures of CasADi expressions: their operations carried out on Chebyshev models, many at once.

Sums and products are programs; between them stand the operations that are interpolated, those of one kind with known
arguments together. Operations with a kink or a jump are products with the sign of a level, which is between -1 and 1
where that may come to zero.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TypeAlias

import casadi as ca
import numpy as np

from servocore.certificate.chebyshev import Arithmetic, Model, bounded, norm
from servocore.certificate.programs import MINUS, PLUS, TIMES, UP, Places, Program, program_of
from servocore.numerics.compiled_calls import Array
from servocore.numerics.step_operations import KINKS, computed, operations_of, rebuilt

Rule: TypeAlias = Callable[..., tuple[Model, ...]]
_Function: TypeAlias = tuple[Rule, list[Places], list[Places]]

_ROUNDED = 1e-9  # of a condition
_MOST_MULTIPLIED = 32  # whole powers up to this are products, others exp(b log(a))


@dataclass(frozen=True, eq=False)
class Walk:
    """An expression's operations in programs, and between them what is interpolated.

    Attributes
    ----------
    parts : tuple of (Program, list of (rule, places of arguments, places of results))
        In an order in which arguments are known.
    numbers : ndarray of int
        Numbers of the arguments that are used: they have the first places.
    constants : ndarray
        Values of the numbers, which have the next ones.
    outputs : ndarray of int
        Place of every entry of the result.
    places : int
        How many are read or written by more than one part.
    """

    parts: tuple[tuple[Program, list[_Function]], ...]
    numbers: Places
    constants: Array
    outputs: Places
    places: int

    @np.errstate(all="ignore")  # what is not finite has no bound
    def __call__(self, ring: Arithmetic, arguments: Model) -> Model:
        """Return models of the results from models of all arguments (terms, arguments, boxes)."""
        models: Array = np.empty((len(arguments[0]) + 1, self.places, arguments[0].shape[2]))
        count, constants = len(self.numbers), slice(len(self.numbers), len(self.numbers) + len(self.constants))
        models[:-1, :count], models[-1, :count] = (part[..., self.numbers, :] for part in arguments)
        models[1:, constants], models[0, constants] = 0.0, self.constants[:, None]
        for program, functions in self.parts:
            program(ring, models)
            for rule, taken, results in functions:
                found = rule(ring, *((models[:-1, each], models[-1, each]) for each in taken))
                for place, (c, r) in zip(results, found, strict=True):
                    models[:-1, place], models[-1, place] = c, r
        wanted = models[:, self.outputs]
        return wanted[:-1], bounded(wanted[-1])


@dataclass(eq=False)
class _Graph:
    """The operations of an expression, with the depth of each place: how many interpolations come before it."""

    depth: list[int]
    constants: dict[float, int]
    inputs: list[tuple[int, int]]
    steps: list[list[tuple[int, int, int, int]]]
    functions: dict[tuple[int, Rule], dict[tuple[int, ...], list[int]]]

    def place(self, depth: int = 0) -> int:
        self.depth.append(depth)
        return len(self.depth) - 1

    def constant(self, value: float) -> int:
        if value not in self.constants:
            self.constants[value] = self.place()
        return self.constants[value]

    def step(self, operation: int, a: int, b: int) -> int:
        depth = max(self.depth[a], self.depth[b])
        while len(self.steps) <= depth:
            self.steps.append([])
        result = self.place(depth)
        self.steps[depth].append((operation, result, a, b))
        return result

    def function(self, number: int, arguments: tuple[int, ...]) -> int:
        rule, component = _RULES[number]
        depth = 1 + max(self.depth[each] for each in arguments)
        some = self.functions.setdefault((depth, rule), {})
        if arguments not in some:
            some[arguments] = [self.place(depth) for _ in range(1 + (rule is _turned))]
        return some[arguments][component]

    def operation(self, number: int, arguments: list[int]) -> int:
        a, b = arguments[0], arguments[-1]
        if number == ca.OP_DIV:
            return self.step(TIMES, a, self.function(ca.OP_INV, (b,)))
        if number == ca.OP_NEG:
            return self.step(MINUS, self.constant(0.0), a)
        if number in _STEPS:
            return self.step(_STEPS[number], a, b)
        return self.function(number, tuple(arguments))

    def walk(self, outputs: list[int]) -> Walk:
        """Return the walk to some places: at each depth a program, then the functions of what is then known."""
        depths = max([len(self.steps), *(depth for depth, _ in self.functions)])
        steps = self.steps + [[]] * (depths - len(self.steps))
        wanted = {place for some in self.functions.values() for each in some for place in each}.union(outputs)
        for depth, own in enumerate(steps):
            wanted.update(place for _, _, *taken in own for place in taken if self.depth[place] < depth)
        # Places that only one program knows come last.
        inner, given = {step[1] for own in steps for step in own} - wanted, [place for place, _ in self.inputs]
        given += self.constants.values()
        rest = sorted(set(range(len(self.depth))).difference(given), key=lambda place: (place in inner, place))
        order = [*given, *rest]
        number = np.argsort(order)
        functions = list[tuple[int, _Function]]()
        for (depth, rule), some in self.functions.items():
            taken, results = (
                [number[list(each)] for each in zip(*both, strict=True)] for both in (some, some.values())
            )
            functions.append((depth, (rule, taken, results)))
        parts, read = [], set(number[list(wanted)].tolist())
        for depth, own in enumerate(steps):
            numbered = [(operation, *number[list(places)].tolist()) for operation, *places in own]
            parts.append((program_of(numbered, read), [each for at, each in functions if at == depth + 1]))
        numbers = np.array([argument for _, argument in self.inputs], dtype=np.intp)
        values, count = np.array(list(self.constants)), len(order) - len(inner)
        return Walk(tuple(parts), numbers, values, number[outputs], count)


def walk_of(expression: ca.SX, symbols: ca.SX) -> Walk:
    """Group the operations of a column of expressions of a column of symbols."""
    function = ca.Function("sc_walk", [symbols], [ca.densify(rebuilt(expression, lowered))], {"cse": True})
    graph, place_of = _Graph([], {}, [], [], {}), dict[int, int]()  # CasADi uses places of its work vector again
    outputs = [graph.constant(0.0)] * expression.numel()
    for number, out, used, constant in operations_of(function):
        if number == ca.OP_OUTPUT:
            outputs[out[1]] = place_of[used[0]]
        elif number == ca.OP_CONST:
            place_of[out[0]] = graph.constant(constant)
        elif number == ca.OP_INPUT:
            place_of[out[0]] = graph.place()
            graph.inputs.append((place_of[out[0]], used[1]))
        else:
            place_of[out[0]] = graph.operation(number, [place_of[each] for each in used])
    return graph.walk(outputs)


# In terms of other operations -----------------------------------------------------------------------------------------


def lowered(operation: int, taken: Sequence[ca.SX]) -> ca.SX:
    """Return an operation's result in terms of operations that have rules."""
    rule = _LOWERED.get(operation)
    return rule(*taken) if rule else computed(operation, taken)


def _power(a: ca.SX, b: ca.SX) -> ca.SX:
    exponent = float(b) if b.is_constant() else np.nan
    if exponent == 0.5:
        return ca.sqrt(a)
    if exponent.is_integer() and abs(exponent) <= _MOST_MULTIPLIED:
        result = reduce(operator.mul, [a] * int(abs(exponent)), ca.SX(1.0))
        return 1.0 / result if exponent < 0 else result
    return ca.exp(b * ca.log(a))


def _tangent(a: ca.SX) -> ca.SX:
    return ca.sin(a) / ca.cos(a)


def _less(a: ca.SX, b: ca.SX) -> ca.SX:
    """Return a < b, and a <= b, as a number: not known where they meet."""
    return (1.0 + ca.sign(b - a)) / 2.0


_LOWERED: dict[int, Callable[..., ca.SX]] = {
    ca.OP_POW: _power, ca.OP_CONSTPOW: _power, ca.OP_TAN: _tangent,
    ca.OP_ATAN: lambda a: ca.atan2(a, ca.SX(1.0)), ca.OP_ASIN: lambda a: ca.atan2(a, ca.sqrt(1.0 - a * a)),
    ca.OP_ACOS: lambda a: ca.atan2(ca.sqrt(1.0 - a * a), a), ca.OP_SINH: lambda a: (ca.exp(a) - ca.exp(-a)) / 2.0,
    ca.OP_COSH: lambda a: (ca.exp(a) + ca.exp(-a)) / 2.0, ca.OP_HYPOT: lambda a, b: ca.sqrt(a * a + b * b),
    ca.OP_FABS: lambda a: a * ca.sign(a), ca.OP_LT: _less, ca.OP_LE: _less, ca.OP_NOT: lambda a: 1.0 - a,
    ca.OP_FMAX: lambda a, b: (a + b + (a - b) * ca.sign(a - b)) / 2.0, ca.OP_AND: lambda a, b: a * b,
    ca.OP_FMIN: lambda a, b: (a + b - (a - b) * ca.sign(a - b)) / 2.0, ca.OP_OR: lambda a, b: a + b - a * b,
    ca.OP_CEIL: lambda a: -computed(ca.OP_FLOOR, [-a]),
}  # fmt: skip

CONSTANT = {ca.OP_SIGN, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR}
"""Operations that are constant between jumps."""

_STEPS = {ca.OP_ADD: PLUS, ca.OP_TWICE: PLUS, ca.OP_SUB: MINUS, ca.OP_MUL: TIMES, ca.OP_SQ: TIMES}

# Rules ----------------------------------------------------------------------------------------------------------------


def _turned(ring: Arithmetic, a: Model) -> tuple[Model, ...]:
    return ring.sine_and_cosine(a)


def _single(operation: Callable[..., Model]) -> Rule:
    return lambda *arguments: (operation(*arguments),)


def _stepped(step: Callable[[Array], Array]) -> Rule:
    """Return the rule of a function that rises by jumps: any value between the least and the largest."""

    def rule(ring: Arithmetic, a: Model) -> tuple[Model, ...]:
        low, high = (step(each) for each in ring.span(a))
        return ((ring.constant((low + high) / 2.0)[0], (high - low) / 2.0),)

    return rule


def _if(_: Arithmetic, condition: Model, a: Model) -> tuple[Model, ...]:
    """Return `a` where a condition holds, and else zero; both where it is not known to be a number but for rounding."""
    (c, r), whole = condition, np.round(condition[0][0])
    known = np.abs(c[0] - whole) + norm(c[1:]) + r < _ROUNDED
    share = np.where(known, whole != 0.0, 0.5)
    return ((share * a[0], np.where(known, 0.0, norm(a[0]) / 2.0 * UP) + np.where(share, a[1], 0.0)),)


def _no_bound(ring: Arithmetic, *taken: Model) -> tuple[Model, ...]:
    c, r = ring.constant(np.zeros_like(taken[0][1]))
    return ((c, np.full_like(r, np.inf)),)


_RULES: dict[int, tuple[Rule, int]] = {
    **dict.fromkeys(KINKS, (_no_bound, 0)),
    ca.OP_INV: (_single(Arithmetic.inverse), 0), ca.OP_SQRT: (_single(Arithmetic.root), 0),
    ca.OP_SIN: (_turned, 0), ca.OP_COS: (_turned, 1), ca.OP_EXP: (_single(Arithmetic.exponential), 0),
    ca.OP_LOG: (_single(Arithmetic.logarithm), 0), ca.OP_TANH: (_single(Arithmetic.hyperbolic_tangent), 0),
    ca.OP_ATAN2: (_single(Arithmetic.angle), 0), ca.OP_SIGN: (_stepped(np.sign), 0),
    ca.OP_FLOOR: (_stepped(np.floor), 0), ca.OP_IF_ELSE_ZERO: (_if, 0),
}  # fmt: skip
