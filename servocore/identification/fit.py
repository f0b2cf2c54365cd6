"""Maximum likelihood on the flat output: path of the output, parameters, biases and delays from all channels of logs.

    min over c, theta, b, tau:  sum ((y - y(jet)) / s_y)^2 + sum ((u - b + tau u' - u(jet, theta)) / s_u)^2 + prior

The path is a spline with coefficients c, and every channel an algebraic function of its jet: the exact inversion. Its
noise enters through both, so that noisy positions bias nothing, and logs may begin in motion. Gauss-Newton steps
eliminate the coefficients stretch by stretch: their normal equations are banded, and the Schur complement is the
information on all the rest (Nocedal and Wright, Numerical Optimization, chapter 10).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy  # loads scipy.linalg when a fit calls it: all commands import this module

from servocore.identification.logs import MOVES, Blocks
from servocore.identification.prediction import DELAY, Predicted, Prediction
from servocore.identification.splines import PathSpline
from servocore.numerics.compiled_calls import Array, Mask

_STEPS, _ROUNDS = 25, 3
HUBER = 3.0
"""Standard deviations from which on a residual counts less."""

LEAST_SCALE = 0.1
"""Of the noise of a channel is left at least."""

_CREEP = 4.0  # times the usual slope of an input by velocities: in creep dry friction is not known well enough
_BESIDE = 7  # blocks
_LEFT, _BLURRED = 0.03, 0.3  # weights of inputs and positions there
_COUNTED = 0.1  # weight from which on a value counts in full
_LAGS = 30  # blocks: residuals that stay for less raise standard errors
_SETTLED, _ROUGHLY = 0.02, 2.0  # standard errors
_GAINED = 1e-5
_NEAR = 0.3  # standard errors: a last step that is longer leaves doubts
_FARTHEST = 0.5  # change of a parameter in one step, by its believed value
_LOOSE = 0.1, 0.01  # of the standard deviation of an input, of a position: the noise at the start
_BLURS = 100.0, 10.0  # times their noise that positions have at first
_RIDGE = 1e-13


class State(NamedTuple):
    """Estimates: parameters by their scales and behind them biases and delays (logs, 2, inputs), and paths."""

    x: Array
    paths: tuple[Array, ...]


class Weights(NamedTuple):
    """Weights of one stretch: standard deviations by channel (channels,), and factors of single values."""

    scales: Array
    factors: Array


@dataclass(frozen=True, eq=False)
class Fit:
    """A maximum likelihood problem.

    Attributes
    ----------
    prediction : Prediction
        Of all channels.
    p : ndarray
        All parameters of the model; those to be estimated are replaced.
    scales, spread : ndarray, shape (parameters,)
        Units of the estimates, and their standard deviations before anything is measured.
    center : ndarray, shape (parameters,)
        Their believed values.
    biases : ndarray, shape (inputs,)
        Standard deviations of the biases of the inputs before anything is measured.
    stretches : tuple of Blocks
        Data.
    splines : tuple of PathSpline
        Paths of the stretches.
    """

    prediction: Prediction
    p: Array
    center: Array
    scales: Array
    spread: Array
    biases: Array
    stretches: tuple[Blocks, ...]
    splines: tuple[PathSpline, ...]

    @property
    def inputs(self) -> int:
        """Number of inputs, with forces that are known to be zero."""
        return len(self.prediction.resolved.system.inputs)

    @property
    def logs(self) -> int:
        """Number of logs."""
        return 1 + max(each.log for each in self.stretches)

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Center and precision of parameters, biases and delays before anything is measured."""
        offsets = np.concatenate([self.biases**-2, np.full(self.inputs, DELAY**-2)])
        center = np.concatenate([self.center / self.scales, np.zeros(self.logs * len(offsets))])
        return center, np.concatenate([(self.scales / self.spread) ** 2, np.tile(offsets, self.logs)])

    def offsets(self, state: State) -> Array:
        """Return biases and delays of the inputs, shape (logs, 2, inputs)."""
        return state.x[len(self.scales) :].reshape(self.logs, 2, self.inputs)

    def parameters(self, state: State) -> Array:
        """Return all parameters of the model with estimates in their places."""
        p = self.p.copy()
        p[list(self.prediction.columns)] = state.x[: len(self.scales)] * self.scales
        return p

    def start(self, places: list[Array], x: Array | None = None) -> State:
        """Return the state at the believed parameters with paths near some positions of the output (N, outputs)."""
        paths = []
        for spline, place in zip(self.splines, places, strict=True):
            m = spline.components
            by_path = np.zeros((len(place), m, spline.orders, m))
            by_path[:, range(m), 0, range(m)] = 1.0
            band, right = spline.normal(by_path, place, np.zeros((*place.shape, 0)))
            band[0] += 1e-6 * band[0].mean()
            paths.append(scipy.linalg.solveh_banded(band, right[:, 0], lower=True).reshape(-1, m))
        return State(self.prior[0] if x is None else x, tuple(paths))

    def refined(self, state: State, spacing: float) -> tuple[Fit, State]:
        """Return the problem with another distance of knots, and its state with the same paths."""
        finer = replace(self, splines=tuple(replace(each, spacing=spacing) for each in self.splines))
        places = [old.jets(path)[:, 0] for old, path in zip(self.splines, state.paths, strict=True)]
        return finer, finer.start(places, state.x)

    def predicted(self, state: State, k: int) -> Predicted:
        """Return the channels of a stretch."""
        return self.prediction(self.splines[k].jets(state.paths[k]), self.parameters(state))

    def residuals(self, state: State, k: int, values: Array | None = None) -> tuple[Array, Array]:
        """Return measured less predicted channels of a stretch (N, channels), and the rates of its inputs (N, m)."""
        if values is None:
            values = self.prediction.values(self.splines[k].jets(state.paths[k]), self.parameters(state))
        data, m = self.stretches[k], self.inputs
        bias, delay = self.offsets(state)[data.log]
        rate = np.gradient(values[:, :m], data.t, axis=0)
        rate -= delay * np.gradient(rate, data.t, axis=0)
        expected = values.copy()
        expected[:, :m] += bias - delay * rate - delay**2 / 2 * np.gradient(rate, data.t, axis=0)
        return self.prediction.wrapped(data.values - expected), rate

    def cost(self, state: State, weights: list[Weights]) -> float:
        """Return the weighted sum of squares; infinite where the model has no solution."""
        center, precision = self.prior
        weighted = (each.factors * self.residuals(state, k)[0] / each.scales for k, each in enumerate(weights))
        total = float(precision @ (state.x - center) ** 2) + sum(float(np.sum(each**2)) for each in weighted)
        return total if np.isfinite(total) else np.inf

    def step(self, state: State, weights: list[Weights], damping: float) -> tuple[State, Array]:
        """Return the change of a Gauss-Newton step, and the information on all but the paths."""
        center, precision = self.prior
        information, right = np.diag(precision), precision * (center - state.x)
        solved = []
        count, m = len(self.scales), self.inputs
        for k, weight in enumerate(weights):
            predicted, data = self.predicted(state, k), self.stretches[k]
            residual, rate = self.residuals(state, k, predicted.values)
            w = weight.factors / weight.scales
            nuisance = np.zeros((*residual.shape, count + 2 * m))
            nuisance[:, :, :count] = predicted.by_parameter * self.scales
            nuisance[:, range(m), range(count, count + m)] = 1.0
            nuisance[:, range(m), range(count + m, count + 2 * m)] = -rate
            nuisance *= w[:, :, None]
            band, sides = self.splines[k].normal(predicted.by_path * w[:, :, None, None], residual * w, nuisance)
            band[0] *= 1.0 + _RIDGE + damping
            band[0] += _RIDGE * band[0].mean()
            answer = scipy.linalg.solveh_banded(band, sides, lower=True)
            flat = nuisance.reshape(-1, count + 2 * m)
            places = np.concatenate([np.arange(count), count + 2 * m * data.log + np.arange(2 * m)])
            information[np.ix_(places, places)] += flat.T @ flat - sides[:, 1:].T @ answer[:, 1:]
            right[places] += flat.T @ (residual * w).ravel() - sides[:, 1:].T @ answer[:, 0]
            solved.append((answer, places))
        damped = information + damping * np.diag(np.diag(information))
        change = np.asarray(np.linalg.solve(damped, right), dtype=np.float64)
        moved = [
            (answer[:, 0] - answer[:, 1:] @ change[places]).reshape(-1, self.splines[0].components)
            for answer, places in solved
        ]
        return State(change, tuple(moved)), information

    def creeping(self, k: int, predicted: Predicted) -> Mask:
        """Return where drives rest or creep, so that dry friction is not known well enough, shape (N, inputs)."""
        m, values = self.prediction.inputs, self.stretches[k].values[:, self.inputs :]
        slope = np.linalg.norm(predicted.by_path[:, :m, 1], axis=2)
        still = np.ptp(values[:, :m], axis=0) < MOVES
        return np.asarray(still | (slope > _CREEP * np.quantile(slope, 0.25, axis=0)), dtype=bool)

    def factors(self, k: int, predicted: Predicted, blurred: float = 1.0) -> Array:
        """Return the inverse noise of a stretch (N, channels), less beside creep: of inputs, and of positions."""
        from scipy.ndimage import binary_dilation  # noqa: PLC0415 - kept out of the run time of an FMU

        factors, m = 1.0 / self.stretches[k].noise, self.prediction.inputs
        # Beside creep too: the path bends there faster than its spline.
        creeping = binary_dilation(self.creeping(k, predicted), np.ones((2 * _BESIDE + 1, 1), dtype=bool))
        factors[:, :m] *= np.where(creeping, _LEFT, 1.0)
        factors[:, self.inputs : self.inputs + m] *= np.where(creeping, blurred, 1.0)
        return factors

    def weights(self, state: State) -> list[Weights]:
        """Return weights by the residuals of a state."""
        raw, found = list[tuple[Array, Array]](), list[Weights]()
        for k in range(len(self.stretches)):
            predicted = self.predicted(state, k)
            # Where a drive creeps its acceleration jumps: the spline must not bend beside it to follow there.
            factors = self.factors(k, predicted, _BLURRED)
            raw.append((factors, factors * self.residuals(state, k, predicted.values)[0]))
        for log in range(self.logs):
            own = [k for k, data in enumerate(self.stretches) if data.log == log]
            counted = [used(self.stretches[k], raw[k][0]) for k in own]
            parts = [list(zip(raw[k][1].T, each.T, strict=True)) for k, each in zip(own, counted, strict=True)]
            scales = np.array([_scale([x[use] for x, use in channel]) for channel in zip(*parts, strict=True)])
            # The path takes degrees of freedom from the residuals: s^2 = RSS / (N - unknowns).
            rows = sum(int(each.sum()) for each in counted)
            unknowns = sum(self.splines[k].count * self.splines[k].components for k in own)
            scales *= np.sqrt(rows / max(rows - unknowns, rows / 10))
            scales[self.inputs :] = np.maximum(scales[self.inputs :], 1.0)
            for k in own:
                far = np.abs(raw[k][1]) / scales
                found.append(Weights(scales, raw[k][0] * np.sqrt(np.minimum(1.0, HUBER / np.maximum(far, 1e-12)))))
        return found


def used(data: Blocks, factors: Array) -> Mask:
    """Return which values count in full: neither missing, nor creeping, nor far off."""
    return np.asarray(factors > _COUNTED / data.noise, dtype=bool)


def _scale(parts: list[Array]) -> float:
    """Return the standard deviation of residuals, raised where they stay on one side."""
    every = np.concatenate(parts)
    if not len(every):
        return 1.0
    size = float(np.sqrt(np.mean(np.minimum(every**2, (3.0 * 1.4826 * np.median(np.abs(every))) ** 2))))
    return float(max(size * persistence(parts) ** 0.5, LEAST_SCALE))


def correlation(parts: list[Array], lag: int) -> float:
    """Return the correlation of residuals some blocks apart."""
    products = sum(float(part[lag:] @ part[:-lag]) for part in parts if len(part) > lag)
    return products / (sum(float(part @ part) for part in parts) or 1.0)


def persistence(parts: list[Array]) -> float:
    """Return the spectral density of residuals near zero by that of white noise, at least 1 (Bartlett's estimate)."""
    return max(1.0, 1.0 + 2.0 * sum((1 - lag / _LAGS) * correlation(parts, lag) for lag in range(1, _LAGS)))


def _moved(state: State, change: State, share: float) -> State:
    paths = zip(state.paths, change.paths, strict=True)
    return State(state.x + share * change.x, tuple(a + share * b for a, b in paths))


class Converged(NamedTuple):
    """An estimate: state, weights, information, and whether the steps have settled."""

    state: State
    weights: list[Weights]
    information: Array
    settled: bool


def minimized(problem: Fit, state: State, *, fresh: bool = True) -> Converged:
    """Return the maximum likelihood estimate from a start; from a `fresh` one by stages, with loose data at first."""
    if fresh:
        loose = []
        for data in problem.stretches:
            share = np.where(np.arange(data.values.shape[1]) < problem.inputs, *_LOOSE)
            scales = np.maximum(1.0, share * data.values.std(axis=0) / np.median(data.noise, axis=0))
            loose.append(Weights(scales, 1.0 / data.noise))
        for stage in (replace(problem, spread=1e-6 * problem.spread), problem):
            state = _descent(stage, state, loose, _ROUGHLY)
    # The inputs alone show the free swing of the load. Where a drive reverses quickly its acceleration jumps, and a
    # path that has to meet positions there swings wrongly; that would pass for noise of the inputs, another optimum.
    for more in _BLURS:
        scales = np.where(np.arange(problem.stretches[0].values.shape[1]) < problem.inputs, 1.0, more)
        shown = (problem.predicted(state, k) for k in range(len(problem.stretches)))
        weights = [Weights(scales, problem.factors(k, each)) for k, each in enumerate(shown)]
        state = _descent(problem, state, weights, _ROUGHLY)
    for _ in range(_ROUNDS):
        weights = problem.weights(state)
        state = _descent(problem, state, weights, _SETTLED)
    change, information = problem.step(state, weights, 0.0)
    sizes = np.sqrt(np.diag(np.linalg.inv(information)))
    return Converged(state, weights, information, bool((np.abs(change.x) < _NEAR * sizes).all()))


def _descent(problem: Fit, state: State, weights: list[Weights], tolerance: float) -> State:
    """Return the state after Gauss-Newton steps under given weights."""
    damping, cost = 0.0, problem.cost(state, weights)
    for _ in range(_STEPS):
        change, information = problem.step(state, weights, damping)
        small = float(np.max(np.abs(change.x) * np.sqrt(np.diag(information)))) < tolerance
        share = full = min(1.0, _FARTHEST / max(float(np.abs(change.x[: len(problem.scales)]).max()), 1e-12))
        candidate = _moved(state, change, share)
        while (better := problem.cost(candidate, weights)) > cost * (1 + 1e-9) and share > 0.02 * full:
            share /= 2
            candidate = _moved(state, change, share)
        # Where friction bends within the residuals Gauss-Newton steps are far too short, all in one direction.
        while share >= full and (longer := problem.cost(_moved(state, change, 2 * share), weights)) < better:
            share *= 2
            candidate, better = _moved(state, change, share), longer
        if better <= cost * (1 + 1e-9):
            gained, state, cost = cost - better, candidate, better
            damping = damping / 10 if share == full and damping > 1e-6 else 0.0 if share == full else damping
            if (small and share == 1.0) or gained < _GAINED * tolerance * cost:
                return state
        elif small or damping > 1e2:
            return state
        else:
            damping = max(10 * damping, 1e-5)
    return state
