"""`excitation`: a path within limits whose log shows parameters best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from servocore.checks.motion import Motion
from servocore.checks.motion_limits import limited_values
from servocore.effects.report import aligned
from servocore.errors import InvalidModel, InvalidReference, InvalidSetting, PlanningFailed, require_real
from servocore.identification.identify import UNCERTAINTY, chosen_parameters, spreads_of
from servocore.identification.prediction import Prediction, information, prediction_of
from servocore.model.limits import Bounds
from servocore.model.scene import Scene, require_scene, within_limits
from servocore.numerics.compiled_calls import Array
from servocore.planning.report import KeptLimits, kept_limits, sides
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.piecewise import PiecewisePolynomial
from servocore.references.splines import through
from servocore.stepping.exact_evaluation import exact_unknowns

_FASTEST, _MOST = 0.4, 12  # Hz and number of harmonics: faster ones excite what models leave out
_SPACING, _GRID = 0.5, 0.1  # s between waypoints, and between instants of the search
_WINDOW = 2.0  # s in which the harmonics grow from rest
_STARTS, _TRIALS = 30, 1000
_MARGIN = 0.03  # of half a range that the search stays within limits, for what lies between its instants
_SAMPLE, _NOISE = 0.005, 0.01  # s between samples of the log that is predicted, its noise by the inputs
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
    effects: Sequence[str] = (),
    believed: Mapping[str, float] | float = UNCERTAINTY,
    seed: int = 0,
) -> tuple[Reference, ExcitationReport]:
    """Return a path from rest to rest within limits whose log shows parameters best, and a report.

    A sum of harmonics about the home of the scene, improved by random search ((1+1) evolution with Rechenberg's rule of
    success) for the determinant of the predicted covariance (D-optimal).

    Parameters
    ----------
    scene : Scene
        With the believed values of its parameters. Without internal dynamics.
    parameters : str or sequence of str
        Names or patterns, see `identify`.
    limits : mapping of str to bounds
        More limits than the scene has, as `Scene.with_limits` takes them; the inputs need some.
    duration : float
        In s.
    effects : sequence of str
        Effects that the model has beside those of the scene.
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
        If the scene has internal dynamics, or no such parameter.
    PlanningFailed
        If no path about home keeps the limits.
    """
    require_scene(scene, "excitation")
    require_real(duration, "the duration of an excitation", "a number of seconds", InvalidSetting)
    if not 4 * _WINDOW <= duration < np.inf:
        raise InvalidSetting(f"the duration of an excitation is {duration:g} s: it must be 8 s or more")
    extended = within_limits(scene.with_effects(*effects) if effects else scene, limits)
    problem = Problem.of(extended)
    if not problem.flat:
        raise InvalidModel(f"{scene.name} has internal dynamics: an excitation needs a flat output")
    if not problem.motion_limits:
        raise InvalidSetting(f"an excitation needs limits, such as {{'{problem.system.inputs[0].name}': 100}}")
    names = chosen_parameters(parameters, problem)
    search = _Search.of(problem, names, spreads_of(names, believed), float(duration))
    best = search.improved(np.random.default_rng(seed))
    path, kept = search.certified(extended, best)
    errors, own = (search.errors(each) for each in (path, scene.reference))
    gain = float(np.exp(np.mean(np.log(own / errors))))
    named = [dict(zip(names, each.tolist(), strict=True)) for each in (errors, own)]
    return path, ExcitationReport(named[0], named[1], gain, kept)


@dataclass(frozen=True, eq=False)
class _Search:
    """Harmonics about a place, and how good they are.

    Attributes
    ----------
    problem : Problem
        With its limits.
    prediction : Prediction
        Of the inputs.
    basis : PiecewisePolynomial
        The path through one waypoint for each of its components.
    harmonics : ndarray, shape (waypoints, 2 harmonics)
        Windowed, at the waypoints.
    scales, spreads, noise : ndarray
        Units and relative uncertainties of the parameters, and noise of the inputs at the instants of the search.
    """

    problem: Problem
    prediction: Prediction
    basis: PiecewisePolynomial
    harmonics: Array
    scales: Array
    spreads: Array
    noise: Array

    @classmethod
    def of(cls, problem: Problem, names: tuple[str, ...], spreads: Array, duration: float) -> _Search:
        """Return the search for parameters of a problem."""
        order = problem.array.reference_order
        prediction, scales = prediction_of(problem, names)
        t = np.linspace(0.0, duration, round(duration / _SPACING) + 1)
        basis = through(np.eye(len(t)), t, rest_order=order)
        count = int(np.clip(round(_FASTEST * duration), 2, _MOST))
        grown = np.clip(np.minimum(t, duration - t) / _WINDOW, 0.0, 1.0)
        phases = 2 * np.pi * np.arange(1, count + 1) * t[:, None] / duration
        harmonics = np.hstack([np.sin(phases), np.cos(phases)]) * (grown**3 * (10 - 15 * grown + 6 * grown**2))[:, None]
        own = problem.reference
        jets = own.jet(np.linspace(own.start_time, own.end_time, 400), order)
        size = prediction(jets, problem.p).values.std(axis=0)
        floor = 1e-3 * float(size.max(initial=1e-12))
        per_instant = _NOISE * np.maximum(size, floor) / np.sqrt(_GRID / _SAMPLE)
        return cls(problem, prediction, basis, harmonics, scales, spreads, per_instant)

    def path(self, x: Array) -> PiecewisePolynomial:
        """Return the path of amplitudes (2 harmonics, outputs)."""
        points = self.problem.system.home[: x.shape[1]] + self.harmonics @ x
        coefficients = self.basis.coefficients @ points
        return replace(self.basis, dimension=x.shape[1], coefficients=coefficients, ends=points[[0, -1]])

    def errors(self, path: Reference) -> Array:
        """Return the predicted relative standard errors of a path."""
        return np.sqrt(np.diag(np.linalg.inv(self._information(path))))

    def _information(self, path: Reference) -> Array:
        t = np.arange(path.start_time, path.end_time + _GRID / 2, _GRID)
        jets, p = path.jet(t, self.problem.array.reference_order), self.problem.p
        return np.diag(self.spreads**-2) + information(self.prediction, jets, _GRID, p, self.scales, self.noise)

    def excess(self, x: Array) -> float:
        """Return by how much of half its range a limit is broken at the instants of the search, at least 0."""
        problem = replace(self.problem, reference=self.path(x))
        t = np.arange(problem.reference.start_time, problem.reference.end_time + _GRID / 4, _GRID / 2)
        values = limited_values(Motion(problem, t, exact_unknowns(problem, t)[0]))
        over = [each for limit, row in zip(problem.motion_limits, values, strict=True) for _, each in sides(limit, row)]
        return max(0.0, float(np.nan_to_num(np.array(over), nan=10.0).max()) + _MARGIN)

    def tried(self, x: Array) -> tuple[float, Array]:
        """Return how good amplitudes are, shrunk until they keep the limits, and these; minus infinity for no use."""
        for _ in range(4):
            excess = self.excess(x)
            if excess == 0.0:
                total = self._information(self.path(x))
                return float(np.linalg.slogdet(total)[1]) if np.isfinite(total).all() else -np.inf, x
            x = x * (1.0 - 1e-3) / (1.0 + min(excess, 1.0))
        return -np.inf, x

    def improved(self, random: np.random.Generator) -> Array:
        """Return the best amplitudes that were found; raises `PlanningFailed` without any."""
        shape = self.harmonics.shape[1], len(self.problem.system.outputs)
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
                raise PlanningFailed(
                    f"{self.problem.name}: no path about home keeps the limits: are they kept at rest there?"
                )
        return best

    def certified(self, scene: Scene, x: Array) -> tuple[PiecewisePolynomial, KeptLimits]:
        """Return a path that keeps the limits at all times, and whether that is proved."""
        for _ in range(_SHRINKS):
            path = self.path(x)
            try:
                kept = kept_limits(scene.with_reference(path), None, (replace(self.problem, reference=path),), {}, True)
                if kept.violation == 0.0:
                    return path, kept
            except InvalidReference:  # a limit of the path itself, as the rope's tension
                pass
            x = _SHRUNK * x
        raise PlanningFailed(f"{self.problem.name}: no path about home keeps the limits between its instants")
