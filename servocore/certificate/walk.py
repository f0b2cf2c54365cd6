"""Enclosures of CasADi expressions: their operations carried out on Chebyshev models, many at once.

Operations of one kind with known arguments are carried out together, over all boxes. Operations on numbers alone are
computed once, as balls. Operations with a kink or a jump are enclosed where their argument stays on one side
of it; elsewhere their radius is infinite, and nothing that depends on them is proved.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TypeAlias

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.certificate.chebyshev import Arithmetic, Model, arithmetic
from servocore.numerics.compiled_calls import Array
from servocore.numerics.step_operations import KINKS, computed, operations_of, rebuilt

Places: TypeAlias = npt.NDArray[np.intp]

_BALL = arithmetic((0,))
_BY_NUMBERS = {(ca.OP_MUL, 0, True), (ca.OP_MUL, 1, True), (ca.OP_DIV, 1, True)}  # operation, argument, whether flat
_MOST_MULTIPLIED = 32  # whole powers up to this are products, others exp(b log(a))


@dataclass(frozen=True, eq=False)
class Group:
    """Operations of one kind that are carried out together.

    Attributes
    ----------
    operation : int
        Its number in CasADi.
    results : ndarray of int
        Places of the results.
    arguments : tuple of ndarray of int
        Places of the arguments.
    flat : tuple of bool
        Whether each argument depends on numbers alone; of all, the results do as well.
    """

    operation: int
    results: Places
    arguments: tuple[Places, ...]
    flat: tuple[bool, ...]


@dataclass(frozen=True, eq=False)
class Walk:
    """An expression's operations in groups: arguments first, then results.

    Attributes
    ----------
    groups : tuple of Group
        In an order in which arguments are known.
    inputs : ndarray of int, shape (arguments, 2)
        Places and numbers of the inputs that are used.
    constants : tuple of (ndarray of int, ndarray)
        Places and values of the numbers.
    outputs : ndarray of int
        Place of every entry of the result.
    places : int
        How many there are.
    """

    groups: tuple[Group, ...]
    inputs: Places
    constants: tuple[Places, Array]
    outputs: Places
    places: int

    def __call__(self, ring: Arithmetic, arguments: Model) -> Model:
        """Return models of the results from models of all arguments (terms, arguments, boxes)."""
        c = np.zeros((len(arguments[0]), self.places, arguments[0].shape[2]))
        r = np.zeros(c.shape[1:])
        places, values = self.constants
        c[0, places] = values[:, None]
        c[:, self.inputs[:, 0]], r[self.inputs[:, 0]] = (part[..., self.inputs[:, 1], :] for part in arguments)
        for group in self.groups:
            flat = all(group.flat)
            one_box = [flat or (group.operation, *each) in _BY_NUMBERS for each in enumerate(group.flat)]
            taken = [
                (c[:1, each, :1], r[each, :1]) if one else (c[:, each], r[each])
                for each, one in zip(group.arguments, one_box, strict=True)
            ]
            found = _carried_out(_BALL if flat else ring, group, taken)
            c[: len(found[0]), group.results], r[group.results] = found
        return c[:, self.outputs], r[self.outputs]


def _carried_out(ring: Arithmetic, group: Group, taken: Sequence[Model]) -> Model:
    """Return the results of a group."""
    if group.operation == ca.OP_MUL and any(group.flat) and not all(group.flat):
        return ring.scaled(*(taken if group.flat[1] else taken[::-1]))
    if group.operation == ca.OP_DIV and group.flat == (False, True):
        return ring.scaled(taken[0], _BALL.quotient(_BALL.constant(np.ones_like(taken[1][1])), taken[1]))
    return _RULES[group.operation](ring, *taken)


def walk_of(expression: ca.SX, symbols: ca.SX, numbers: tuple[int, ...] = ()) -> Walk:
    """Group the operations of a column of expressions of a column of symbols; `numbers` are alike on all boxes.

    Raises
    ------
    InvalidModel
        If they hold an operation without an enclosure.
    """
    function = ca.Function("sc_walk", [symbols], [ca.densify(rebuilt(expression, _lowered))], {"cse": True})
    place_of: dict[int, int] = {}  # CasADi uses places of its work vector again
    level, flat = list[int](), list[bool]()
    constants, inputs = list[tuple[int, float]](), list[tuple[int, int]]()
    outputs = np.zeros(expression.numel(), dtype=np.intp)
    grouped: dict[tuple[int, int, tuple[bool, ...]], list[tuple[int, ...]]] = {}
    for number, out, used, constant in operations_of(function):
        if number == ca.OP_OUTPUT:
            outputs[out[1]] = place_of[used[0]]
            continue
        arguments = [] if number in {ca.OP_CONST, ca.OP_INPUT} else [place_of[each] for each in used]
        place = place_of[out[0]] = len(level)
        level.append(1 + max((level[each] for each in arguments), default=-1))
        flat.append(used[1] in numbers if number == ca.OP_INPUT else all(flat[each] for each in arguments))
        if number == ca.OP_CONST:
            constants.append((place, constant))
        elif number == ca.OP_INPUT:
            inputs.append((place, used[1]))
        else:
            kinds = tuple(flat[each] for each in arguments)
            grouped.setdefault((level[place], number, kinds), []).append((place, *arguments))
    groups = []
    for (_, number, kinds), members in sorted(grouped.items()):
        columns = np.array(members, dtype=np.intp).T
        groups.append(Group(number, columns[0], tuple(columns[1:]), kinds))
    places = np.array([place for place, _ in constants], dtype=np.intp), np.array([value for _, value in constants])
    return Walk(tuple(groups), np.array(inputs, dtype=np.intp).reshape(-1, 2), places, outputs, len(level))


def _lowered(operation: int, taken: Sequence[ca.SX]) -> ca.SX:
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


_LOWERED: dict[int, Callable[..., ca.SX]] = {
    ca.OP_POW: _power, ca.OP_CONSTPOW: _power, ca.OP_TAN: _tangent,
    ca.OP_ATAN: lambda a: ca.atan2(a, ca.SX(1.0)), ca.OP_ASIN: lambda a: ca.atan2(a, ca.sqrt(1.0 - a * a)),
    ca.OP_ACOS: lambda a: ca.atan2(ca.sqrt(1.0 - a * a), a), ca.OP_SINH: lambda a: (ca.exp(a) - ca.exp(-a)) / 2.0,
    ca.OP_COSH: lambda a: (ca.exp(a) + ca.exp(-a)) / 2.0, ca.OP_HYPOT: lambda a, b: ca.sqrt(a * a + b * b),
}  # fmt: skip


def _one_side(ring: Arithmetic, a: Model) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Return where models are positive, and where they are negative."""
    low, high = ring.span(a)
    return low > 0.0, high < 0.0


def _chosen(ring: Arithmetic, level: Model, positive: Model, negative: Model) -> Model:
    """Return one model where a level is positive, another where it is negative, and no bound elsewhere."""
    above, below = _one_side(ring, level)
    c = np.where(above, positive[0], negative[0])
    return c, np.where(above, positive[1], np.where(below, negative[1], np.inf))


def _number(ring: Arithmetic, like: Model, value: float) -> Model:
    return ring.constant(np.full_like(like[1], value))


def _negative(_: Arithmetic, a: Model) -> Model:
    return -a[0], a[1]


def _tanh(ring: Arithmetic, a: Model) -> Model:
    """Return tanh(a) = 1 - 2/(e^(2 a) + 1); beyond 20 it is 1 but for 2 e^(-40) < 1e-17."""
    one, (low, high) = _number(ring, a, 1.0), ring.span(a)
    share = ring.quotient(_number(ring, a, 2.0), ring.sum(ring.exponential((2.0 * a[0], 2.0 * a[1])), one))
    c, r = ring.sum(one, share, -1.0)
    saturated = (low > 20.0) | (high < -20.0)
    return np.where(saturated, ring.constant(np.sign(low))[0], c), np.where(saturated, 1e-17, r)


def _steps(ring: Arithmetic, a: Model) -> Model:
    low, high = (np.floor(each) for each in ring.span(a))
    c, r = ring.constant(low)
    return c, np.where(low == high, r, np.inf)


def _no_bound(ring: Arithmetic, *taken: Model) -> Model:
    c, r = ring.constant(np.zeros_like(taken[0][1]))
    return c, np.full_like(r, np.inf)


def _truth(ring: Arithmetic, values: npt.ArrayLike, known: npt.ArrayLike) -> Model:
    """Return conditions, 0 or 1; where they are not known, without a bound."""
    c, r = ring.constant(np.asarray(values, dtype=np.float64))
    return c, np.where(known, r, np.inf)


def _logic(holds: Callable[..., Array]) -> Callable[..., Model]:
    return lambda ring, *each: _truth(
        ring, holds(*(a[0][0] != 0.0 for a in each)), np.logical_and.reduce([a[1] == 0.0 for a in each])
    )


def _less(ring: Arithmetic, a: Model, b: Model) -> Model:
    below, above = _one_side(ring, ring.sum(b, a, -1.0))
    return _truth(ring, below, below | above)


def _if(_: Arithmetic, condition: Model, a: Model) -> Model:
    """Return `a` where a condition holds, and else zero."""
    holds = condition[0][0] != 0.0
    return np.where(holds, a[0], 0.0), np.where(condition[1] == 0.0, np.where(holds, a[1], 0.0), np.inf)


_RULES: dict[int, Callable[..., Model]] = {
    ca.OP_ASSIGN: lambda _, a: a,
    ca.OP_ADD: lambda ring, a, b: ring.sum(a, b),
    ca.OP_SUB: lambda ring, a, b: ring.sum(a, b, -1.0),
    ca.OP_MUL: lambda ring, a, b: ring.product(a, b),
    ca.OP_DIV: lambda ring, a, b: ring.quotient(a, b),
    ca.OP_NEG: _negative,
    ca.OP_TWICE: lambda _, a: (2.0 * a[0], 2.0 * a[1]),
    ca.OP_SQ: lambda ring, a: ring.product(a, a),
    ca.OP_INV: lambda ring, a: ring.quotient(_number(ring, a, 1.0), a),
    ca.OP_SQRT: lambda ring, a: ring.root(a),
    ca.OP_SIN: lambda ring, a: ring.sine_and_cosine(a)[0],
    ca.OP_COS: lambda ring, a: ring.sine_and_cosine(a)[1],
    ca.OP_EXP: lambda ring, a: ring.exponential(a),
    ca.OP_LOG: lambda ring, a: ring.logarithm(a),
    ca.OP_TANH: _tanh,
    ca.OP_ATAN2: lambda ring, a, b: ring.angle(a, b),
    ca.OP_FABS: lambda ring, a: _chosen(ring, a, a, _negative(ring, a)),
    ca.OP_SIGN: lambda ring, a: _chosen(ring, a, _number(ring, a, 1.0), _number(ring, a, -1.0)),
    ca.OP_FMAX: lambda ring, a, b: _chosen(ring, ring.sum(a, b, -1.0), a, b),
    ca.OP_FMIN: lambda ring, a, b: _chosen(ring, ring.sum(a, b, -1.0), b, a),
    ca.OP_LT: _less,
    ca.OP_LE: _less,
    ca.OP_NOT: _logic(np.logical_not),
    ca.OP_AND: _logic(np.logical_and),
    ca.OP_OR: _logic(np.logical_or),
    ca.OP_IF_ELSE_ZERO: _if,
    ca.OP_FLOOR: _steps,
}  # fmt: skip
_RULES.update({kink: _no_bound for kink in KINKS if kink not in _RULES})
