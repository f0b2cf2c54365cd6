"""`certify`: proofs about the motion of a flat scene at all times, and `Certificate`, which holds them."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from servocore.certificate.causes import hidden, jumps_of, motion_statements
from servocore.certificate.equations import Box
from servocore.certificate.internal import near_states
from servocore.certificate.proof import Proof
from servocore.certificate.statements import LIMIT, ErrorBound, Statement, Verdict, compared, enclosed, stated, worst
from servocore.errors import (
    InvalidReference,
    InvalidSetting,
    LimitBroken,
    ServocoreWarning,
    described,
    require_kind,
    require_positive,
)
from servocore.model.limits import Bounds, Limit, Named, limit_named, reported_quantities
from servocore.model.scene import Scene
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once
from servocore.presentation import Curve, figure_of
from servocore.problem import Problem, ResolvedSystem, resolve
from servocore.references.base import numbers_of
from servocore.solution import Solution

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SAMPLES = 401  # of a plot
_SOMEWHERE = 0.618034  # of an interval of a parameter: a value at which nothing vanishes that does not on all of it


@dataclass(frozen=True, eq=False, repr=False)
class Certificate:
    """Statements proved for a motion, at all times of a run and for all parameters of a box.

    Attributes
    ----------
    name : str
        Of the scene.
    statements : tuple of Statement
        What is stated, each with its verdict.
    error_bounds : mapping of str to ErrorBound
        By input; empty where the motion is not proved.
    intervals : ndarray, shape (N, 2)
        Begin and end of the time intervals of the proof, in s.
    jumps : tuple of float
        Times in s at which inputs jump and the motion does not.
    """

    name: str
    statements: tuple[Statement, ...]
    error_bounds: Mapping[str, ErrorBound]
    intervals: Array
    jumps: tuple[float, ...] = ()
    _proof: Proof | None = None

    @property
    def verdict(self) -> Verdict:
        """Of all statements together: "refuted" if one is, else "undecided" if one is, else "proved"."""
        return worst(self.statements).verdict

    @property
    def summary(self) -> str:
        """The verdict in one line: the proved statements, or the first that fails."""
        largest = (max(each.at_instants, each.between) / each.peak for each in self.error_bounds.values())
        bound = f"inputs within {max(largest, default=0.0):.1e} of their peaks"
        if self._proof is not None and self._proof.boxed:
            bound = "for all parameters of the box"
        failing = [each for each in self.statements if each.verdict == self.verdict]
        if self.verdict != "proved":
            return f"{failing[0]}" + (f"; and {len(failing) - 1} more" if len(failing) > 1 else "")
        begin, end = self.statements[0].begin, self.statements[0].end
        limits = ", ".join(each.what.removeprefix(LIMIT) for each in self.statements if each.what.startswith(LIMIT))
        times = ", ".join(f"{t:.6g} s" for t in self.jumps)
        return (
            f"proved: one regular motion at all times from {begin:.6g} s to {end:.6g} s, {bound}"
            f"{limits and f'; within the limits of {limits}'}{times and f'; inputs jump at t = {times}'}"
        )

    def __repr__(self) -> str:
        lines = [f"<Certificate of {self.name}: {self.verdict}, {len(self.intervals)} intervals>"]
        return "\n".join([*lines, *(f"  {statement}" for statement in self.statements)])

    @np.errstate(all="ignore")
    def tube(self, t: npt.ArrayLike) -> dict[str, Array]:
        """Return enclosures of all quantities that a solution reports, at times within the path.

        Parameters
        ----------
        t : array_like, shape (N,) or ()
            Times in s.

        Returns
        -------
        dict of str to ndarray, shape (N, 2)
            The least and the largest value at each time, over all parameters of the box; infinite where the motion is
            not proved; empty where there is no proof at all. Angles that are known up to whole turns are those between
            -pi and pi.

        Raises
        ------
        InvalidReference
            If the times are no row of finite numbers.
        """
        times = np.atleast_1d(numbers_of(t, "the times of a tube"))
        if times.ndim > 1 or not np.isfinite(times).all():
            what = f"an array of shape {times.shape}" if times.ndim > 1 else times[~np.isfinite(times)][0]
            raise InvalidReference(f"the times of a tube must be one row of finite numbers in s, not {what}")
        if self._proof is None:
            return {}
        names = list(reported_quantities(self._proof.problem.system))
        if not len(times):
            return {name: np.zeros((0, 2)) for name in names}
        limits = [Limit(name, "", -np.inf, "", Named(name)) for name in names]
        return dict(zip(names, enclosed(self._proof, limits, times), strict=True))

    def plot(self, names: Sequence[str] | None = None) -> Figure:
        """Plot the enclosures of quantities over time: both bounds.

        Parameters
        ----------
        names : sequence of str, optional
            Which; the inputs when not given.

        Returns
        -------
        matplotlib.figure.Figure
            Made by pyplot.

        Raises
        ------
        InvalidSetting
            If matplotlib is missing, nothing is proved, or there is no quantity of a name.
        """
        if self._proof is None:
            raise InvalidSetting("nothing is proved that could be plotted")
        problem = self._proof.problem
        t = np.linspace(problem.reference.start_time, problem.reference.end_time, _SAMPLES)
        tube, known = self.tube(t), reported_quantities(problem.system)
        chosen = [each.name for each in problem.system.inputs] if names is None else names
        if isinstance(chosen, str) or not isinstance(chosen, Sequence) or not len(chosen):
            raise InvalidSetting(f"a plot needs a list of one name or more, not {described(chosen)}")
        for name in chosen:
            if name not in [*known]:
                raise InvalidSetting(f"{self.name} reports nothing called {name}; there are {', '.join(known)}")
        curves = [
            Curve(name, known[name].unit, known[name].description, np.where(np.isfinite(bound), bound, np.nan))
            for name in chosen for bound in tube[name].T
        ]  # fmt: skip
        return figure_of(t, curves, f"{self.name}: {self.verdict}")


@np.errstate(all="ignore")  # what is not finite is not proved
def certify(
    scene_or_solution: Scene | Solution,
    limits: Mapping[str, Bounds] | None = None,
    parameters: Mapping[str, tuple[float, float]] | None = None,
    tolerance: float = 1e-8,
    *,
    model: str | None = None,
) -> Certificate:
    """Prove what holds at all times of a run: one motion near the computed one, regular, within its limits.

    Parameters
    ----------
    scene_or_solution : Scene or Solution
        A scene without internal dynamics, or a solution of any, whose inputs are then compared with the proved ones.
    limits : mapping of str to bounds, optional
        Limits besides those of the scene, see `Scene.with_limits`.
    parameters : mapping of str to (float, float), optional
        Intervals of parameters: everything is then proved for all values in the box, as a whole. Where that is
        undecided, its parts may be proved.
    tolerance : float
        Of the inputs, as a share of their peaks: the width that enclosures are refined to, and how far the inputs of a
        solution may be from the proved ones.
    model : str, optional
        Model of the scene; its smallest when not given.

    Returns
    -------
    Certificate
        With a verdict, statements, error bounds and enclosures.

    Raises
    ------
    InvalidSetting
        If a limit or a parameter is unknown, an interval is none, the tolerance is not positive, a model is named
        beside a solution, or the solution has no finite instants or does not know what was solved.
    InvalidModel
        If the ends of an interval are out of the range of the parameter, or the scene has no such model.

    Examples
    --------
    >>> import servocore as sc
    >>> certificate = sc.certify(sc.scenes.overhead_crane())
    >>> certificate.verdict
    'proved'
    """
    require_kind(limits or {}, Mapping, "limits", "bounds by name", InvalidSetting)
    require_positive(tolerance, "the tolerance of a certificate", "a share of the peaks of inputs")
    solution = scene_or_solution if isinstance(scene_or_solution, Solution) else None
    if isinstance(scene_or_solution, Solution):
        problem = scene_or_solution.origin
        require_kind(problem, Problem, "what a solution to be certified solves", "known to it", InvalidSetting)
        if model is not None or not len(scene_or_solution.t) or not np.isfinite(scene_or_solution.t).all():
            why = f"has its own model, and needs no {model!r}" if model is not None else "must have finite instants"
            raise InvalidSetting(f"a solution to be certified {why}")
    else:
        problem = Problem.of(scene_or_solution, model)
    path, bounds, jumps = problem.reference, dict[str, ErrorBound](), tuple[float, ...]()
    proof: Proof | None = None
    extra = (limit_named(problem.system, str(name), each) for name, each in (limits or {}).items())
    wanted = [(f"{LIMIT}{k.quantity}", k) for k in (*problem.limits, *extra) if not k.at_instants_only]
    boxed, rates = _box(problem, parameters or {}), any(limit.rate for _, limit in wanted)
    problem = _inside(problem, boxed)
    if not problem.flat:
        proof, statements = near_states(problem, solution, tolerance, bool(boxed))
    elif path.max_order < problem.array.reference_order:
        text = f"the path has derivatives up to order {path.max_order} only: it is too rough for the inputs"
        statements = [Statement("one motion", "refuted", text)]
    else:
        raised = rates and path.max_order > problem.array.reference_order
        proof, statements = Proof(problem, boxed, tolerance, raised), []
    if proof is None:
        statements += [Statement(what, "undecided", "the motion is not proved") for what, _ in wanted]
    else:
        jumps = jumps_of(proof)
        statements += motion_statements(proof, solution)
        if solution is not None or proof.joined.all():
            bounds, of_instants, spikes = compared(proof, solution, tolerance)
            statements, wanted = statements + of_instants, spikes + wanted
        statements += stated(proof, wanted, jumps)
        unproved = worst(statements).verdict == "undecided" and not proof.joined.all()
        if solution is not None and problem.flat and unproved:
            statements = hidden(proof, solution, spikes) + statements
    timed = tuple(replace(each, begin=path.start_time, end=path.end_time) for each in statements)
    intervals = np.stack([proof.begin, proof.end], axis=1)[proof.within] if proof else np.zeros((0, 2))
    return Certificate(problem.name, timed, bounds, intervals, jumps, proof)


def require_certified(
    subject: Scene | Solution, tolerance: float = 1e-8, *, model: str | None = None, warn: bool = True
) -> Certificate:
    """Return the certificate of a scene or a solution unless it is refuted; warn where it is undecided.

    Raises
    ------
    LimitBroken
        If a limit is refuted.
    InvalidReference
        If another statement is.

    Warns
    -----
    ServocoreWarning
        If the certificate is undecided and `warn` is set.
    """
    certificate = certify(subject, tolerance=tolerance, model=model)
    text = f"{certificate.name}: the certificate is {certificate.summary}"
    if certificate.verdict == "refuted":
        broken = next(each for each in certificate.statements if each.verdict == "refuted")
        raise (LimitBroken if broken.what.startswith(LIMIT) else InvalidReference)(text)
    if warn and certificate.verdict == "undecided":
        warnings.warn(text, ServocoreWarning, stacklevel=3)
    return certificate


def _box(problem: Problem, parameters: Mapping[str, tuple[float, float]]) -> Box:
    """Return the intervals of parameters by number."""
    require_kind(parameters, Mapping, "parameters", "intervals by name", InvalidSetting)
    known, boxed = problem.system.parameters, {}
    for name, interval in parameters.items():
        if name not in known.names:
            raise InvalidSetting(f"{problem.name} has no parameter {name}; there are {', '.join(known.names)}")
        whole = isinstance(interval, tuple | list | np.ndarray) and len(interval) == 2
        number = known.names.index(name)
        low, high = map(known.declared[number].check, interval) if whole else (0.0, 0.0)
        if not low < high:
            raise InvalidSetting(f"the interval of {name} must run from a lower to a higher value, not {interval}")
        boxed[number] = (low, high)
    return boxed


def _inside(problem: Problem, boxed: Box) -> Problem:
    """Return a problem with the structure that it has within a box: terms that vanish at its own values are kept."""
    p = problem.p.copy()
    for k, (low, high) in boxed.items():
        p[k] = low + _SOMEWHERE * (high - low)
    return replace(problem, resolved=_structured_at(problem.resolved, tuple(p.tolist()))) if boxed else problem


@made_once
def _structured_at(resolved: ResolvedSystem, p: tuple[float, ...]) -> ResolvedSystem:
    """Return a system as it is where its structure holds at parameter values too, else resolved there."""
    return resolved if resolved.suits(np.array(p)) else resolve(resolved.system, p)
