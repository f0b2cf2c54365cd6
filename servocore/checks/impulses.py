"""Where a motion jumps although its path does not: the inputs would have to strike between two instants.

A spring with two stiffnesses, a rail with a corner or a stop make the inputs of a flat system hold impulses: they are
derivatives of a force that has a kink. The equations hold at every reported instant, which hides it. Where
an output has a step, no motion may follow the path for a while; a step of a potential or a mass is an impulse itself.

Models without operations that jump or have a kink are not looked at.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import casadi as ca
import numpy as np

from servocore.checks.between_instants import Beside, Looked, Moments, look
from servocore.checks.branches import MANY, Rows
from servocore.checks.findings import BISECTIONS, Finding
from servocore.checks.motion import Motion
from servocore.errors import IntegrationFailed
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once
from servocore.numerics.step_operations import JUMPS, KINKS, holds_any, switching_levels
from servocore.problem import Problem, ResolvedSystem, equations_of
from servocore.stepping.exact_evaluation import along_path
from servocore.structure.derivative_array import DerivativeArray

_LEAST = 1e-4  # of the range of a quantity: a jump that is smaller is no more than other errors
_ASIDE = 1e-8  # of the duration: instants beside a jump
_KINDS = "the model has a kink or a jump there (fabs, sign, floor, fmod, fmin, fmax, if_else)"
_SMOOTH = f"{_KINDS}; a smooth form of it does, such as sqrt(x^2 + e^2) for |x|"


def jumps(motion: Motion) -> Iterator[Finding]:
    """Find where a motion jumps, or where there is none, in rising order."""
    problem = motion.problem
    outcome = problem.resolved.outcome
    if not (isinstance(outcome, DerivativeArray) and problem.resolved.holds(KINKS)) or len(motion.t) < 2:
        return
    at, switches = with_switches(problem, motion.beside, Moments(motion.t, motion.states))
    rows = _motion_rows(outcome)
    found = _of_motion(motion, look(motion.beside, at, rows, _LEAST), rows)
    yield from (finding for _, finding in sorted(found, key=lambda each: each[0]))
    yield from steps_passed(problem, *switches)


@made_once
def _motion_rows(array: DerivativeArray) -> Rows:
    """Return coordinates and velocities; accelerations that are not known count as zero."""
    return Rows.of(array, [(j, order) for order in range(2) for j in range(len(array.system.coordinates))])


def _of_motion(motion: Motion, looked: Looked, rows: Rows) -> Iterator[tuple[float, Finding]]:
    """Yield the jumps of coordinates and velocities, and the gaps of a motion, with their times."""
    quantities, path = motion.problem.system.coordinates.quantities, motion.problem.reference
    n, ranges = len(quantities), rows.ranges(motion.states)
    sides = [(looked.left.of(np.array([k])), looked.right.of(np.array([k])), False) for k in range(len(looked.left.t))]
    for left, right, gap in [*sides, *((*ends, True) for ends in looked.gaps)]:
        row = int(
            (rows.missed(left.states, right.states, right.t - left.t)[:, 0] / np.maximum(ranges, 1e-300)).argmax()
        ) % (n if gap else 2 * n)
        quantity, begin, values = quantities[row % n], float(left.t[0]), list[float]()
        for side, aside in (
            (left, -_ASIDE),
            (right, 0.0 if gap else _ASIDE),
        ):  # a kink itself is neither before nor after
            t = np.clip(side.t + aside * path.duration, path.start_time, path.end_time)
            values.append(motion.beside(side.t, side.states, t)[rows.values[row], 0])
        before, after = values
        if gap:
            what = (
                f"from t = {begin:.9g} s to {right.t[0]:.9g} s no motion is found that follows the path, with"
                f" {quantity.name} at {before:.6g} {quantity.unit} before and at {after:.6g} {quantity.unit} after"
            )
        else:
            name, unit = (
                (quantity.name, quantity.unit) if row < n else
                (f"the velocity of {quantity.name}", f"{quantity.unit}/s")
            )  # fmt: skip
            what = f"at t = {begin:.9g} s {name} would have to jump from {before:.4g} to {after:.4g} {unit}"
            what += ", and the inputs to strike"
        yield begin, Finding(what, cause=_SMOOTH, error=IntegrationFailed)


# Switches, and steps of mass and potential ----------------------------------------------------------------------------


@made_once
def _switching_arguments(resolved: ResolvedSystem) -> ca.Function | None:
    """Compile (q, v, path with the time, p) -> arguments of switches, shape (k,); see `switching_levels`."""
    system = resolved.system
    levels = switching_levels(ca.vertcat(*(ca.vec(ca.densify(each)) for each in equations_of(system))))
    given = [system.q, system.v, system.gamma[:, 0], system.p]
    levels = [each for each in levels if not ca.Function("sc_probe", given, [each], {"allow_free": True}).get_free()]
    return ca.Function("sc_switching", given, [ca.densify(ca.vertcat(*levels))]) if levels else None


def with_switches(problem: Problem, beside: Beside, at: Moments) -> tuple[Moments, tuple[Moments, Moments]]:
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


class SteppedQuantities(NamedTuple):
    """(q, v, path with the time, p) -> quantities of the motion that must not jump."""

    function: ca.Function
    quantities: tuple[Quantity, ...]


@made_once
def _stepped_quantities(resolved: ResolvedSystem) -> SteppedQuantities | None:
    """Compile entries of the mass and the potential that hold jumps, None if there is none."""
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
    return SteppedQuantities(function, tuple(each for each, _ in found))


def steps_passed(problem: Problem, left: Moments, right: Moments) -> Iterator[Finding]:
    """Yield the steps of masses and of the potential between both sides of switches."""
    stepped = _stepped_quantities(problem.resolved)
    if stepped is None or not len(left.t):
        return
    rows = _motion_rows(problem.array).values
    q = rows[: len(rows) // 2]
    # At one time, so that what depends on time alone is no step.
    before, after = (along_path(problem, stepped.function, left.t, side.states[q])[0] for side in (left, right))
    for row, k in np.argwhere(np.abs(after - before) > _LEAST * np.maximum(np.abs(after), np.abs(before))):
        quantity, time = stepped.quantities[row], left.t[k]
        values = f"{before[row, k]:.4g} to {after[row, k]:.4g} {quantity.unit}".rstrip()
        what = f"at t = {time:.9g} s {quantity.name} jumps from {values}, which is an impulse"
        yield Finding(what, cause=_SMOOTH, error=IntegrationFailed)
