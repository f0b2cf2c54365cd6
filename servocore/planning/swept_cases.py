"""What a sweep computes of its cases, in whatever process: peaks, margins and inputs, by one compiled function.

A `Work` is data only, so that it travels: functions as texts, limits as numbers. Its function is rebuilt, and its
machine code found again, once in every process.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from servocore.errors import InvalidSetting
from servocore.model.limits import Limit
from servocore.model.quantity import Quantity
from servocore.numerics.calls import Array, at_instants
from servocore.numerics.vectorised import Vectorised
from servocore.problem import Problem
from servocore.solvers.batch import compile_reading
from servocore.stepping.observation import observed
from servocore.stepping.path_function import jet_of, with_path_inside

SWING = "swing"
"""The observable whose peak is told beside those of the inputs, where a model has it."""

_AT_ONCE = 64  # cases: their results stay in the cache of a processor until their peaks are known


@dataclass(frozen=True)
class Work:
    """What is computed of every case.

    Attributes
    ----------
    title : str
        Of the scene, for messages.
    on_path : str
        Function (t, numbers of the path, p) -> rows, as text; (gamma, p) -> rows where the path is no formula.
    jet : str
        Function (t, numbers) -> gamma, as text; empty where the path is no formula.
    seeking : str
        Function (gamma, p) -> rows by Newton's method, as text.
    inputs : int
        The first rows are inputs,
    swing : bool
        the next is the swing where there is one,
    bounds : tuple of (float, float)
        the next ones are limited so; what follows must be positive.
    native : bool or None
        As for `ExactInversion`.
    """

    title: str
    on_path: str
    jet: str
    seeking: str
    inputs: int
    swing: bool
    bounds: tuple[tuple[float, float], ...]
    native: bool | None


@dataclass(frozen=True)
class Cases:
    """Some cases: times (cases or 1, N), what stands for their paths, and parameters (cases, size).

    `paths` has the numbers of the formula, (cases or 1, size), or reference jets (cases or 1, rows, N).
    """

    t: Array
    paths: Array
    p: Array

    def parts(self) -> Iterator[Cases]:
        """Yield a few cases at a time."""
        for first in range(0, len(self.p), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            t, paths = (each[some] if len(each) > 1 else each for each in (self.t, self.paths))
            yield Cases(t, paths, self.p[some])


def work_of(problem: Problem, limits: tuple[Limit, ...], native: bool | None, by_formula: bool) -> Work:
    """Compile what is to be computed of the cases of a flat problem.

    With `by_formula` the path becomes part of the function, see `Swept`.

    Raises
    ------
    InvalidSetting
        If a limit is on the rate of what is no function of positions: its exact rate takes one derivative more.
    """
    system = problem.system
    known = {each.name: (each, expression) for each, expression in observed(system)}
    wanted = [known[each.name] for each in system.inputs]
    swing = SWING in known
    wanted += [known[SWING]] if swing else []
    wanted += [(Quantity(each.quantity, each.unit), _limited(problem, each)) for each in limits]
    wanted += [each for each in known.values() if each[0].positive]
    quick, seeking = compile_reading(problem.resolved, wanted)
    on_path, jet, formula = quick or seeking, "", problem.reference.formula
    if by_formula and quick is not None and formula is not None:
        on_path, jet = with_path_inside(quick, formula), jet_of(formula, problem.array.reference_order).serialize()
    bounds = tuple((each.bound, each.upper) for each in limits)
    return Work(problem.name, on_path.serialize(), jet, seeking.serialize(), len(system.inputs), swing, bounds, native)


def _limited(problem: Problem, limit: Limit) -> ca.SX:
    system, expression = problem.system, limit.on(problem.system)
    if not limit.rate:
        return expression
    if ca.depends_on(expression, ca.vertcat(system.v, system.lam, system.u, ca.vec(system.gamma))):
        raise InvalidSetting(
            f"{limit.quantity} takes a derivative that a sweep does not have: it limits rates of positions only"
        )
    return ca.jtimes(expression, system.q, system.v)


def evaluated(work: Work, cases: Cases, inputs: bool) -> dict[str, Array]:
    """Return ``peaks`` (cases, inputs), ``swing`` (cases,), ``margins`` (cases, limits) and ``solved`` (cases,).

    With `inputs` also these, (cases, N, inputs). Cases that are not solved at some instant hold NaN.
    """
    found = [_of_part(work, part, inputs) for part in cases.parts()]
    return {name: np.concatenate([each[name] for each in found]) for name in found[0]}


def _of_part(work: Work, cases: Cases, inputs: bool) -> dict[str, Array]:
    rows = _rows(work, cases)
    m, limits = work.inputs, work.inputs + work.swing
    highest, lowest = rows.max(axis=2), rows.min(axis=2)  # NaN if there is one
    positive = lowest[:, limits + len(work.bounds) :] > 0.0
    solved = np.isfinite(highest).all(axis=1) & np.isfinite(lowest).all(axis=1) & positive.all(axis=1)
    for each in () if solved.all() else (rows, highest, lowest):
        each[~solved] = np.nan
    peaks = np.maximum(highest, -lowest)
    low, high = np.array(work.bounds).reshape(-1, 2).T
    among = slice(limits, limits + len(work.bounds))
    found = {
        "peaks": peaks[:, :m],
        "swing": peaks[:, m] if work.swing else np.empty(len(rows)),
        "margins": np.minimum(lowest[:, among] - low, high - highest[:, among]),
        "solved": solved.astype(float),
    }
    return {**found, "inputs": rows[:, :m].transpose(0, 2, 1)} if inputs else found


def _rows(work: Work, cases: Cases) -> Array:
    """Return all rows, shape (cases, rows, N)."""
    quick, jet, seeking = _rebuilt(work)
    if jet is None:
        rows = np.asarray(quick(cases.paths if len(cases.paths) > 1 else cases.paths[0], cases.p)[0])
    else:
        t = cases.t[:, None] if len(cases.t) > 1 else cases.t
        rows = np.asarray(quick(t, cases.paths if len(cases.paths) > 1 else cases.paths[0], cases.p)[0])
    if np.isfinite(rows.sum()):
        return rows
    left = np.asarray(~np.isfinite(rows).all(axis=1))
    for case in np.flatnonzero(left.any(axis=1)):
        at, which = np.flatnonzero(left[case]), case % len(cases.paths)
        if jet is None:
            side = cases.paths[which].T
            jets = side.reshape(len(side), -1, seeking.size1_in(0))[at]
        else:
            t, numbers = cases.t[case % len(cases.t)][at], cases.paths[which]
            jets = np.stack([np.array(jet(each, numbers)).T for each in t])
        rows[case][:, at] = at_instants(seeking, jets=jets, p=cases.p[case])[0]
    return rows


@lru_cache(maxsize=4)  # a process gets the same work with every block, and nothing else lives as long as it does
def _rebuilt(work: Work) -> tuple[Vectorised, ca.Function | None, ca.Function]:
    """Return the functions of a work: made once in every process."""
    on_path, seeking = (ca.Function.deserialize(each) for each in (work.on_path, work.seeking))
    jet = ca.Function.deserialize(work.jet) if work.jet else None
    along = (True, False, False) if jet is not None else (True, False)
    return Vectorised(on_path, along, work.native, work.title), jet, seeking
