"""`certify`: proofs about the motion of a flat scene at all times, and `Certificate`, which holds them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from servocore.certificate.causes import cause_of, switchings
from servocore.certificate.instants import ErrorBound, compared, tube_of
from servocore.certificate.proof import Proof
from servocore.certificate.statements import (
    LIMIT,
    Statement,
    Verdict,
    left_out_statement,
    limit_statements,
    mass_statement,
    run_statements,
    step_statement,
    summary_of,
    unproved,
)
from servocore.errors import InvalidSetting, require_kind
from servocore.model.limits import Bounds, Limit, Named, limit_named, reported_quantities
from servocore.model.scene import Scene
from servocore.numerics.compiled_calls import Array
from servocore.presentation import Curve, figure_of
from servocore.problem import Problem
from servocore.references.base import numbers_of
from servocore.solution import Solution

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SPLITS = 32  # boxes of parameters at most
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
    _proofs: tuple[Proof, ...] = field(default=(), repr=False)

    @property
    def verdict(self) -> Verdict:
        """Of all statements together: "refuted" if one is, else "undecided" if one is, else "proved"."""
        found = {statement.verdict for statement in self.statements}
        return next((each for each in ("refuted", "undecided") if each in found), "proved")

    @property
    def summary(self) -> str:
        """The verdict in one line: the proved statements, or the first that fails."""
        bound = max((each.relative for each in self.error_bounds.values()), default=0.0)
        return summary_of(self.verdict, self.statements, bound, self.jumps)

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
            not proved.
        """
        times = np.atleast_1d(numbers_of(t, "the times of a tube"))
        names = list(reported_quantities(self._proofs[0].problem.system)) if self._proofs else []
        found = [tube_of(proof, times, names) for proof in self._proofs]
        low, high = (np.minimum.reduce([a for a, _ in found]), np.maximum.reduce([b for _, b in found]))
        return {name: np.stack([low[k], high[k]], axis=1) for k, name in enumerate(names)}

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
        if not self._proofs:
            raise InvalidSetting("nothing is proved that could be plotted")
        problem = self._proofs[0].problem
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
        A scene without internal dynamics, or a solution of one, whose inputs are then compared with the proved ones.
    limits : mapping of str to bounds, optional
        Limits besides those of the scene, see `Scene.with_limits`.
    parameters : mapping of str to (float, float), optional
        Intervals of parameters: everything is then proved for all values in the box.
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
        If a limit or a parameter is unknown, or an interval is none.
    InvalidModel
        If the solution does not know what was solved.

    Examples
    --------
    >>> import servocore as sc
    >>> certificate = sc.certify(sc.scenes.overhead_crane())
    >>> certificate.verdict
    'proved'
    """
    problem, solution = _problem_of(scene_or_solution, model)
    path = problem.reference
    begin, end = path.start_time, path.end_time
    if not problem.flat:
        text = "the states of the internal dynamics come from an integration, whose error is estimated and not proved"
        if solution is not None and solution.error.largest is not None:
            text += f": inputs within {solution.error.largest:.1e} of their peaks by {solution.error.basis}"
        return Certificate(
            problem.name, (Statement("one motion", "undecided", begin, end, text),), {}, np.zeros((0, 2))
        )
    system = problem.system
    extra = tuple(limit_named(system, name, bounds) for name, bounds in (limits or {}).items())
    run_limits = (*problem.run_limits, *(limit for limit in extra if limit.over_run))
    extra = tuple(limit for limit in extra if not limit.over_run)
    wanted = tuple(limit for limit in (*problem.limits, *extra) if not limit.at_instants_only)
    boxed = _boxes(problem, parameters or {})
    if path.max_order < problem.array.reference_order + any(limit.rate for limit in wanted):
        text = f"the path has derivatives up to order {path.max_order} only: it is too rough for the inputs"
        return Certificate(problem.name, (Statement("one motion", "refuted", begin, end, text),), {}, np.zeros((0, 2)))
    proofs = _proved(problem, boxed, tolerance, any(limit.rate for limit in wanted))
    statements = [*_motion_statements(proofs)]
    intervals = np.array([(each.begin, each.end) for each in proofs[0].intervals if not each.outside])
    jumps = sorted({a.end for proof in proofs for a, joint in zip(proof.intervals, proof.joints, strict=False)
                    if joint == "inputs jump"}
                   | {time for proof in proofs for time, sentence in switchings(proof) if not sentence})  # fmt: skip
    bounds: dict[str, ErrorBound] = {}
    if all(each.proved for proof in proofs for each in proof.intervals):
        bounds, of_instants = compared(proofs, solution, tolerance)
        statements += of_instants
    signs = [
        Limit(each.name, each.unit, 0.0, each.wrong_sign, Named(each.name))
        for each in reported_quantities(system).values()
        if each.positive
    ]
    statements += limit_statements(
        proofs, (*wanted, *signs),
        lambda limit: f"{limit.quantity} positive" if limit in signs else f"{LIMIT}{limit.quantity}",
    )  # fmt: skip
    statements += run_statements(proofs, run_limits)
    statements += [*step_statement(problem), *left_out_statement(proofs), mass_statement(proofs)]
    return Certificate(problem.name, tuple(statements), bounds, intervals, tuple(jumps), tuple(proofs))


def _problem_of(subject: Scene | Solution, model: str | None) -> tuple[Problem, Solution | None]:
    if isinstance(subject, Solution):
        require_kind(subject.origin, Problem, "what a solution to be certified solves", "known to it", InvalidSetting)
        return subject.origin, subject
    return Problem.of(subject, model), None


def _boxes(problem: Problem, parameters: Mapping[str, tuple[float, float]]) -> dict[int, tuple[float, float]]:
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


def _proved(problem: Problem, boxed: dict[int, tuple[float, float]], tolerance: float, rates: bool) -> list[Proof]:
    """Prove the motion for all parameters of a box, in parts where it is not proved as a whole."""
    todo, done = [boxed], list[Proof]()
    while todo:
        box = todo.pop(0)
        p = problem.p.copy()
        for k, (low, high) in box.items():
            p[k] = (low + high) / 2.0
        proof = Proof(replace(problem, p=p), box, tolerance, rates).run()
        if box and unproved(proof) and len(todo) + len(done) < _SPLITS:
            k = max(box, key=lambda each: (box[each][1] - box[each][0]) / max(np.abs(box[each])))
            low, high = box[k]
            middle = (low + high) / 2.0
            todo += [{**box, k: (low, middle)}, {**box, k: (middle, high)}]
        else:
            done.append(proof)
    return done


def _motion_statements(proofs: Sequence[Proof]) -> list[Statement]:
    """State that there is one motion on one branch, regular at all times, and as smooth as motions are."""
    path = proofs[0].problem.reference
    begin, end, statements = path.start_time, path.end_time, list[Statement]()
    for what, joints in (
        ("one motion, regular at all times", ()), ("one branch from the beginning to the end", ("apart", "not proved")),
        ("path smooth enough for the motion", ("motion jumps",)),
    ):  # fmt: skip
        verdict: Verdict = "proved"
        sentence, time = "", None
        for proof in proofs:
            open_ = unproved(proof) if not joints else []
            places = [k for k, joint in enumerate(proof.joints) if joint in joints]
            if not open_ and not places:
                continue
            if open_:
                verdict, time, sentence = cause_of(proof, open_)
            elif "motion jumps" in joints:
                verdict, time = "refuted", proof.intervals[places[0]].end
                sentence = f"coordinates or velocities jump at t = {time:.6g} s: the path is too rough there"
            else:
                verdict, time = "undecided", proof.intervals[places[0]].end
                sentence = f"not decided at t = {time:.6g} s that the motion goes on as it was before"
            break
        statements.append(Statement(what, verdict, begin, end, sentence, time))
    return statements
