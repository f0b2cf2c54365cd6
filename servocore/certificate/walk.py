"""Enclosures of CasADi expressions: their operations carried out on Chebyshev models, many at once.

Sums and products are programs; between them stand the operations that are interpolated, those of one kind with known
arguments together. Operations with a kink or a jump are products with the sign of a level, which is between -1 and 1
where that may come to zero.
"""

from __future__ import annotations

import math
import threading
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import TypeAlias

import casadi as ca
import numpy as np

from servocore.certificate.chebyshev import LANES, MINUS, PLUS, TIMES, Arithmetic, Model, bounded, carry_out, magnitude
from servocore.numerics.compiled_calls import Array, Mask
from servocore.numerics.step_operations import computed, holds_any, operations_of, rebuilt

Rule: TypeAlias = Callable[..., Model]
_Functions: TypeAlias = defaultdict[Rule, dict[tuple[int, ...], int]]
"""Of each rule the places of results by those of their arguments."""


class _Workspace(threading.local):
    """Memory for models, the same for all walks of a thread: pages of fresh memory take as long as operations."""

    def __init__(self) -> None:
        numbers = np.empty(1 << 21)  # pages that are never used take no memory
        self._numbers = numbers[-numbers.ctypes.data // 8 % 8 :]  # they begin with a line of memory

    def of(self, *shape: int) -> Array:
        """Return an array of any values, valid until the next call."""
        size = math.prod(shape)
        return self._numbers[:size].reshape(shape) if size <= len(self._numbers) else np.empty(shape)


_workspace = _Workspace()


class Walk:
    """An expression's operations in programs, and between them what is interpolated.

    The depth of a place is the number of interpolations before it: at each depth there is a program, then the functions
    of what is then known. Every result has a place of its own. Sums of squares are known to be such: models of them may
    have negative values, and still they have roots.

    Parameters
    ----------
    expression : casadi.SX
        A column.
    symbols : casadi.SX
        A column: the arguments.
    """

    def __init__(self, expression: ca.SX, symbols: ca.SX) -> None:
        self._depth = [0] * symbols.numel()  # the arguments have the first places
        self._constants = defaultdict[float, int](self._place)
        self._squares = set[int]()
        self._steps = defaultdict[int, list[tuple[int, ...]]](list)
        self._functions = defaultdict[int, _Functions](lambda: defaultdict(dict))
        if holds_any(expression, {*_LOWERED}):
            expression = rebuilt(expression, lowered)
        function = ca.Function("sc_walk", [symbols], [ca.densify(expression)], {"cse": True})
        outputs, place_of = dict[int, int](), dict[int, int]()
        for number, out, used, constant in operations_of(function):  # CasADi uses places of its work vector again
            if number == ca.OP_OUTPUT:
                outputs[out[1]] = place_of[used[0]]
            elif number == ca.OP_CONST:
                place_of[out[0]] = self._constants[constant]
                if constant >= 0.0:
                    self._squares.add(self._constants[constant])
            elif number == ca.OP_INPUT:
                place_of[out[0]] = used[1]
            else:
                place_of[out[0]] = self._operation(number, [place_of[each] for each in used])
        self._outputs = np.array([outputs[k] for k in sorted(outputs)], dtype=np.intp)
        self._values = np.array([*self._constants])[:, None]
        self._programs = [
            np.array(self._steps[k], dtype=np.intp).reshape(-1, 4) for k in range(max(self._depth, default=0) + 1)
        ]

    @np.errstate(all="ignore")  # what is not finite has no bound
    def __call__(self, ring: Arithmetic, arguments: Model) -> Model:
        """Return models of the results from models of all arguments (terms + 1, arguments, boxes)."""
        boxes = arguments.shape[2]
        if boxes < LANES:  # the last box is repeated
            arguments = arguments[..., np.minimum(np.arange(LANES), boxes - 1)]
        places = _workspace.of(len(self._depth), *arguments.shape[::2])
        models = places.swapaxes(0, 1)
        models[:, : arguments.shape[1]] = arguments
        models[:, [*self._constants.values()]] = ring.constant(self._values)
        for depth, steps in enumerate(self._programs):
            for rule, results in self._functions[depth].items():
                models[:, [*results.values()]] = rule(ring, *(models[:, each] for each in zip(*results, strict=True)))
            carry_out(steps, ring, places)
        return bounded(models[:, self._outputs, :boxes])

    def _place(self, depth: int = 0) -> int:
        self._depth.append(depth)
        return len(self._depth) - 1

    def _operation(self, number: int, arguments: list[int]) -> int:
        """Return the place of an operation's result; that of a function is the same for the same arguments."""
        a, b = arguments[0], arguments[-1]
        if number == ca.OP_DIV:
            b = self._operation(ca.OP_INV, [b])
        elif number == ca.OP_NEG:
            a = self._constants[0.0]
        depth = max(self._depth[a], self._depth[b])
        if number in _STEPS:
            self._steps[depth].append((_STEPS[number], place := self._place(depth), a, b))
            if number == ca.OP_SQ or (number in _KEEPING and {a, b} <= self._squares):
                self._squares.add(place)
            return place
        rule, known = _RULES.get(number, _no_bound), tuple(arguments if number in _RULES else arguments[:1])
        if number == ca.OP_SQRT and a in self._squares:
            rule = _root_of_squares
        results = self._functions[depth + 1][rule]
        return results.get(known) or results.setdefault(known, self._place(depth + 1))


# In terms of other operations -----------------------------------------------------------------------------------------


def lowered(operation: int, taken: Sequence[ca.SX]) -> ca.SX:
    """Return an operation's result in terms of operations that have rules."""
    rule = _LOWERED.get(operation)
    return rule(*taken) if rule else computed(operation, taken)


def _power(a: ca.SX, b: ca.SX) -> ca.SX:
    return ca.exp(b * ca.log(a))  # whole powers up to a hundred are products of CasADi's


def _cosine(sine: ca.SX) -> ca.SX:
    return ca.sqrt(1.0 - sine) * ca.sqrt(1.0 + sine)


def _tangent(a: ca.SX) -> ca.SX:
    return ca.sin(a) / ca.cos(a)


_LOWERED: dict[int, Callable[..., ca.SX]] = {
    ca.OP_POW: _power, ca.OP_CONSTPOW: _power, ca.OP_TAN: _tangent,
    ca.OP_ATAN: lambda a: ca.atan2(a, ca.SX(1.0)), ca.OP_ASIN: lambda a: ca.atan2(a, _cosine(a)),
    ca.OP_ACOS: lambda a: ca.atan2(_cosine(a), a), ca.OP_SINH: lambda a: (ca.exp(a) - ca.exp(-a)) / 2.0,
    ca.OP_COSH: lambda a: (ca.exp(a) + ca.exp(-a)) / 2.0, ca.OP_HYPOT: lambda a, b: ca.sqrt(a * a + b * b),
    ca.OP_ASINH: lambda a: ca.log(a + ca.sqrt(a * a + 1.0)), ca.OP_LOG1P: lambda a: ca.log(1.0 + a),
    ca.OP_ACOSH: lambda a: ca.log(a + ca.sqrt(a - 1.0) * ca.sqrt(a + 1.0)), ca.OP_FABS: lambda a: a * ca.sign(a),
    ca.OP_ATANH: lambda a: ca.log((1.0 + a) / (1.0 - a)) / 2.0, ca.OP_EXPM1: lambda a: ca.exp(a) - ca.SX(1.0),
    ca.OP_LT: lambda a, b: computed(ca.OP_LT, [ca.SX(0.0), b - a]),
    ca.OP_LE: lambda a, b: computed(ca.OP_LE, [ca.SX(0.0), b - a]), ca.OP_CEIL: lambda a: -computed(ca.OP_FLOOR, [-a]),
    ca.OP_FMAX: lambda a, b: (a + b + (a - b) * ca.sign(a - b)) / 2.0,
    ca.OP_FMIN: lambda a, b: (a + b - (a - b) * ca.sign(a - b)) / 2.0,
    ca.OP_CALL: lambda *taken: computed(ca.OP_CALL, taken) + np.nan,  # of an external function: it has no bound
}  # fmt: skip

CONSTANT = {ca.OP_SIGN, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR}
"""Operations that are constant between jumps."""

_STEPS = {
    ca.OP_ADD: PLUS, ca.OP_TWICE: PLUS, ca.OP_SUB: MINUS, ca.OP_NEG: MINUS,
    ca.OP_MUL: TIMES, ca.OP_SQ: TIMES, ca.OP_DIV: TIMES,
}  # fmt: skip

_KEEPING = {ca.OP_ADD, ca.OP_TWICE, ca.OP_MUL}
"""Operations whose result is no less than zero where the arguments are."""

# Rules ----------------------------------------------------------------------------------------------------------------


def _truth(ring: Arithmetic, a: Model) -> tuple[Mask, Mask]:
    """Return whether values are surely, and whether they may be, a condition that holds: any number but zero."""
    low, high = ring.span(a)
    return (low > 0.0) | (high < 0.0), (low != 0.0) | (high != 0.0)


def _if(ring: Arithmetic, condition: Model, a: Model) -> Model:
    """Return `a` where a condition holds, and else zero; both where it may hold or not."""
    sure, possible = _truth(ring, condition)
    found = np.where(possible, a, 0.0)
    found[:-1] *= np.where(sure, 1.0, 0.5)
    found[-1] += np.where(possible & ~sure, magnitude(a[:-1]) / 2.0, 0.0)
    return found


def _logical(operation: Callable[..., Mask]) -> Rule:
    """Return the rule of an operation on conditions: 1 or 0, and both where it is not known."""

    def carried_out(ring: Arithmetic, *models: Model) -> Model:
        one, other = (operation(*each) for each in zip(*(_truth(ring, a) for a in models), strict=True))
        found = ring.constant(np.where(one, 0.5, 0.0) + np.where(other, 0.5, 0.0))
        found[-1] = (one != other) / 2.0
        return found

    return carried_out


def _no_bound(_: Arithmetic, a: Model) -> Model:
    found = np.zeros_like(a)
    found[-1] = np.inf
    return found


def _root_of_squares(ring: Arithmetic, a: Model) -> Model:
    return ring.root(a, 0.0)


_RULES: dict[int, Rule] = {
    ca.OP_INV: Arithmetic.inverse, ca.OP_SQRT: Arithmetic.root,
    ca.OP_SIN: lambda ring, a: ring.sine_and_cosine(a)[0], ca.OP_COS: lambda ring, a: ring.sine_and_cosine(a)[1],
    ca.OP_EXP: Arithmetic.exponential, ca.OP_LOG: Arithmetic.logarithm, ca.OP_TANH: Arithmetic.hyperbolic_tangent,
    ca.OP_ATAN2: Arithmetic.angle, ca.OP_SIGN: lambda ring, a: ring.rising(np.sign, a),
    ca.OP_FLOOR: lambda ring, a: ring.rising(np.floor, a),
    ca.OP_LT: lambda ring, _, a: ring.rising(lambda x: np.heaviside(x, 0.0), a),
    ca.OP_LE: lambda ring, _, a: ring.rising(lambda x: np.heaviside(x, 1.0), a), ca.OP_IF_ELSE_ZERO: _if,
    ca.OP_NOT: _logical(np.logical_not), ca.OP_AND: _logical(np.logical_and), ca.OP_OR: _logical(np.logical_or),
}  # fmt: skip
