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
from servocore.errors import InvalidReference, InvalidSetting, LimitBroken, ServocoreWarning, require_kind
from servocore.model.limits import Bounds, Limit, Named, limit_named, reported_quantities
from servocore.model.scene import Scene
from servocore.numerics.compiled_calls import Array
from servocore.presentation import Curve, figure_of
from servocore.problem import Problem
from servocore.references.base import numbers_of
from servocore.solution import Solution

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SAMPLES = 401  # of a plot


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
        bound = max(largest, default=0.0)
        failing = [each for each in self.statements if each.verdict == self.verdict]
        if self.verdict != "proved":
            return f"{failing[0]}" + (f"; and {len(failing) - 1} more" if len(failing) > 1 else "")
        begin, end = self.statements[0].begin, self.statements[0].end
        limits = ", ".join(each.what.removeprefix(LIMIT) for each in self.statements if each.what.startswith(LIMIT))
        times = ", ".join(f"{t:.6g} s" for t in self.jumps)
        return (
            f"proved: one regular motion at all times from {begin:.6g} s to {end:.6g} s, inputs within {bound:.1e} of"
            f" their peaks{limits and f'; within the limits of {limits}'}{times and f'; inputs jump at t = {times}'}"
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
            not proved. Angles that are known up to whole turns are those between -pi and pi.
        """
        times = np.atleast_1d(numbers_of(t, "the times of a tube"))
        if self._proof is None:
            return {}
        names = list(reported_quantities(self._proof.problem.system))
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
            If matplotlib is missing, or nothing is proved.
        """
        if self._proof is None:
            raise InvalidSetting("nothing is proved that could be plotted")
        problem = self._proof.problem
        t = np.linspace(problem.reference.start_time, problem.reference.end_time, _SAMPLES)
        tube, known = self.tube(t), reported_quantities(problem.system)
        chosen = list(names) if names is not None else [each.name for each in problem.system.inputs]
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
        If a limit or a parameter is unknown, an interval is none, or the solution does not know what was solved.

    Examples
    --------
    >>> import servocore as sc
    >>> certificate = sc.certify(sc.scenes.overhead_crane())
    >>> certificate.verdict
    'proved'
    """
    solution = scene_or_solution if isinstance(scene_or_solution, Solution) else None
    if isinstance(scene_or_solution, Solution):
        problem = scene_or_solution.origin
        require_kind(problem, Problem, "what a solution to be certified solves", "known to it", InvalidSetting)
    else:
        problem = Problem.of(scene_or_solution, model)
    path, bounds, jumps = problem.reference, dict[str, ErrorBound](), tuple[float, ...]()
    proof: Proof | None = None
    extra = (limit_named(problem.system, name, each) for name, each in (limits or {}).items())
    wanted = [(f"{LIMIT}{k.quantity}", k) for k in (*problem.limits, *extra) if not k.at_instants_only]
    boxed, rates = _box(problem, parameters or {}), any(limit.rate for _, limit in wanted)
    if not problem.flat:
        proof, statements = near_states(problem, solution, tolerance, bool(boxed))
    elif path.max_order < problem.array.reference_order + rates:
        text = f"the path has derivatives up to order {path.max_order} only: it is too rough for the inputs"
        statements = [Statement("one motion", "refuted", text)]
    else:
        proof, statements = Proof(problem, boxed, tolerance, rates), []
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
    names, boxed = problem.system.parameters.names, {}
    for name, interval in parameters.items():
        if name not in names:
            raise InvalidSetting(f"{problem.name} has no parameter {name}; there are {', '.join(names)}")
        low, high = (float(each) for each in interval)
        if not low < high:
            raise InvalidSetting(f"the interval of {name} must run from a lower to a higher value, not {interval}")
        boxed[names.index(name)] = (low, high)
    return boxed
