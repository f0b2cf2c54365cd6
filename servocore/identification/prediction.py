"""Inputs and measured positions of a model without internal dynamics, and their information on parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from servocore.effects.position_loops import is_position, reported
from servocore.model.quantity import Quantity
from servocore.model.system import reference_symbols
from servocore.numerics.angle_wrapping import wrapped_angle
from servocore.numerics.compiled_calls import Array, at_instants
from servocore.numerics.memoization import made_once
from servocore.numerics.vectorized import Vectorized
from servocore.problem import Problem, ResolvedSystem, resolve
from servocore.stepping.readings import reading
from servocore.structure.inversion import LARGEST_RESIDUAL, inversion

DELAY = 0.005
"""Standard deviation of the delay of an input behind the positions before anything is measured, in s."""

_SHOWS = 0.25  # of its uncertainty is left of a combination that a motion shows
_AMPLITUDE, _PERIODS = 0.5, (4.0, 2.9, 2.3)  # of the motions that are tried, in the unit of the output and s
_TRIED = np.linspace(0.0, 20.0, 201)


class Predicted(NamedTuple):
    """Channels at N instants: inputs, then positions.

    Attributes
    ----------
    values : ndarray, shape (N, channels)
        NaN where the model has no solution.
    by_path : ndarray, shape (N, channels, orders, outputs)
        Derivatives by the jet of the path.
    by_parameter : ndarray, shape (N, channels, parameters)
        Derivatives by the chosen parameters.
    """

    values: Array
    by_path: Array
    by_parameter: Array


@dataclass(frozen=True, eq=False)
class Prediction:
    """The channels of a model as functions of the jet of its output and of its parameters.

    Attributes
    ----------
    resolved : ResolvedSystem
        Without internal dynamics, as `released` returns it.
    measured : tuple of str
        Quantities that depend on the configuration alone.
    columns : tuple of int
        Of the parameters by which it is differentiated.
    inputs : int
        Number of inputs that a log has; the other ones of the system are forces of `released`, which are zero.
    """

    resolved: ResolvedSystem
    measured: tuple[str, ...]
    columns: tuple[int, ...]
    inputs: int

    @cached_property
    def quantities(self) -> tuple[Quantity, ...]:
        """Inputs, then measured quantities."""
        known = reported(self.resolved.system)
        return (*self.resolved.system.inputs, *(known[name][0] for name in self.measured))

    def wrapped(self, differences: Array, first: int = 0) -> Array:
        """Return differences (N, channels from `first`) with those of angles between half a turn to both sides."""
        return np.where([each.wraps for each in self.quantities[first:]], wrapped_angle(differences), differences)

    def __call__(self, jets: Array, p: Array) -> Predicted:
        """Return the channels for jets (N, orders, outputs) and all parameters."""
        values, slopes = self._evaluated(jets, p, self.columns)
        by_path, by_parameter = np.split(slopes.T.reshape(len(jets), -1, len(values)), [jets[0].size], axis=1)
        by_path = np.moveaxis(by_path.reshape(*jets.shape, -1), 3, 1)
        return Predicted(values.T, by_path, np.moveaxis(by_parameter, 2, 1))

    def values(self, jets: Array, p: Array) -> Array:
        """Return the channels (N, channels) without derivatives, which take most of the time."""
        return self._evaluated(jets, p, None)[0].T

    def _evaluated(self, jets: Array, p: Array, columns: tuple[int, ...] | None) -> list[Array]:
        flat = jets.reshape(len(jets), -1).T
        *found, residual = _explicit(self.resolved, self.measured, columns)(flat, p)
        if not (residual < LARGEST_RESIDUAL).all():  # the guess of the model is not exact: by Newton's method
            unknowns = at_instants(inversion(self.resolved.array).function, jets=jets, p=p)[0]
            found = _implicit(self.resolved, self.measured, self.columns)(unknowns, flat, p)
        return found


def prediction_of(problem: Problem, names: Sequence[str], measured: Sequence[str] = ()) -> tuple[Prediction, Array]:
    """Return the channels of a problem with the derivatives by some parameters, and the units of these: their values.

    A parameter that is zero has the unit one.
    """
    columns = [problem.system.parameters.names.index(name) for name in names]
    scales = np.abs(problem.p[columns])
    inputs, resolved = len(problem.system.inputs), released(problem.resolved)
    return Prediction(resolved, tuple(measured), tuple(columns), inputs), np.where(scales > 0.0, scales, 1.0)


def positions_of(resolved: ResolvedSystem) -> dict[str, Quantity]:
    """Return the quantities that a log may measure beside the inputs, by name: those of the configuration alone."""
    known = reported(resolved.system)
    return {name: quantity for name, (quantity, each) in known.items() if is_position(resolved.system, each)}


def _channels(resolved: ResolvedSystem, measured: tuple[str, ...]) -> ca.Function:
    known = reported(resolved.system)
    return reading(resolved, [resolved.system.u, *(known[name][1] for name in measured)])


@made_once
def released(resolved: ResolvedSystem) -> ResolvedSystem:
    """Return a system without internal dynamics: coordinates that the output leaves free are outputs of their own.

    A force acts along each of them, which a log knows to be zero. So the equations of the internal dynamics are
    channels as the inputs are, and their states are on the path: no initial values, no stability.
    """
    system, n = resolved.system, len(resolved.system.coordinates)
    free = sorted({k for k, _ in resolved.array.states if k < n})
    if not free:
        return resolved
    known = [system.coordinates.quantities[k] for k in free]
    forces = tuple(Quantity(f"force on {each.name}") for each in known)
    paths, guess, start = reference_symbols(len(free)), ca.SX(system.guess), system.home_configuration()[0][free]
    guess[free] = paths[:, 0]
    extended = replace(
        system, inputs=(*system.inputs, *forces), u=ca.vertcat(system.u, ca.SX.sym("force", len(free))),
        outputs=(*system.outputs, *known), output=ca.vertcat(system.output, system.q[free]),
        input_matrix=ca.vertcat(system.input_matrix, -ca.SX.eye(n)[free, :]), guess=guess,
        gamma=ca.vertcat(system.gamma, paths), home=(*system.home, *start.tolist()),
    )  # fmt: skip
    return resolve(extended, extended.home_parameters)


@made_once
def _explicit(resolved: ResolvedSystem, measured: tuple[str, ...], columns: tuple[int, ...] | None) -> Vectorized:
    """Compile (gamma, p) -> channels, derivatives and the residual, by the guess of the model where that is exact.

    The residual is infinite for a model whose inversion is no expression. There are no derivatives without columns.
    """
    expression, array, system = inversion(resolved.array).differentiable, resolved.array, resolved.system
    read = _channels(resolved, measured)
    gamma = ca.SX.sym("gamma", system.gamma.size1(), array.reference_order + 1)
    p = ca.SX.sym("p", system.p.numel())
    if expression is None:
        channels, residual = ca.SX(np.full(read.numel_out(0), np.nan)), ca.SX(np.inf)
    else:
        unknowns, _, residual = expression(gamma, p)
        channels = read(unknowns, gamma, p)
    slopes = [] if columns is None else [ca.jacobian(channels, ca.vertcat(ca.vec(gamma), p[list(columns)]))]
    results = [ca.densify(each) for each in (channels, *slopes, residual)]
    function = ca.Function("sc_channels", [gamma, p], results, {"cse": True})
    return Vectorized(function, (True, False), None, system.name)


@made_once
def _implicit(resolved: ResolvedSystem, measured: tuple[str, ...], columns: tuple[int, ...]) -> Vectorized:
    """Compile (unknowns of the derivative array, gamma, p) -> the same, by the implicit function theorem."""
    array, system = resolved.array, resolved.system
    column, gamma = array.column(array.unknowns), system.gamma[:, : array.reference_order + 1]
    given = ca.vertcat(ca.vec(gamma), system.p[list(columns)])
    channels = _channels(resolved, measured)(column, gamma, system.p)
    jacobians = (ca.jacobian(each, by) for each in (channels, array.residual) for by in (column, given))
    terms = ca.Function("sc_terms", [column, gamma, system.p], [channels, *jacobians])
    symbols = [ca.MX.sym(f"x{k}", *terms.size_in(k)) for k in range(3)]
    values, by_unknowns, by_given, J, right = terms(*symbols)
    total = by_given - ca.mtimes(by_unknowns, ca.solve(J, right, "qr"))
    function = ca.Function("sc_channels", symbols, [ca.densify(each) for each in (values, total)])
    return Vectorized(function, (True, True, False), False, system.name)


def information(prediction: Prediction, jets: Array, step: float, p: Array, scales: Array, noise: Array) -> Array:
    """Return the information of the inputs on parameters, relative to their scales, shape (parameters, parameters).

    The motion counts as known, as fine encoders show it; biases of inputs are free, and their delays nearly so.

    Parameters
    ----------
    prediction : Prediction
        Of the channels.
    jets : ndarray, shape (N, orders, outputs)
        The motion, at instants `step` seconds apart.
    p : ndarray
        All parameters.
    scales : ndarray, shape (parameters,)
        Units of the estimates.
    noise : ndarray, shape (inputs,)
        Standard deviation of an input at one instant.
    """
    m = len(noise)
    predicted = prediction(jets, p)
    rows = predicted.by_parameter[:, :m] * scales / noise[:, None]
    rates = np.gradient(predicted.values[:, :m], step, axis=0) / noise
    nuisance = np.stack([np.broadcast_to(1.0 / noise, rates.shape), rates], axis=2)
    inner = np.einsum("nki,nkj->kij", nuisance, nuisance) + np.diag([0.0, DELAY**-2])
    mixed, both = np.einsum("nki,nkp->kip", nuisance, rows), ([0, 1], [0, 1])
    return np.tensordot(rows, rows, both) - np.tensordot(mixed, np.linalg.solve(inner, mixed), both)


def showing(
    prediction: Prediction, place: Array, p: Array, scales: Array, noise: Array, direction: Array, spread: float
) -> str:
    """Return the smallest motion about a place that shows a combination of parameters; empty if none was found.

    Parameters
    ----------
    prediction, p, scales, noise
        See `information`.
    place : ndarray, shape (outputs,)
        A position of the output.
    direction : ndarray, shape (parameters,)
        The combination, of length one in `scales`.
    spread : float
        Its standard deviation.
    """
    names = [quantity.name for quantity in prediction.resolved.system.outputs]
    step = float(_TRIED[1] - _TRIED[0])
    orders = prediction.resolved.array.reference_order + 1
    for moving in [*([k] for k in range(len(names))), list(range(len(names)))]:
        jets = np.zeros((len(_TRIED), orders, len(names)))
        jets[:, 0] = place
        for k in moving:
            rate = 2 * np.pi / _PERIODS[k % len(_PERIODS)]
            for order in range(orders):
                jets[:, order, k] += _AMPLITUDE * rate**order * np.sin(rate * _TRIED + np.pi / 2 * order)
        found = information(prediction, jets, step, p, scales, noise)
        if np.isfinite(found).all() and 1.0 / np.sqrt(1.0 + spread**2 * direction @ found @ direction) < _SHOWS:
            return f"moving {' and '.join(names[k] for k in moving)} to and fro by {_AMPLITUDE:g} would show it"
    return ""
