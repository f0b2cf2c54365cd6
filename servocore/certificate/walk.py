"""Enclosures of CasADi expressions: their operations carried out on Chebyshev models, many at once.

Sums and products are programs; between them stand the operations that are interpolated, those of one kind with known
arguments together. Operations with a kink or a jump are products with the sign of a level, which is between -1 and 1
where that may come to zero.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import TypeAlias

import casadi as ca
import numpy as np

from servocore.certificate.chebyshev import Arithmetic, Model, bounded, norm
from servocore.certificate.programs import MINUS, PLUS, TIMES, UP, Places, Program, Step
from servocore.numerics.compiled_calls import Array
from servocore.numerics.step_operations import KINKS, computed, operations_of, rebuilt

Rule: TypeAlias = Callable[..., Model]
_Function: TypeAlias = tuple[Rule, list[Places], Places]

_ROUNDED = 1e-9  # of a condition
_MOST_MULTIPLIED = 32  # whole powers up to this are products, others exp(b log(a))


@dataclass(frozen=True, eq=False)
class Walk:
    """An expression's operations in programs, and between them what is interpolated.

    Attributes
    ----------
    parts : sequence of (Program, list of (rule, places of arguments, places of results))
        In an order in which arguments are known.
    arguments : mapping of int to int
        Places of the arguments that are used, by their numbers.
    constants : mapping of float to int
        Places of numbers.
    outputs : ndarray of int
        Place of every entry of the result.
    places : int
        How many are read or written by more than one part.
    """

    parts: Sequence[tuple[Program, list[_Function]]]
    arguments: Mapping[int, int]
    constants: Mapping[float, int]
    outputs: Places
    places: int

    @np.errstate(all="ignore")  # what is not finite has no bound
    def __call__(self, ring: Arithmetic, arguments: Model) -> Model:
        """Return models of the results from models of all arguments (terms + 1, arguments, boxes)."""
        models: Array = np.empty((len(arguments), self.places, arguments.shape[2]))
        models[:, list(self.arguments.values())] = arguments[:, list(self.arguments)]
        models[:, list(self.constants.values())] = ring.constant(np.array(list(self.constants))[:, None])
        for program, functions in self.parts:
            program(ring, models)
            for rule, taken, results in functions:
                models[:, results] = rule(ring, *(models[:, each] for each in taken))
        return bounded(models[:, self.outputs])


@dataclass(eq=False)
class _Graph:
    """The operations of an expression, with the depth of each place: how many interpolations come before it."""

    depth: list[int] = field(default_factory=list)
    arguments: dict[int, int] = field(default_factory=dict)
    constants: dict[float, int] = field(default_factory=dict)
    steps: list[Step] = field(default_factory=list)
    functions: dict[tuple[int, Rule], dict[tuple[int, ...], list[int]]] = field(default_factory=dict)

    def place(self, depth: int = 0) -> int:
        self.depth.append(depth)
        return len(self.depth) - 1

    def constant(self, value: float) -> int:
        if value not in self.constants:
            self.constants[value] = self.place()
        return self.constants[value]

    def step(self, operation: int, a: int, b: int) -> int:
        self.steps.append((operation, self.place(max(self.depth[a], self.depth[b])), a, b))
        return self.steps[-1][1]

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
        wanted = {place for some in self.functions.values() for taken in some for place in taken}.union(outputs)
        for _, result, *taken in self.steps:
            wanted.update(place for place in taken if self.depth[place] < self.depth[result])
        inner = {result for _, result, *_ in self.steps} - wanted
        # Places that only one program knows come last.
        number = np.argsort(sorted(range(len(self.depth)), key=inner.__contains__))
        parts: list[tuple[list[Step], list[_Function]]] = [([], []) for _ in range(max(self.depth) + 1)]
        for operation, *places in self.steps:
            result, a, b = number[places].tolist()
            parts[self.depth[places[0]]][0].append((operation, result, a, b))
        for (depth, rule), some in self.functions.items():
            taken, results = number[np.array(list(some)).T], number[np.array(list(some.values())).T.ravel()]
            parts[depth - 1][1].append((rule, list(taken), results))
        read = set(number[list(wanted)].tolist())
        given = ({key: int(number[place]) for key, place in each.items()} for each in (self.arguments, self.constants))
        programs = [(Program(steps, read), functions) for steps, functions in parts]
        return Walk(programs, *given, number[outputs], len(number) - len(inner))


def walk_of(expression: ca.SX, symbols: ca.SX) -> Walk:
    """Group the operations of a column of expressions of a column of symbols."""
    function = ca.Function("sc_walk", [symbols], [ca.densify(rebuilt(expression, lowered))], {"cse": True})
    graph, place_of = _Graph(), dict[int, int]()  # CasADi uses places of its work vector again
    outputs = [graph.constant(0.0)] * expression.numel()
    for number, out, used, constant in operations_of(function):
        if number == ca.OP_OUTPUT:
            outputs[out[1]] = place_of[used[0]]
        elif number == ca.OP_CONST:
            place_of[out[0]] = graph.constant(constant)
        elif number == ca.OP_INPUT:
            place_of[out[0]] = graph.arguments[used[1]] = graph.place()
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


def _turned(ring: Arithmetic, a: Model) -> Model:
    return np.concatenate(ring.sine_and_cosine(a), axis=1)


def _stepped(step: Callable[[Array], Array]) -> Rule:
    """Return the rule of a function that rises by jumps: any value between the least and the largest."""

    def rule(ring: Arithmetic, a: Model) -> Model:
        low, high = (step(each) for each in ring.span(a))
        found = ring.constant((low + high) / 2.0)
        found[-1] = (high - low) / 2.0
        return found

    return rule


def _if(_: Arithmetic, condition: Model, a: Model) -> Model:
    """Return `a` where a condition holds, and else zero; both where it is not known to be a number but for rounding."""
    whole = np.round(condition[0])
    known = np.abs(condition[0] - whole) + norm(condition[1:]) < _ROUNDED
    share = np.where(known, whole != 0.0, 0.5)
    found = np.where(share, a, 0.0)
    found[:-1] *= share
    found[-1] += np.where(known, 0.0, norm(a[:-1]) / 2.0 * UP)
    return found


def _no_bound(_: Arithmetic, a: Model, *__: Model) -> Model:
    found = np.zeros_like(a)
    found[-1] = np.inf
    return found


_RULES: dict[int, tuple[Rule, int]] = {
    **dict.fromkeys(KINKS, (_no_bound, 0)), ca.OP_INV: (Arithmetic.inverse, 0), ca.OP_SQRT: (Arithmetic.root, 0),
    ca.OP_SIN: (_turned, 0), ca.OP_COS: (_turned, 1), ca.OP_EXP: (Arithmetic.exponential, 0),
    ca.OP_LOG: (Arithmetic.logarithm, 0), ca.OP_TANH: (Arithmetic.hyperbolic_tangent, 0),
    ca.OP_ATAN2: (Arithmetic.angle, 0), ca.OP_SIGN: (_stepped(np.sign), 0), ca.OP_FLOOR: (_stepped(np.floor), 0),
    ca.OP_IF_ELSE_ZERO: (_if, 0),
}  # fmt: skip
