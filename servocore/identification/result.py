"""`Identified`: estimates with standard errors, what is not known, and whether the model explains its logs."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from servocore.effects.closed_loop import run_loop
from servocore.effects.position_loops import PositionLoops
from servocore.effects.report import aligned
from servocore.errors import InvalidSetting, require_kind
from servocore.files import csv_text
from servocore.identification.fit import HUBER, Converged, Fit, correlation, persistence, used
from servocore.identification.followed import followed
from servocore.identification.prediction import showing
from servocore.model.scene import Scene
from servocore.numerics.compiled_calls import Array, Mask
from servocore.references.base import Reference

_EXACT = 1e-5  # of the range of an input, less than sensors resolve: residuals of a log without noise
_UNKNOWN = 0.5  # of its uncertainty before is left of a combination that a log does not show
_NAMED = 0.3  # entry of a combination from which on a parameter is named
_PERSISTENT, _CORRELATED = 3.0, 0.35  # spectral density near zero by that of white noise; correlation at lag one
_OCTAVES, _BY_SPEED = 5, 25.0  # of speed below the highest; chi-squared that noise exceeds once in ten thousand
_FAR = 4.0  # standard deviations of an estimate from what was believed, and from no delay
_SLOW = 10  # blocks of a moving average
_SAMPLES, _QUANTILE = 2000, 0.95
_INSTANT, _FEWEST = 0.02, 500  # s between instants of a motion, and their least number
_SHARE = 0.3  # of a standard error: the change of a parameter by which the motion is differentiated
_SMALL = 1e-3  # or of the parameter, where that is less


class Stray(NamedTuple):
    """How far the output will go off a path in 95 of 100 cases, in mm (thousandths of its unit).

    Attributes
    ----------
    total : float
        With what the residuals of the inputs do beside.
    by_parameters : float
        By the uncertainty of the parameters alone.
    """

    total: float
    by_parameters: float


@dataclass(frozen=True, eq=False)
class Identified:
    """Parameters identified from logs; `identify` makes it.

    Attributes
    ----------
    names : tuple of str
        Identified parameters.
    logs : tuple of str
        Names of the logs.
    loops : PositionLoops
        Of the drives, for `stray`.
    jobs : tuple of Reference
        Paths of which `verdict` states how far the output will go off.
    based_on : Scene
        With the believed values.
    fit : Fit
        The maximum likelihood problem.
    estimate : Converged
        Its solution.
    """

    names: tuple[str, ...]
    logs: tuple[str, ...]
    loops: PositionLoops
    jobs: tuple[Reference, ...]
    based_on: Scene = field(repr=False)
    fit: Fit = field(repr=False)
    estimate: Converged = field(repr=False)

    @property
    def values(self) -> dict[str, float]:
        """Estimates by name."""
        return self._named(self.estimate.state.x[: len(self.names)] * self.fit.scales)

    def _named(self, values: Array) -> dict[str, float]:
        return dict(zip(self.names, values.tolist(), strict=True))

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard errors by name, those of the residuals' own noise and its persistence."""
        return self._named(np.sqrt(np.diag(self.covariance)))

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the values, shape (parameters, parameters)."""
        return self._relative * np.outer(self.fit.scales, self.fit.scales)

    @property
    def _relative(self) -> Array:
        count = len(self.names)
        return np.asarray(np.linalg.inv(self.estimate.information)[:count, :count], dtype=np.float64)

    @property
    def prior_share(self) -> dict[str, float]:
        """Share of each estimate that is from what was believed: 0 where the logs alone say it, 1 where they do not."""
        return self._named(np.diag(self._relative) * (self.fit.scales / self.fit.spread) ** 2)

    @property
    def delays(self) -> dict[str, tuple[float, ...]]:
        """Delay of each input behind the positions in s, one of each log."""
        return self._offsets(1)

    @property
    def biases(self) -> dict[str, tuple[float, ...]]:
        """Bias of each measured input, one of each log."""
        return self._offsets(0)

    def _offsets(self, row: int) -> dict[str, tuple[float, ...]]:
        values = self.fit.offsets(self.estimate.state)[:, row]
        return {name: tuple(values[:, k].tolist()) for k, name in enumerate(self._inputs)}

    @property
    def _inputs(self) -> tuple[str, ...]:
        return tuple(quantity.name for quantity in self.based_on.model().inputs)

    @cached_property
    def _parts(self) -> list[tuple[Array, Mask, Array]]:
        """Of each stretch: residuals, which of them count, and rates of the positions, 0 where drives creep."""
        parts, fit, m = [], self.fit, self.fit.inputs
        for k, (data, weight) in enumerate(zip(fit.stretches, self.estimate.weights, strict=True)):
            predicted = fit.predicted(self.estimate.state, k)
            rates = np.gradient(predicted.values[:, m : m + len(self._inputs)], data.t, axis=0)
            residual, counted = fit.residuals(self.estimate.state, k, predicted.values)[0], used(data, weight.factors)
            parts.append((residual, counted, np.where(fit.creeping(k, predicted), 0.0, rates)))
        return parts

    @cached_property
    def residuals(self) -> dict[str, Array]:
        """Measured less predicted channels by name, shape (blocks,), with ``time``; NaN where friction creeps."""
        return self._by_name([np.where(counted, residual, np.nan) for residual, counted, _ in self._parts])

    @cached_property
    def measured(self) -> dict[str, Array]:
        """Averages of the measured channels over blocks by name, shape (blocks,), with ``time``."""
        return self._by_name([data.values for data in self.fit.stretches])

    def _by_name(self, rows: list[Array]) -> dict[str, Array]:
        columns: dict[str, Array] = {"time": np.concatenate([data.t for data in self.fit.stretches])}
        names = (quantity.name for quantity in self.fit.prediction.quantities)
        return columns | dict(zip(names, np.concatenate(rows).T, strict=True))

    @cached_property
    def whiteness(self) -> dict[str, tuple[float, float, float]]:
        """Of the residuals of each input: spectral density near zero, correlation at lag one, dependence on the speed.

        The density is by that of white noise. The dependence is chi-squared of five octaves of the speed of the drive:
        the sum of the squares of the means of residuals by direction, each by its standard deviation. It sees friction
        of another kind, which is so short or so weak that it hides in correlations.
        """
        found = {}
        fastest = np.max([np.abs(rates).max(axis=0) for *_, rates in self._parts], axis=0)
        for k, name in enumerate(self._inputs):
            parts, sums = [], np.zeros((2, _OCTAVES))
            rows = zip(self._parts, self.fit.stretches, self.estimate.weights, strict=True)
            for (residual, counted, rates), data, weight in rows:
                parts.append((residual * weight.factors)[counted[:, k], k])
                known = np.isfinite(data.noise[:, k]) & (np.abs(rates[:, k]) > 0.0)
                rate, sizes = rates[known, k], weight.scales[k] * data.noise[known, k]
                octave = np.clip(np.log2(fastest[k] / np.abs(rate)).astype(int), 0, _OCTAVES - 1)
                signed = np.sign(rate) * np.clip(residual[known, k] / sizes, -HUBER, HUBER)
                sums += [np.bincount(octave, each, _OCTAVES) for each in (signed, np.ones(len(octave)))]
            by_speed = float(np.sum(sums[0] ** 2 / np.maximum(sums[1], 1.0)))
            found[name] = persistence(parts), correlation(parts, 1), by_speed
        return found

    @cached_property
    def unidentifiable(self) -> tuple[str, ...]:
        """Combinations that the logs do not show, with their uncertainty and the motion that would show them."""
        fit, relative = self.fit, self.fit.spread / self.fit.scales
        sizes, directions = np.linalg.eigh(self._relative / np.outer(relative, relative))
        m = fit.inputs
        noise = np.median(fit.stretches[0].noise[:, :m], axis=0) * self.estimate.weights[0].scales[:m]
        path = fit.splines[0].jets(self.estimate.state.paths[0])[:, 0]
        sentences = []
        for size, direction in zip(sizes[::-1], directions.T[::-1], strict=True):
            if size < _UNKNOWN**2:
                break
            own = direction * relative
            unit, p = own / np.linalg.norm(own), fit.parameters(self.estimate.state)
            spread = float(np.sqrt(size) * np.linalg.norm(own))
            remedy = showing(fit.prediction, path.mean(axis=0), p, fit.scales, noise, unit, spread)
            sentences.append(
                f"{_combined(self.names, direction)} (±{100 * spread:.2g} %)" + (f": {remedy}" if remedy else "")
            )
        return tuple(sentences)

    @cached_property
    def effects(self) -> dict[str, float]:
        """Wald statistics of effects of the model by parameter: estimate by standard error, without what was believed.

        Parameters of effects that vanish where the effect does; beyond 2.8 the logs ask for the effect.
        """
        found, declared = dict[str, float](), self.based_on.effects.parameters
        for (name, value), center in zip(self.values.items(), self.fit.center, strict=True):
            if name in declared and declared[name].lower == 0.0:
                known = max(1.0 - self.prior_share[name], 1e-12)  # its own prior alone is taken away again
                alone = value + self.prior_share[name] / known * (value - center)
                found[name] = float(alone / self.standard_errors[name] * np.sqrt(known))
        return found

    def scene(self) -> Scene:
        """Return the scene with the estimates, within the bounds of its parameters.

        Returns
        -------
        Scene
            With the path that it had.
        """
        known = {each.name: each for each in self.based_on.model().parameters.declared}
        values = {name: min(max(value, known[name].lower), known[name].upper) for name, value in self.values.items()}
        return self.based_on.with_parameters(**values)

    def stray(self, path: Reference) -> Stray:
        """Return how far the output will go off a path in 95 of 100 cases, in mm, under the position loops.

        By parameters it is the quantile of the largest norm of S zeta, S = d output / d theta, for zeta of the normal
        distribution with the covariance of the estimates.

        Parameters
        ----------
        path : Reference
            From rest to rest.

        Returns
        -------
        Stray
            ``total``, and ``by_parameters``, what their uncertainty contributes.

        Notes
        -----
        The drives measure what the effects of the scene say, or else the positions that come first in the logs. Of a
        model with internal dynamics the inputs are those of `servocore.solve`; where they begin before the path, so
        does the motion of the plant.
        """
        require_kind(path, Reference, "the path of stray", "a Reference", InvalidSetting)
        scene = self.scene().with_reference(path)
        measured = scene.effects.measured or self.fit.prediction.measured[: len(self._inputs)]
        count = max(_FEWEST, int(np.ceil(path.duration / _INSTANT))) + 1
        motion = followed(scene, measured, count)
        gains, slopes = motion.gains(self.loops), []
        base = run_loop(motion, motion, gains).deviation
        # S = d output / d theta by simulations of changed plants.
        for name, error in self.standard_errors.items():
            value = scene.parameter_values()[name]
            change = min(_SHARE * error, _SMALL * abs(value) or np.inf)
            plant = followed(scene.with_parameters(**{name: value + change}), measured, count)
            deviation = run_loop(plant, motion, gains).deviation
            at, own = np.linspace(0.0, 1.0, len(base)), np.linspace(0.0, 1.0, len(deviation))
            slopes.append((np.column_stack([np.interp(at, own, each) for each in deviation.T]) - base) / change)
        normal = np.random.default_rng(0).multivariate_normal
        drawn = normal(np.zeros(len(self.names)), self.covariance, _SAMPLES, "ignore", method="eigh")  # round-off
        samples = np.linalg.norm(np.tensordot(drawn, np.array(slopes), axes=1), axis=2)
        by_parameters = float(np.quantile(samples.max(axis=1), _QUANTILE))
        # Residuals that stay act on the plant as a disturbance.
        t = self.residuals["time"] - self.residuals["time"][0]
        at = (motion.t - motion.t[0]) % t[-1]
        known, window = (np.nan_to_num(self.residuals[name]) for name in self._inputs), np.ones(_SLOW) / _SLOW
        slow = [np.interp(at, t, np.convolve(each, window, mode="same")) for each in known]
        rest = run_loop(motion, motion, gains, np.column_stack(slow)).error
        return Stray(1e3 * (by_parameters + rest), 1e3 * by_parameters)  # both in one direction at worst

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """Reasons not to trust the result, as sentences; empty for a good one."""
        found = [] if self.estimate.settled else ["the fit has not settled: log a livelier or longer motion"]
        for k, (name, (persistent, correlated, by_speed)) in enumerate(self.whiteness.items()):
            why = ""
            if persistent > _PERSISTENT or correlated > _CORRELATED:
                why = (
                    f"are no noise (correlation {correlated:.2f} from block to block), so that an effect is missing or"
                    " a sensor is wrong"
                )
            elif by_speed > _BY_SPEED:
                why = (
                    f"depend on the speed of {self.fit.prediction.measured[k]} (chi-squared {by_speed:.0f} of"
                    f" {_OCTAVES} octaves), so that friction is of another kind"
                )
            if why:
                size = float(np.sqrt(np.nanmean(self.residuals[name] ** 2)))
                what = f"the model does not explain {name}"
                if size < _EXACT * float(np.ptp(self.measured[name])):
                    what = f"{name} is logged without noise"
                    why = "are errors of splines, standard errors too small: give simulated logs the noise of sensors"
                found.append(f"{what}: its residuals of {size:.3g} {why}")
        spreads = np.hypot(self.fit.spread, list(self.standard_errors.values()))
        for (name, value), center, spread in zip(self.values.items(), self.fit.center, spreads, strict=True):
            if abs(value - center) > _FAR * spread:
                found.append(f"{name} = {value:.4g} is far from the believed {center:.4g}")
        return tuple(found)

    @cached_property
    def verdict(self) -> str:
        """Quality of the result, in sentences."""
        lines = list(self.doubts) or ["the model explains the logs: the residuals of the inputs are noise"]
        lines += [f"not shown by the logs: {each}" for each in self.unidentifiable]
        for k, job in enumerate(self.jobs):
            stray = self.stray(job)
            lines.append(
                f"on job {k + 1} the output stays within {stray.total:.2g} mm of its path in 95 of 100 cases;"
                f" {stray.by_parameters:.2g} mm are due to parameters"
            )
        return "; ".join(lines)

    def parameter_file(self) -> str:
        """Return the estimates as a TOML file that commands read with ``--parameters``; standard errors as comments.

        Returns
        -------
        str
            One line a parameter.
        """
        units = {each.name: each.unit for each in self.based_on.model().parameters.declared}
        head = f"# Identified from {', '.join(self.logs)}; standard errors (%) and share of what was believed\n"
        values, lines = self.scene().parameter_values(), ""
        for name, error in self.standard_errors.items():
            share = f"{100 * error / abs(values[name] or 1.0):.2g} %, {self.prior_share[name]:.2g}"
            lines += f"{name} = {values[name]!r}  # {units[name]}, {share}\n"
        return head + lines

    def covariance_file(self) -> str:
        """Return the covariance of the estimates as a CSV file.

        Returns
        -------
        str
            A header of names, then a row for each.
        """
        return csv_text(list(self.names), [self.covariance])

    @property
    def table(self) -> list[tuple[str, str, str, str]]:
        """Rows of texts with a header: values before and after with standard errors, and the share of the former."""
        rows = [("parameter", "believed", "identified", "from what was believed")]
        for k, (name, value) in enumerate(self.values.items()):
            before = f"{self.fit.center[k]:.4g} ± {self.fit.spread[k]:.2g}"
            after = f"{value:.4g} ± {self.standard_errors[name]:.2g}"
            rows.append((name, before, after, f"{self.prior_share[name]:.0%}"))
        return rows

    def __str__(self) -> str:
        return f"{aligned(self.table)}\nverdict: {self.verdict}"


def _combined(names: tuple[str, ...], direction: Array) -> str:
    """Return a combination of parameters in words."""
    direction = direction * np.sign(direction[np.abs(direction).argmax()])
    up, down = (
        [name for name, share in zip(names, direction, strict=True) if sign * share > _NAMED] for sign in (1, -1)
    )
    return " and ".join(up) + (f" against {' and '.join(down)}" if down else " together" if len(up) > 1 else "")
