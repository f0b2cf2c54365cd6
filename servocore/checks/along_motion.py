"""Properties of a model that may fail along a motion, though it has them at home, at all reported instants or both.

Constraints that were left out as redundant hold at home. Masses are positive there. A rope goes slack where its tension
comes to zero or its length to infinity: a load that moves aside while it falls as fast as gravity pulls needs a level
rope, which never gets there.

A spring with two stiffnesses, a rail with a corner or a stop make the inputs of a flat system hold impulses: they are
derivatives of a force that has a kink, and would have to strike between two instants. The equations hold at every
reported instant, which hides it. Where an output has a step, no motion may follow the path for a while; a step of a
potential or a mass is an impulse itself. Models without operations that jump or have a kink are not looked at.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from servocore.checks.between_instants import Beside, Ends, Moments, look
from servocore.checks.branches import MANY, Rows
from servocore.checks.findings import BISECTIONS, ROUND_OFF, Finding, bisected
from servocore.checks.motion import Motion
from servocore.errors import IntegrationFailed, InvalidModel, ServocoreError
from servocore.model.limits import Limit, reported_quantities
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once
from servocore.numerics.step_operations import JUMPS, KINKS, holds_any, switching_levels
from servocore.problem import LEFT_OUT_HOLDS, Problem, ResolvedSystem, equations_of
from servocore.references.base import survey
from servocore.references.timed_path import TimeScaled
from servocore.stepping.exact_evaluation import along_path
from servocore.stepping.readings import exact_quantities
from servocore.structure.derivative_array import DerivativeArray

_WHY = "it follows from the others where the model is at home, and was left out"
_INSTANTS = 9  # at which masses are looked at


def left_out(problem: Problem, t: Array, q: Array) -> Iterator[Finding]:
    """Find the first holonomic constraint that was left out and does not hold along a motion q, shape (n, N).

    Around home it follows from the others. A stop that is not touched there does as well, and so do two supports that
    begin to move apart.
    """
    if not problem.resolved.redundant:
        return
    values, shares, _ = along_path(problem, _compiled_properties(problem.resolved), t, q)
    broken = np.abs(shares) > LEFT_OUT_HOLDS
    if broken.any():
        row, k = (int(place) for place in np.argwhere(broken.T)[0][::-1])
        what = f"the holonomic constraint {_names(problem)[row]} does not hold, by {abs(values[row, k]):.3g}: {_WHY}"
        yield Finding(f"at t = {t[k]:.6g} s {what}", error=InvalidModel)


def with_redundant_constraints_as_limits(problem: Problem) -> Problem:
    """Return the problem with limits that refuse a motion on which a constraint that was left out does not hold.

    For exported models, which follow other paths than the one of their scene.
    """
    if not problem.resolved.redundant:
        return problem
    shares = ca.vertsplit(problem.resolved.left_out_shares)
    limits = tuple(
        Limit(
            f"the share of {name} that is left", "1",
            -LEFT_OUT_HOLDS, f"the holonomic constraint {name} does not hold, {_WHY}",
            lambda _, share=share: share, upper=LEFT_OUT_HOLDS,
        )
        for name, share in zip(_names(problem), shares, strict=True)
    )  # fmt: skip
    return replace(problem, limits=problem.limits + limits)


def _names(problem: Problem) -> list[str]:
    names, rows = problem.left_out.split(", "), problem.resolved.left_out.numel()
    return names if len(names) == rows else [problem.left_out] * rows


@made_once
def _compiled_properties(resolved: ResolvedSystem) -> ca.Function:
    """Compile (q, path with the time, p) -> constraints left out, how far they are from holding, mass matrix."""
    system = resolved.system
    results = [ca.densify(resolved.left_out), resolved.left_out_shares, ca.vec(ca.densify(system.mass))]
    return ca.Function("sc_properties", [system.q, system.gamma[:, 0], system.p], results)


def negative_masses(problem: Problem, t: Array, q: Array) -> Iterator[Finding]:
    """Find the first instant at which a mass matrix that depends on the configuration has a negative eigenvalue.

    A constant one is checked when the system is made.
    """
    if not problem.resolved.mass_varies:
        return
    few = np.arange(_INSTANTS) * (len(t) - 1) // (_INSTANTS - 1)
    t, q = t[few], q[:, few]
    *_, masses = along_path(problem, _compiled_properties(problem.resolved), t, q)
    eigenvalues = np.linalg.eigvalsh(np.where(np.isfinite(masses), masses, 0.0).T.reshape(len(t), len(q), len(q)))
    negative = np.flatnonzero(eigenvalues[:, 0] < -ROUND_OFF * np.abs(eigenvalues).max(axis=1))
    if len(negative):
        k = int(negative[0])
        what = f"at t = {t[k]:.6g} s the mass matrix has the negative eigenvalue {eigenvalues[k, 0]:.4g}"
        yield Finding(f"{what}; no mechanism has negative mass", error=InvalidModel)


_SLACK = 0.02  # of the median before: tensions below, lengths above as many times
_LONGER = 2.0, 4.0, 8.0, 16.0, 32.0, 64.0  # times the duration


def slack_rope(problem: Problem) -> str:
    """Say when a rope of a problem without internal dynamics goes slack, and what duration would do; else empty."""
    quantities = reported_quantities(problem.system).values()
    signed = [each for each in quantities if each.positive or (each.never_negative and each.unit == "N")]
    said = _first_slack(problem, signed) if signed else ""
    if not said:
        return ""
    duration = _least_duration(problem, signed)
    remedy = f"; in more than {duration:.4g} s the same law keeps it taut" if duration else ""
    return f"{problem.name}: {said}{remedy}"


def _first_slack(problem: Problem, signed: Sequence[Quantity]) -> str:
    """Return which rope first goes slack and when, of quantities that are positive; empty if none does."""
    evaluate = exact_quantities(problem.resolved, tuple(each.name for each in signed), False)

    def values(t: Array) -> Array:
        return evaluate(problem, t)[0]

    t = survey(problem.reference)
    found = values(t)
    bad = np.flatnonzero(~(found > 0.0).all(axis=0))
    if not len(bad) or bad[0] == 0:
        return ""
    usual = np.median(found[:, : bad[0]], axis=1)
    good, _ = bisected(lambda at: bool((values(np.array([at])) > 0.0).all()), t[bad[0] - 1], t[bad[0]])
    for each, share in zip(signed, values(np.array([good]))[:, 0] / usual, strict=True):
        if each.unit == "N" and share < _SLACK:
            return f"the rope goes slack at t = {good:.6g} s: {each.name} comes to 0 N, and a rope cannot push"
        if each.unit == "m" and share * _SLACK > 1.0:
            return (
                f"the rope goes slack at t = {good:.6g} s: {each.name} grows beyond all bounds, for the load would fall"
                " as fast as gravity pulls it"
            )
    return ""


def _least_duration(problem: Problem, signed: Sequence[Quantity]) -> float:
    """Return the duration from which on the law keeps all ropes taut, rounded up to four digits; 0 if none is found."""
    path = problem.reference

    def kept(factor: float) -> bool:
        longer = replace(problem, reference=TimeScaled.to(path, factor * path.duration))
        try:
            return not _first_slack(longer, signed)
        except ServocoreError:
            return False

    longest = next((factor for factor in _LONGER if kept(factor)), 0.0)
    if not longest:
        return 0.0
    longest, _ = bisected(kept, longest, longest / 2.0, BISECTIONS // 2)
    digits = 3 - int(np.floor(np.log10(longest * path.duration)))
    return float(np.ceil(longest * path.duration * 10.0**digits) / 10.0**digits)


_LEAST = 1e-4  # of the range of a quantity: a jump that is smaller is no more than other errors
_KINDS = "the model has a kink or a jump there (fabs, sign, floor, fmod, fmin, fmax, if_else)"
_SMOOTH = f"{_KINDS}; a smooth form of it does, such as sqrt(x^2 + e^2) for |x|"


def jumps(motion: Motion) -> Iterator[Finding]:
    """Find where a motion jumps, or where there is none, in rising order."""
    problem = motion.problem
    if not problem.resolved.holds(KINKS) or len(motion.t) < 2:
        return
    at, switches = with_switches(problem, motion.beside, Moments(motion.t, motion.states))
    rows = _motion_rows(problem.array)
    _, left, gaps = look(motion.beside, at, rows, _LEAST)
    yield from _of_motion(motion, left, gaps, rows)
    yield from steps_passed(problem, *switches)


@made_once
def _motion_rows(array: DerivativeArray) -> Rows:
    """Return coordinates and velocities; accelerations that are not known count as zero."""
    return Rows.of(array, [(j, order) for order in range(2) for j in range(len(array.system.coordinates))])


def _of_motion(motion: Motion, short: Ends, gaps: list[Ends], rows: Rows) -> Iterator[Finding]:
    """Yield the jumps of coordinates and velocities, and the gaps of a motion, in rising order."""
    quantities, path = motion.problem.system.coordinates.quantities, motion.problem.reference
    n, ranges = len(quantities), rows.ranges(motion.states)
    beside = 10.0 * ROUND_OFF * path.duration  # the time of a jump is known to round-off
    sides = [(short[0].of(k), short[1].of(k)) for k in np.arange(len(short[0].t))[:, None]]
    every = [*((ends, False) for ends in sides), *((ends, True) for ends in gaps)]
    for (left, right), gap in sorted(every, key=lambda each: float(each[0][0].t[0])):
        missed = rows.missed(left.states, right.states, right.t - left.t)[:, 0] / np.maximum(ranges, 1e-300)
        row = int(missed.argmax()) % (n if gap else 2 * n)
        quantity, begin, values = quantities[row % n], float(left.t[0]), list[float]()
        asides = -beside, 0.0 if gap else beside  # a kink itself is neither before nor after
        for side, aside in zip((left, right), asides, strict=True):
            t = np.clip(side.t + aside, path.start_time, path.end_time)
            values.append(motion.beside(side.t, side.states, t)[rows.values[row], 0])
        before, after = values
        if gap:
            what = (
                f"from t = {begin:.9g} s to {right.t[0]:.9g} s no motion is found that follows the path, with"
                f" {quantity.name} at {before:.6g} {quantity.unit} before and at {after:.6g} {quantity.unit} after"
            )
        else:
            of, per = ("", "") if row < n else ("the velocity of ", "/s")
            what = f"at t = {begin:.9g} s {of}{quantity.name} would have to jump from {before:.4g} to {after:.4g}"
            what += f" {quantity.unit}{per}, and the inputs to strike"
        yield Finding(f"{what}: {_SMOOTH}", error=IntegrationFailed)


# Switches, and steps of mass and potential ----------------------------------------------------------------------------


@made_once
def _switching_arguments(resolved: ResolvedSystem) -> ca.Function | None:
    """Compile (q, v, path with the time, p) -> arguments of switches, shape (k,); see `switching_levels`."""
    system = resolved.system
    levels = switching_levels(ca.vertcat(*(ca.vec(ca.densify(each)) for each in equations_of(system))))
    given = [system.q, system.v, system.gamma[:, 0], system.p]
    levels = [each for each in levels if not ca.Function("sc_probe", given, [each], {"allow_free": True}).get_free()]
    return ca.Function("sc_switching", given, [ca.densify(ca.vertcat(*levels))]) if levels else None


def with_switches(problem: Problem, beside: Beside, at: Moments) -> tuple[Moments, Ends]:
    """Return moments with those on both sides of every switch between them, and these sides.

    Between two switches that lie close together (`sign` changes, `floor` steps, a branch of `if_else` ends) a model may
    differ from its mode at all reported instants.
    """
    function, rows = _switching_arguments(problem.resolved), _motion_rows(problem.array).values
    none = at.of(np.zeros(0, dtype=np.intp)), at.of(np.zeros(0, dtype=np.intp))
    if function is None:
        return at, none
    n = len(rows) // 2

    def levels(some: Moments) -> Array:
        found = along_path(problem, function, some.t, some.states[rows[:n]], some.states[rows[n:]])[0]
        return np.asarray(np.nan_to_num(np.floor(found), nan=-np.inf))

    known = levels(at)
    # Of a model that rattles not all.
    which, interval = (each[:MANY] for each in np.nonzero(known[:, 1:] != known[:, :-1]))
    if not len(which):
        return at, none
    places, before = np.arange(len(which)), known[which, interval]
    left, right = at.of(interval), at.of(interval + 1)
    for _ in range(BISECTIONS):
        t = (left.t + right.t) / 2.0
        middle = Moments(t, beside(left.t, left.states, t))
        same = levels(middle)[which, places] == before
        left, right = (
            Moments(np.where(same, one.t, other.t), np.where(same, one.states, other.states))
            for one, other in ((middle, left), (right, middle))
        )
    every = at.and_then(left).and_then(right)
    _, order = np.unique(every.t, return_index=True)
    return every.of(order), (left, right)


@made_once
def _stepped_quantities(resolved: ResolvedSystem) -> tuple[ca.Function, tuple[Quantity, ...]] | None:
    """Compile (q, path with the time, p) -> entries of mass and potential that hold jumps; and list these, if any."""
    system = resolved.system
    found: list[tuple[Quantity, ca.SX]] = []
    names = system.coordinates.names
    for i, j in zip(*system.mass.sparsity().get_triplet(), strict=True):
        if i >= j and holds_any(system.mass[i, j], JUMPS):
            of = f"of {names[i]}" if i == j else f"between {names[j]} and {names[i]}"
            found.append((Quantity(f"the mass {of}", ""), system.mass[i, j]))
    if holds_any(system.potential, JUMPS):
        found.append((Quantity("the potential", "J"), system.potential))
    if not found:
        return None
    values = ca.densify(ca.vertcat(*(each for _, each in found)))
    function = ca.Function("sc_stepped", [system.q, system.gamma[:, 0], system.p], [values])
    return function, tuple(each for each, _ in found)


def steps_passed(problem: Problem, left: Moments, right: Moments) -> Iterator[Finding]:
    """Yield the steps of masses and of the potential between both sides of switches."""
    stepped = _stepped_quantities(problem.resolved)
    if stepped is None or not len(left.t):
        return
    rows = _motion_rows(problem.array).values
    q = rows[: len(rows) // 2]
    # At one time, so that what depends on time alone is no step.
    before, after = (along_path(problem, stepped[0], left.t, side.states[q])[0] for side in (left, right))
    for row, k in np.argwhere(np.abs(after - before) > _LEAST * np.maximum(np.abs(after), np.abs(before))):
        quantity, time = stepped[1][row], left.t[k]
        values = f"{before[row, k]:.4g} to {after[row, k]:.4g} {quantity.unit}".rstrip()
        what = f"at t = {time:.9g} s {quantity.name} jumps from {values}, which is an impulse"
        yield Finding(f"{what}: {_SMOOTH}", error=IntegrationFailed)
