"""The computation of a sweep's cases in any process: peaks, margins and inputs, by one compiled function.

A `Work` is data only, so that it travels: functions as texts, limits as numbers. Its function is rebuilt, and its
machine code found again, once in every process.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidSetting
from servocore.model.limits import Limit, RunQuantity, expression_of, run_quantities
from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array, at_instants
from servocore.numerics.memoization import made_once
from servocore.numerics.vectorized import Extremes, Vectorized, extremes_of
from servocore.problem import Problem
from servocore.stepping.exact_evaluation import exact_evaluation
from servocore.stepping.readings import reading

SWING = "swing"
"""The observable whose peak is reported beside those of the inputs, where a model has it."""

_AT_ONCE = 64  # cases: the results of one call stay in the cache of a processor


@dataclass(frozen=True)
class Work:
    """The evaluation of every case.

    Attributes
    ----------
    title : str
        Of the scene, for messages.
    by_expression, by_newton : str
        Functions (gamma, [duration, *p]) -> rows, from the path in a second, as texts; the second by Newton's method.
        They may be the same.
    inputs : tuple of str
        The first rows are inputs of these names.
    peaks : tuple of str
        Variables of the largest magnitudes of these and of the next rows, see `peaked`;
    bounds : tuple of (str, float, float)
        the next ones have limits of these names between these bounds; the rows after them must be positive.
    turns : tuple of int
        Rows with angles that are known up to full turns: in limited rows their jumps are removed.
    of_run : tuple of (int, RunQuantity)
        Rows with integrands of quantities of the run.
    kept : bool
        Whether the inputs are kept at every instant.
    native : bool or None
        As for `ExactInversion`.
    """

    title: str
    by_expression: str
    by_newton: str
    inputs: tuple[str, ...]
    peaks: tuple[str, ...]
    bounds: tuple[tuple[str, float, float], ...]
    turns: tuple[int, ...]
    of_run: tuple[tuple[int, RunQuantity], ...]
    kept: bool
    native: bool | None


@dataclass(frozen=True)
class Cases:
    """Some cases: the jets of their paths, and their parameters.

    Attributes
    ----------
    jets : mapping of int to ndarray, shape (m (order + 1), N)
        By number of the path, gamma, gamma', ... at the instants, of the path in a second.
    path : ndarray, shape (cases,)
        Which path each has.
    numbers : ndarray, shape (cases, 1 + parameters)
        The duration of each in s, and values of the parameters.
    """

    jets: Mapping[int, Array]
    path: npt.NDArray[np.intp]
    numbers: Array


def peaked(system: MechanicalSystem) -> dict[str, Quantity]:
    """Return the quantities that a sweep reports by their peaks, by its variables: inputs, those of drives, the swing.

    Of energies and effective torques the value at the end is reported.
    """
    of_inputs = tuple(f"{each.name}." for each in system.inputs)
    peaks = {f"peak_{e.name}": e for e in (*system.inputs, *system.observables) if f"{e.name}.".startswith(of_inputs)}
    peaks |= {each.name: each for each in run_quantities(peaks.values())}
    return peaks | {each.name: each for each in system.observables if each.name == SWING}


def work_of(problem: Problem, limits: tuple[Limit, ...], kept: bool, native: bool | None) -> Work:
    """Compile the evaluation of the cases of a flat problem.

    Raises
    ------
    InvalidSetting
        If a limit is on the rate of a quantity that is no function of positions: it takes one derivative more.
    """
    system = problem.system
    peaks = peaked(system)
    wanted = [(each, expression_of(each)(system)) for each in peaks.values()]
    wanted += [(Quantity(limit.quantity, limit.unit), _limited(problem, limit)) for limit in limits]
    wanted += problem.resolved.must_be_positive
    # A path on which the rope goes slack has inputs too: each case, of its own duration and gravity, is held to it.
    wanted += [(Quantity(each.quantity, each.unit), each.on(system) - each.bound) for each in problem.path_limits]
    exact = exact_evaluation(problem.resolved, reading(problem.resolved, [each for _, each in wanted]), False)
    texts = [_in_time(function).serialize() for function in (exact.by_expression.function, exact.by_newton)]
    bounds = tuple((limit.quantity, limit.bound, limit.upper) for limit in limits)
    inputs = tuple(quantity.name for quantity in system.inputs)
    turns = tuple(len(peaks) + k for k, limit in enumerate(limits) if limit.counts_turns(system))
    rows = enumerate([*peaks.values(), *(limit.expression for limit in limits)])
    of_run = tuple((k, each) for k, each in rows if isinstance(each, RunQuantity))
    return Work(problem.name, texts[0], texts[1], inputs, tuple(peaks), bounds, turns, of_run, kept, native)


def _in_time(function: ca.Function) -> ca.Function:
    """Return (gamma, [duration, *p]) -> the results of a function (gamma, p), from gamma of the path in a second.

    Thus all cases of a path share its jets: d^k gamma/dt^k is theirs over duration^k.
    """
    kind: Any = ca.SX if function.is_a("SXFunction") else ca.MX
    gamma, numbers = kind.sym("gamma", *function.size_in(0)), kind.sym("given", 1 + function.numel_in(1))
    rate, powers = 1.0 / numbers[0], [kind(1.0)]
    for _ in range(gamma.size2() - 1):
        powers.append(powers[-1] * rate)
    columns = [column * power for column, power in zip(ca.horzsplit(gamma), powers, strict=True)]
    return ca.Function(
        "sc_in_time", [gamma, numbers], function.call([ca.horzcat(*columns), numbers[1:]]), {"cse": True}
    )


def _limited(problem: Problem, limit: Limit) -> ca.SX:
    system, expression = problem.system, limit.on(problem.system)
    if not limit.rate:
        return expression
    if ca.depends_on(expression, ca.vertcat(system.v, system.lam, system.u, ca.vec(system.gamma))):
        raise InvalidSetting(
            f"{limit.quantity} takes a derivative that a sweep does not have: it limits rates of positions only"
        )
    rate = ca.jtimes(expression, system.q, system.v)
    return ca.if_else(ca.fabs(rate) < np.inf, rate, 0.0)  # there is none at a kink, such as that of the swing at rest


def evaluated(work: Work, cases: Cases) -> dict[str, Array]:
    """Return the numbers of cases by the names that they have in a sweep's dataset, and ``solved``; shape (cases,).

    Inputs that are kept have shape (cases, N). Cases that are not solved at some instant hold NaN.
    """
    rows_of, extremes_at, by_newton = _rebuilt(work)
    kept = len(work.inputs) if work.kept else 0
    inputs = np.empty((len(cases.numbers), kept, next(iter(cases.jets.values())).shape[1]))
    extremes = np.empty((len(cases.numbers), 2, rows_of.function.numel_out(0)))
    for path, jets in cases.jets.items():
        of_path = np.flatnonzero(cases.path == path)
        for some in np.split(of_path, range(_AT_ONCE, len(of_path), _AT_ONCE)):
            if extremes_at is not None:
                extremes[some] = extremes_at(jets, cases.numbers[some])[0]
                continue
            rows = _rows(rows_of, by_newton, jets, cases.numbers[some])
            rows[:, work.turns] = np.unwrap(rows[:, work.turns])
            for k, each in work.of_run:
                t = np.linspace(0.0, cases.numbers[some, 0], rows.shape[2], axis=-1)
                rows[:, k] = each.course(t, rows[:, k])[:, -1:]
            extremes[some] = extremes_of(rows)
            inputs[some] = rows[:, :kept]
    if extremes_at is not None:
        for case in np.flatnonzero(~np.isfinite(extremes).all(axis=(1, 2))):
            jets = cases.jets[int(cases.path[case])]
            extremes[case] = extremes_of(_rows(rows_of, by_newton, jets, cases.numbers[case : case + 1]))[0]
    answers = _told(work, extremes)
    inputs[answers["solved"] == 0.0] = np.nan
    return answers | dict(zip(work.inputs[:kept], inputs.transpose(1, 0, 2), strict=True))


def _told(work: Work, extremes: Array) -> dict[str, Array]:
    highest, lowest = extremes[:, 0], extremes[:, 1]
    first = len(work.peaks)
    solved = np.isfinite(extremes).all(axis=(1, 2)) & (lowest[:, first + len(work.bounds) :] > 0.0).all(axis=1)
    extremes[~solved] = np.nan
    answers = {name: np.maximum(highest[:, k], -lowest[:, k]) for k, name in enumerate(work.peaks)}
    answers |= {work.peaks[k]: highest[:, k] for k, _ in work.of_run if k < first}
    for k, (name, low, high) in enumerate(work.bounds, first):
        answers[f"margin_{name}"] = np.minimum(lowest[:, k] - low, high - highest[:, k])
    return {**answers, "solved": solved.astype(float)}


def _rows(rows_of: Vectorized, by_newton: ca.Function, jets: Array, numbers: Array) -> Array:
    """Return all rows of cases of one path, shape (cases, rows, N)."""
    rows = rows_of(jets, numbers)[0]
    if np.isfinite(rows.sum()):
        return rows
    left = np.asarray(~np.isfinite(rows).all(axis=1))
    for case in np.flatnonzero(left.any(axis=1)):
        at = np.flatnonzero(left[case])
        gamma = jets.T[at].reshape(len(at), -1, by_newton.size1_in(0))
        rows[case][:, at] = at_instants(by_newton, jets=gamma, p=numbers[case])[0]
    return rows


@made_once  # a process gets the same work with every block, and nothing else lives as long as it does
def _rebuilt(work: Work) -> tuple[Vectorized, Extremes | None, ca.Function]:
    """Return all rows, their extremes where nothing else is kept, and all rows by Newton's method."""
    by_expression, by_newton = (ca.Function.deserialize(text) for text in (work.by_expression, work.by_newton))
    how = (by_expression, (True, False))
    if work.kept or work.turns or work.of_run:
        return Vectorized(*how, work.native, work.title), None, by_newton
    return Vectorized(*how, False, work.title), Extremes(*how, work.native, work.title), by_newton
