"""`excitation`: a path within limits whose log shows parameters best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from servocore.checks.motion import Motion
from servocore.checks.motion_limits import limited_values
from servocore.effects.report import aligned
from servocore.errors import IntegrationFailed, InvalidReference, InvalidSetting, PlanningFailed, require_real
from servocore.identification.fit import LEAST_SCALE, Fit, Weights
from servocore.identification.identify import FORCE_NOISE, UNCERTAINTY, chosen_parameters, spreads_of
from servocore.identification.logs import BLOCK, Blocks
from servocore.identification.prediction import Prediction, information, prediction_of
from servocore.identification.splines import PathSpline
from servocore.model.limits import Bounds
from servocore.model.scene import Scene, require_scene, within_limits
from servocore.numerics.compiled_calls import Array
from servocore.planning.report import KeptLimits, kept_limits, sides
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.bspline import Ends, to_path
from servocore.references.piecewise import PiecewisePolynomial
from servocore.references.splines import through
from servocore.solvers.solve import recommended, solve
from servocore.solvers.stable_inversion import StableInversion
from servocore.stepping.exact_evaluation import exact_unknowns

_FASTEST, _MOST = 0.4, 12  # Hz and number of harmonics: faster ones excite what models leave out
_SPACING, _GRID = 0.5, 0.1  # s between waypoints, and between instants of the search
_WINDOW = 2.0  # s in which the harmonics grow from rest
_LONGEST = 300.0  # s: all waypoints are unknowns of one spline, and the harmonics are slow then
_STARTS, _TRIALS = 30, 1000
_MARGIN = 0.03  # of half a range that the search stays within limits, for what lies between its instants
_SAMPLE, _NOISE = 0.005, 0.01  # s between samples of the log that is predicted, its noise by the inputs
_QUANTUM, _LOGGED = 1e-5, 0.02  # of encoders, and s between the instants of a log with them
_SHRUNK, _SHRINKS = 0.97, 20


@dataclass(frozen=True)
class ExcitationReport:
    """How well the log of a path will show parameters.

    Attributes
    ----------
    standard_errors : mapping of str to float
        Predicted, relative to the values, with what was believed; by name.
    of_scene : mapping of str to float
        Those of the scene's own path with the same noise, as long as that takes.
    gain : float
        Geometric mean of their ratios.
    limits : KeptLimits
        How far the limits are kept, and whether that is proved for all times.
    """

    standard_errors: Mapping[str, float]
    of_scene: Mapping[str, float]
    gain: float
    limits: KeptLimits

    def __str__(self) -> str:
        rows = [(name, f"{each:.3%}", f"{self.of_scene[name]:.3%}") for name, each in self.standard_errors.items()]
        table = aligned([("standard error", "this path", "scene"), *rows])
        return f"{table}\n{self.gain:.3g} times less; {self.limits.evidence}"


def excitation(
    scene: Scene,
    parameters: str | Sequence[str],
    limits: Mapping[str, Bounds | None] | None = None,
    *,
    duration: float = 20.0,
    believed: Mapping[str, float] | float = UNCERTAINTY,
    seed: int = 0,
) -> tuple[Reference, ExcitationReport]:
    """Return a path from rest to rest within limits whose log shows parameters best, and a report.

    A sum of harmonics about the home of the scene, improved by random search ((1+1) evolution with Rechenberg's rule of
    success) for the determinant of the predicted covariance (D-optimal).

    Parameters
    ----------
    scene : Scene
        With the believed values of its parameters. Of one with internal dynamics the log is supposed to have all
        coordinates, from encoders with quanta of 0.01 mm or 0.01 mrad; its limits are not proved, but evaluated.
    parameters : str or sequence of str
        Names or patterns, see `identify`.
    limits : mapping of str to bounds
        More limits than the scene has, as `Scene.with_limits` takes them; the inputs need some.
    duration : float
        In s.
    believed : mapping of str to float, or float
        See `identify`.
    seed : int
        Of the random numbers.

    Returns
    -------
    Reference
        The path.
    ExcitationReport
        Predicted standard errors, and how far the limits are kept.

    Raises
    ------
    InvalidSetting
        If there are no limits, or a setting is invalid.
    InvalidModel
        If there is no such parameter.
    PlanningFailed
        If no path about home keeps the limits, or the internal dynamics are unstable.
    """
    require_scene(scene, "excitation")
    require_real(duration, "the duration of an excitation", "a number of seconds", InvalidSetting)
    if not 4 * _WINDOW <= duration <= _LONGEST:
        raise InvalidSetting(f"the excitation takes {duration:g} s: it must be 8 s or more, {_LONGEST:g} s at most")
    extended = within_limits(scene, limits)
    problem = Problem.of(extended)
    if not problem.motion_limits:
        raise InvalidSetting(f"an excitation needs limits, such as {{'{problem.system.inputs[0].name}': 100}}")
    if isinstance(recommended(problem)[0], StableInversion):
        raise PlanningFailed(f"{scene.name} has unstable internal dynamics: a search needs too many stable inversions")
    names = chosen_parameters(parameters, problem)
    search = _Search.of(extended, names, spreads_of(names, believed), float(duration))
    path, kept = search.certified(search.improved(np.random.default_rng(seed)))
    errors, own = (search.errors(each) for each in (path, scene.reference))
    gain = float(np.exp(np.mean(np.log(own / errors))))
    named = [dict(zip(names, each.tolist(), strict=True)) for each in (errors, own)]
    return path, ExcitationReport(named[0], named[1], gain, kept)


@dataclass(frozen=True, eq=False)
class _Search:
    """Harmonics about a place, and how good they are.

    Attributes
    ----------
    scene : Scene
        With its limits.
    problem : Problem
        Without internal dynamics, see `released`: its path has the coordinates that the output leaves free.
    prediction : Prediction
        Of the inputs, and where there are internal dynamics of all coordinates.
    basis : PiecewisePolynomial
        The path through one waypoint for each of its components.
    harmonics : ndarray, shape (waypoints, 2 harmonics)
        Windowed, at the waypoints.
    scales, spreads, noise : ndarray
        Units and relative uncertainties of the parameters, and noise of the inputs at the instants of the search.
    """

    scene: Scene
    problem: Problem
    prediction: Prediction
    basis: PiecewisePolynomial
    harmonics: Array
    scales: Array
    spreads: Array
    noise: Array

    @classmethod
    def of(cls, scene: Scene, names: tuple[str, ...], spreads: Array, duration: float) -> _Search:
        """Return the search for parameters of a scene."""
        given = Problem.of(scene)
        encoders = () if given.flat else tuple(each.name for each in given.system.coordinates.quantities)
        prediction, scales = prediction_of(given, names, encoders)
        problem = replace(given, resolved=prediction.resolved)
        t = np.linspace(0.0, duration, round(duration / _SPACING) + 1)
        basis = through(np.eye(len(t)), t, rest_order=given.array.reference_order)
        count = int(np.clip(round(_FASTEST * duration), 2, _MOST))
        grown = np.clip(np.minimum(t, duration - t) / _WINDOW, 0.0, 1.0)
        phases = 2 * np.pi * np.arange(1, count + 1) * t[:, None] / duration
        harmonics = np.hstack([np.sin(phases), np.cos(phases)]) * (grown**3 * (10 - 15 * grown + 6 * grown**2))[:, None]
        search = cls(scene, problem, prediction, basis, harmonics, scales, spreads, np.empty(0))
        own = search.motion(scene.reference)
        jets = own.jet(np.linspace(own.start_time, own.end_time, 400), problem.array.reference_order)
        size = prediction.values(jets, problem.p)[:, : prediction.inputs].std(axis=0)
        floor = 1e-3 * float(size.max(initial=1e-12))
        return replace(search, noise=_NOISE * np.maximum(size, floor) / np.sqrt(_GRID / _SAMPLE))

    def path(self, x: Array) -> PiecewisePolynomial:
        """Return the path of amplitudes (2 harmonics, outputs)."""
        points = self.problem.system.home[: x.shape[1]] + self.harmonics @ x
        coefficients = self.basis.coefficients @ points
        return replace(self.basis, dimension=x.shape[1], coefficients=coefficients, ends=points[[0, -1]])

    def errors(self, path: Reference) -> Array:
        """Return the predicted relative standard errors of a path."""
        return np.sqrt(np.diag(np.linalg.inv(self._information(self.motion(path)))))

    def motion(self, path: Reference) -> Reference:
        """Return a path of the output with the motion of the coordinates that it leaves free."""
        from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - kept out of the run time of an FMU

        if not self.prediction.measured:
            return path
        found = solve(replace(self.scene, reference=path, limits=()), step=_GRID / 2, checks=False)
        places = np.column_stack([found[each.name] for each in self.problem.system.outputs])
        free = Ends(start=False, end=False, order=self.problem.array.reference_order)
        return to_path(make_interp_spline(found.t, places, k=free.degree), free, None)

    def _information(self, motion: Reference) -> Array:
        step = _LOGGED if self.prediction.measured else _GRID
        t = np.arange(motion.start_time, motion.end_time + step / 2, step)
        jets, p = motion.jet(t, self.problem.array.reference_order), self.problem.p
        if self.prediction.measured:
            return self._with_encoders(t, jets)
        return np.diag(self.spreads**-2) + information(self.prediction, jets, _GRID, p, self.scales, self.noise)

    def _with_encoders(self, t: Array, jets: Array) -> Array:
        """Return the information of the log of a motion with encoders at all coordinates, as `identify` finds it.

        Parameters of the internal dynamics follow from equations between coordinates alone.
        """
        p, spreads, columns = self.problem.p, self.spreads * self.scales, list(self.prediction.columns)
        predicted, counts = self.prediction(jets, p), (self.prediction.inputs, jets.shape[2] - self.prediction.inputs)
        peak = float(np.abs(predicted.values[:, : counts[0]]).max())
        known = LEAST_SCALE * FORCE_NOISE * peak / np.sqrt(_LOGGED / BLOCK)
        encoders = np.full(len(self.prediction.measured), _QUANTUM / np.sqrt(12 * _LOGGED / _SAMPLE))
        noise = np.concatenate([self.noise * np.sqrt(_GRID / _LOGGED), np.full(counts[1], known), encoders])
        data = (Blocks(t, predicted.values, np.tile(noise, (len(t), 1))),)
        splines = (PathSpline(t, jets.shape[1] + 1, jets.shape[1], jets.shape[2], _GRID),)
        biases = np.repeat([_NOISE * peak, 1e-9 * peak], counts)
        fit = Fit(self.prediction, p, p[columns], self.scales, spreads, biases, data, splines)
        weights = [Weights(np.ones(len(noise)), fit.factors(0, predicted))]
        total = fit.step(fit.start([jets[:, 0]]), weights, 0.0)[1]
        return np.asarray(np.linalg.inv(np.linalg.inv(total)[: len(spreads), : len(spreads)]), dtype=np.float64)

    def excess(self, motion: Reference) -> float:
        """Return by how much of half its range a limit is broken at the instants of the search, at least 0."""
        problem = replace(self.problem, reference=motion)
        t = np.arange(problem.reference.start_time, problem.reference.end_time + _GRID / 4, _GRID / 2)
        values = limited_values(Motion(problem, t, exact_unknowns(problem, t)[0]))
        over = [each for limit, row in zip(problem.motion_limits, values, strict=True) for _, each in sides(limit, row)]
        return max(0.0, float(np.nan_to_num(np.array(over), nan=10.0).max()) + _MARGIN)

    def tried(self, x: Array) -> tuple[float, Array]:
        """Return how good amplitudes are, shrunk until they keep the limits, and these; minus infinity for no use."""
        for _ in range(4):
            try:
                motion = self.motion(self.path(x))
                excess = self.excess(motion)
            except IntegrationFailed:  # of internal dynamics
                excess = np.inf
            if excess == 0.0:
                total = self._information(motion)
                return float(np.linalg.slogdet(total)[1]) if np.isfinite(total).all() else -np.inf, x
            x = x * (1.0 - 1e-3) / (1.0 + min(excess, 1.0))
        return -np.inf, x

    def improved(self, random: np.random.Generator) -> Array:
        """Return the best amplitudes that were found; raises `PlanningFailed` without any."""
        shape = self.harmonics.shape[1], self.prediction.inputs
        slow = 1.0 / np.tile(np.arange(1, shape[0] // 2 + 1), 2)[:, None]
        score, best, size = -np.inf, np.zeros(shape), 0.0
        for k in range(_STARTS + _TRIALS):
            size = 0.3 if k == _STARTS else size
            spread = size * float(np.sqrt(np.mean(best**2)))
            change = random.standard_normal(shape)
            x = change * slow * (1.0 + k % 3) if k < _STARTS else best + spread * change * slow**0.5
            found, x = self.tried(x)
            size = 1.3 * size if found > score else max(0.94 * size, 0.01)
            score, best = (found, x) if found > score else (score, best)
            if k == _STARTS - 1 and not np.isfinite(score):
                raise PlanningFailed(f"{self.problem.name}: no path about home keeps the limits: does rest keep them?")
        return best

    def certified(self, x: Array) -> tuple[PiecewisePolynomial, KeptLimits]:
        """Return a path that keeps the limits at all times, and whether that is proved."""
        for _ in range(_SHRINKS):
            path = self.path(x)
            try:
                problem = replace(self.problem, reference=self.motion(path))
                kept = kept_limits(self.scene.with_reference(path), None, (problem,), {}, not self.prediction.measured)
                if kept.violation == 0.0:
                    return path, kept
            except InvalidReference:  # a limit of the path itself, as the rope's tension
                pass
            x = _SHRUNK * x
        raise PlanningFailed(f"{self.problem.name}: no path about home keeps the limits between its instants")
