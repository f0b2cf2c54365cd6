"""Explicit Runge-Kutta steps of the internal dynamics, compiled: where equations give their rates without iterations.

The states of the internal dynamics are stepped with the path's jets at the nodes of every step, and read at any
instants from the polynomial of degree seven through values and rates at four steps. Inputs follow from the states and
the path at the same instant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidModel
from servocore.formulations.reduced import Reduced
from servocore.numerics.compiled_calls import Array
from servocore.numerics.vectorized import Vectorized
from servocore.problem import ResolvedSystem
from servocore.references.base import Reference
from servocore.references.formula import Formula
from servocore.stepping.observation import observed
from servocore.structure.derivative_array import DerivativeArray
from servocore.structure.inversion import compile_explicit

_DENSE = 50_000  # weights
_NODES = 4  # steps whose values and rates belong to one polynomial


class Tableau(NamedTuple):
    """Coefficients of an explicit Runge-Kutta method: nodes (s,), matrix (s, s) and weights (s,)."""

    c: Array
    A: Array
    b: Array


def order_eight() -> Tableau:
    """Return the method of order eight in twelve stages by Dormand and Prince, as SciPy holds it."""
    from scipy.integrate import DOP853  # noqa: PLC0415 - the library is imported where SciPy is not

    return Tableau(DOP853.C, DOP853.A, DOP853.B)


@dataclass(frozen=True, eq=False)
class Between:
    """What states are at some instants of a run of steps evenly apart.

    Attributes
    ----------
    beside : ndarray, shape (4, N)
        The steps beside every instant.
    of_values, of_rates : ndarray, shape (4, N)
        Weights of the values there, and of the rates times h.
    matrices : (ndarray, ndarray) or None
        The same as matrices, shape (steps + 1, N), where these are small: their product costs less than to gather.
    """

    beside: npt.NDArray[np.intp]
    of_values: Array
    of_rates: Array
    matrices: tuple[Array, Array] | None

    @classmethod
    def of(cls, place: Array, count: int) -> Between:
        """Prepare for instants (N,), in steps from the start, of a run of `count` steps."""
        nodes = min(_NODES, count + 1)
        first = np.clip(np.floor(place).astype(np.intp) - (nodes // 2 - 1), 0, count + 1 - nodes)
        s = place - first
        values, rates = np.empty((nodes, len(s))), np.empty((nodes, len(s)))
        for i in range(nodes):
            others = [j for j in range(nodes) if j != i]
            basis = np.prod([(s - j) / (i - j) for j in others], axis=0) ** 2
            slope = sum(1.0 / (i - j) for j in others)
            values[i], rates[i] = (1.0 - 2.0 * slope * (s - i)) * basis, (s - i) * basis
        beside = first + np.arange(nodes)[:, None]
        if count * len(place) > _DENSE:
            return cls(beside, values, rates, None)
        dense = np.zeros((2, count + 1, len(place)))
        for table, weights in zip(dense, (values, rates), strict=True):
            table[beside, np.arange(len(place))] = weights
        return cls(beside, values, rates, (dense[0], dense[1]))

    def states(self, values: Array, rates: Array, h: float) -> Array:
        """Return states (..., states, N) from those of the run and their rates (..., states, count + 1)."""
        interpolated: Array
        if self.matrices is not None:
            # Contiguous, for products of matrices that lie otherwise round otherwise.
            of_values, of_rates = self.matrices
            interpolated = np.ascontiguousarray(values) @ of_values + np.ascontiguousarray(h * rates) @ of_rates
            return interpolated
        interpolated = (values[..., self.beside] * self.of_values + rates[..., self.beside] * (h * self.of_rates)).sum(
            axis=-2
        )
        return interpolated


class Along(NamedTuple):
    """A path as steps and instants need it.

    Attributes
    ----------
    h : float
        Step in s.
    numbers : ndarray
        Of the path, where that is a formula.
    steps, instants : ndarray
        Times of both, or the path's derivatives at the nodes and at the instants.
    between : Between
        Where the instants lie between the steps.
    """

    h: float
    numbers: Array
    steps: Array
    instants: Array
    between: Between

    def of_one(self) -> Along:
        """Return the same without the axis of cases, for a single one."""
        steps, instants = (array[0] if array.ndim > 2 else array for array in (self.steps, self.instants))
        return self._replace(numbers=self.numbers[0], steps=steps, instants=instants)


@dataclass(frozen=True, eq=False)
class ExplicitSteps:
    """Steps and readings of a system on paths of one kind.

    Attributes
    ----------
    steps : Vectorized
        (states, path at the nodes, numbers, [h; p]) -> (states after a step, rates before it), in a row.
    inputs : Vectorized
        (states, path, numbers, p) -> inputs, what must be positive, and what else is wanted, from states at their own
        instants.
    order : int
        Derivatives of the path that the equations take.
    formula : Formula or None
        Whether the path is a formula: times and numbers stand for jets then.
    nodes : ndarray
        Of the method.
    """

    steps: Vectorized
    inputs: Vectorized
    order: int
    formula: Formula | None
    nodes: Array

    def along(self, reference: Reference, t: Array, count: int) -> Along:
        """Prepare for a path, for instants of it (N,), and for so many steps from its start to its end."""
        return self.along_all([reference], t, count).of_one()

    def along_all(self, references: Sequence[Reference], t: Array, count: int) -> Along:
        """Prepare for paths of one kind with the same start and end: what differs has an axis of cases in front."""
        reference = references[0]
        h = reference.duration / count
        starts: Array = reference.start_time + h * np.arange(count + 1.0)
        between = Between.of((t - reference.start_time) / h, count)
        formulas = [reference.formula for reference in references if reference.formula is not None]
        if self.formula is not None and formulas:
            numbers = np.array([formula.numbers(self.order) for formula in formulas])
            return Along(h, numbers, starts[None], t[None], between)
        nodes = (starts[:, None] + h * self.nodes).ravel()
        tables = [
            np.stack([reference.jet(times, self.order).reshape(size, -1).T for reference in references])
            for times, size in ((nodes, count + 1), (t, len(t)))
        ]
        return Along(h, np.zeros((len(references), 1)), tables[0], tables[1], between)

    def run(self, along: Along, p: Array, start: Array) -> tuple[Array, Array]:
        """Step from the start of a path to its end; return states and rates (states, count + 1).

        `start` has shape (states,), `p` (size,); with cases, (cases, states) and (cases, size) give
        (cases, states, count + 1).
        """
        settings = np.concatenate([np.full((*p.shape[:-1], 1), along.h), p], axis=-1)
        ends, rates = self.steps(start, along.steps, along.numbers, settings)
        return np.concatenate([start[..., None], ends[..., :-1]], axis=-1), rates

    def inputs_along(self, along: Along, p: Array, start: Array) -> Array:
        """Return what `inputs` gives at the instants, (columns, N), or (cases, columns, N)."""
        states = along.between.states(*self.run(along, p, start), along.h)
        return self.inputs(states, along.instants, along.numbers, p)[0]


def compile_explicit_steps(
    resolved: ResolvedSystem, formula: Formula | None, native: bool | None, names: tuple[str, ...] = ()
) -> ExplicitSteps:
    """Compile steps and inputs, and quantities of some names; meant for `ResolvedSystem.once`.

    Raises
    ------
    InvalidModel
        If the equations do not give the rates of the states without iterations.
    """
    explicit, array, system = resolved.once(compile_explicit), resolved.array, resolved.system
    if explicit is None:
        raise InvalidModel(f"{system.name}: the rates of its internal dynamics take iterations; sc.solve steps them")
    order, count = array.reference_order, len(array.states)
    x, hp = ca.SX.sym("x", count), ca.SX.sym("hp", 1 + system.p.numel())
    p, time, numbers = hp[1:], ca.SX.sym("t"), ca.SX.sym("n", len(formula.numbers(order)) if formula else 1)
    size = system.gamma.size1()
    method = order_eight()
    stages = range(len(method.c))
    tables = [ca.SX.sym("gamma", size, order + 1) for _ in stages]

    def jet(k: int) -> ca.SX:
        if formula is None:
            return tables[k]
        return ca.horzcat(*formula.jet(time + float(method.c[k]) * hp[0], ca.vertsplit(numbers), order))

    rates = list[ca.SX]()
    for k in stages:
        inner = sum((float(a) * rate for a, rate in zip(method.A[k], rates, strict=False) if a), ca.SX.zeros(count))
        rates.append(_rates(array, explicit(jet(k), p, x + hp[0] * inner)))
    after = x + hp[0] * sum((float(b) * rate for b, rate in zip(method.b, rates, strict=True)), ca.SX.zeros(count))
    path = time if formula else ca.vertcat(*map(ca.vec, tables))
    step = ca.Function("sc_explicit_step", [x, path, numbers, hp], [after, rates[0]], {"cse": True})
    q = ca.SX.sym("p", system.p.numel())
    now = tables[0] if formula is None else ca.horzcat(*formula.jet(time, ca.vertsplit(numbers), order))
    results = _read_off(resolved, explicit(now, q, x), now, q, names)
    read = ca.Function(
        "sc_inputs", [x, time if formula else ca.vec(now), numbers, q], [ca.densify(results)], {"cse": True}
    )
    return ExplicitSteps(
        Vectorized(step, (False, True, False, False), native, system.name, in_a_row=True),
        Vectorized(read, (True, True, False, False), native, system.name),
        order,
        formula,
        method.c,
    )


def _read_off(resolved: ResolvedSystem, unknowns: ca.SX, gamma: ca.SX, p: ca.SX, names: tuple[str, ...]) -> ca.SX:
    """Return what is read as expressions of the unknowns of the array, the path and parameters."""
    system, array, dae = resolved.system, resolved.array, resolved.dae(Reduced())
    positive = [expression for quantity, expression in system.observables.items() if quantity.positive]
    known = {quantity.name: expression for quantity, expression in observed(system)}
    wanted = ca.substitute(
        ca.vertcat(system.u, *positive, *(known[name] for name in names)),
        ca.vertcat(system.q, system.v, system.lam, system.u),
        ca.vertcat(*(dae.physical[name] for name in ("q", "v", "lam", "u"))),
    )
    symbols = ca.vertcat(dae.x, dae.z, ca.vec(system.gamma[:, : gamma.size2()]), system.p)
    values = [unknowns[array.places(chosen)] for chosen in (array.states, array.determined)]
    return ca.substitute(wanted, symbols, ca.vertcat(*values, ca.vec(gamma), p))


def _rates(array: DerivativeArray, unknowns: ca.SX) -> ca.SX:
    return unknowns[array.places((j, order + 1) for j, order in array.states)]
