"""A look between the instants of a motion, where its derivatives there disagree: peaks, poles and values of wrong sign.

The highest derivatives but one change over an interval by the mean of the highest at its ends, or something happens in
between that neither shows. Such intervals are halved. It is a look and no proof: `certify` proves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.checks.branches import DISAGREEMENT, LESS_THAN_HALF, Passage, Rows, some_of
from servocore.checks.findings import BISECTIONS, ROUND_OFF, Finding
from servocore.checks.motion import Motion
from servocore.errors import IntegrationFailed
from servocore.model.quantity import Quantity
from servocore.numerics.angle_wrapping import wrapped_angle
from servocore.numerics.compiled_calls import Array, Call, Mask, Places
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.stepping.exact_evaluation import along_path
from servocore.stepping.program import Program
from servocore.structure.derivative_array import DerivativeArray

_MOST = 64  # intervals that are halved at once
_TIMES = 2.0  # the largest value at the instants: a peak that they do not show
_NEAR = 1e-2  # of an interval: moments beside a singularity that is passed


Beside = Callable[[Array, Array, Array], Array]
"""(times (N,), unknowns there (size, N), other times (N,)) -> the unknowns at these."""


@dataclass(frozen=True, eq=False)
class Moments:
    """Times (N,) and the unknowns of a motion (size, N) at these times."""

    t: Array
    states: Array

    def of(self, chosen: Places | Mask | slice) -> Moments:
        """Return some of them."""
        return Moments(self.t[chosen], self.states[:, chosen])

    def and_then(self, other: Moments) -> Moments:
        """Return both, one after the other."""
        return Moments(np.concatenate([self.t, other.t]), np.hstack([self.states, other.states]))


Ends = tuple[Moments, Moments]
"""Ends of intervals."""


def look(
    beside: Beside, at: Moments, rows: Rows, share: float, passages: Sequence[Passage] = ()
) -> tuple[Moments, Ends, list[Ends]]:
    """Halve the intervals over which values change by `share` of their ranges more than their rates say.

    Those that hold one of the singularities `passages` are left out.

    Returns
    -------
    between : Moments
        What was found by halving.
    left : Ends
        Of intervals that are too short to be halved, and over which values change all the same.
    gaps : list of Ends
        Of intervals in which no motion was found.
    """
    at = at if np.isfinite(at.states).all() else at.of(_known(at))
    inserted, gaps, ranges = at.of(np.zeros(0, dtype=np.intp)), list[Ends](), rows.ranges(at.states)
    left, right = at.of(slice(-1)), at.of(slice(1, None))
    for each in passages:
        regular = (right.t <= each.before) | (left.t >= each.after)
        left, right = left.of(regular), right.of(regular)
    least = np.where(ranges > 0.0, share * ranges, np.inf)[:, None]
    for _ in range(BISECTIONS):
        missed = rows.missed(left.states, right.states, right.t - left.t)
        kept = np.flatnonzero((missed > least).any(axis=0))
        if len(kept):
            kept = kept[np.argsort(-(missed[:, kept] / least).max(axis=0), kind="stable")[:_MOST]]
        left, right = left.of(kept), right.of(kept)
        if not len(kept) or (right.t - left.t).max() <= ROUND_OFF * max(np.ptp(at.t), float(np.abs(at.t).max())):
            break
        t = left.t + LESS_THAN_HALF * (right.t - left.t)
        middle = Moments(t, beside(left.t, left.states, t))
        found = _known(middle)
        gaps += [(left.of(k), right.of(k)) for k in np.flatnonzero(~found)[:, None]]
        left, middle, right = left.of(found), middle.of(found), right.of(found)
        inserted = inserted.and_then(middle)
        left, right = left.and_then(middle), middle.and_then(right)
    return inserted, (left, right), gaps


def _known(at: Moments) -> Mask:
    return np.asarray(np.isfinite(at.states).all(axis=0))


@made_once
def _highest(array: DerivativeArray) -> Rows:
    """Return the highest derivatives but one of all coordinates."""
    top = {j: order for j, order in array.unknowns if j < len(array.system.coordinates)}
    return Rows.of(array, [(j, order - 1) for j, order in top.items() if order])


def hidden_values(motion: Motion, program: Program, values: Array) -> Iterator[Finding]:
    """Find inputs and observables that go far beyond their values (channels, N) at the instants, or change their sign.

    Parameters
    ----------
    motion : Motion
        Of a flat problem.
    program : Program
        Observes the quantities.
    values : ndarray, shape (channels, N)
        At the instants of the motion.
    """
    between, passing = _looked_at(motion)
    if not len(between.t):
        return
    inside = along_path(motion.problem, program.observe, between.t, between.states)[0]
    system, hidden = motion.problem.system, list[tuple[float, Quantity, str]]()
    watched = {*system.inputs, *system.observables}
    for k, quantity in enumerate(program.channels):
        if quantity not in watched or quantity.unit == "rad":
            continue
        name, unit, peak = quantity.name, quantity.unit, float(np.abs(values[k]).max())
        row, size = np.nan_to_num(inside[k], nan=np.inf), max(peak, ROUND_OFF * quantity.magnitude)
        worst, lowest = (
            (each, f"at t = {between.t[each]:.9g} s {name} is {row[each]:.4g} {unit}")
            for each in (int(np.abs(row).argmax()), int(row.argmin()))
        )
        if quantity.positive and not row[lowest[0]] > 0.0:
            yield Finding(f"between two instants, {lowest[1]}, {quantity.wrong_sign}", error=IntegrationFailed)
        if abs(row[worst[0]]) > _TIMES * size:
            if passing[worst[0]]:
                what = f"{name} has a pole between two instants: {worst[1]}, and no more than {peak:.4g} {unit} at all"
                yield Finding(f"{what} instants", error=IntegrationFailed)
            said = f"{worst[1]}, at the instants at most {peak:.4g} {unit}"
            hidden.append((abs(row[worst[0]]) / size, quantity, said))
    if hidden:
        _, worst_quantity, said = max(hidden, key=lambda each: each[0])
        others = ", ".join(quantity.name for _, quantity, _ in hidden if quantity is not worst_quantity)
        so_do = f"; so do {others} grow" if others else ""
        said = f"the path passes close to a pole: {said}{so_do}; limits by name refuse such a path"
        yield Finding(said, warns=True)


def _looked_at(motion: Motion) -> tuple[Moments, Mask]:
    """Return moments between the instants, and which of them are beside singularities that are passed."""
    some = Moments(some_of(motion.t), some_of(motion.states))
    between, *_ = look(motion.beside, some, _highest(motion.problem.array), DISAGREEMENT, motion.passages)
    inside = [each for each in motion.passages if each.before < each.after]
    if not inside:
        return between, np.zeros(len(between.t), dtype=bool)
    t = np.array([each.time + side * (each.after - each.before) for each in inside for side in (-_NEAR, _NEAR)])
    near = np.searchsorted(motion.t, [each.before for each in inside]).repeat(2)
    beside = Moments(t, motion.beside(motion.t[near], motion.states[:, near], t))
    return between.and_then(beside), np.arange(len(between.t) + len(t)) >= len(between.t)


# Angles ---------------------------------------------------------------------------------------------------------------

_QUARTER_TURN = np.pi / 2


def continuous_angles(motion: Motion, program: Program, values: Array) -> None:
    """Make the angles among observed values (channels, N) continuous, in place, however far they turn between instants.

    An inversion determines angles up to full turns, at each instant independently. Where an angle turns by more than a
    quarter turn from one to the next, instants in between are solved.

    Raises
    ------
    IntegrationFailed
        If the angle cannot be followed: the path comes too close to a configuration at which it is undefined.
    """
    for k, channel in enumerate(program.channels):
        if not channel.wraps or (np.abs(np.diff(values[k])) < _QUARTER_TURN).all():
            continue
        unclear = ~(np.abs(np.diff(np.unwrap(values[k]))) < _QUARTER_TURN)
        # A branch that is followed may pass places where angles are not defined.
        clear = motion.problem.follow_branch or not unclear.any()
        values[k] = np.unwrap(values[k]) if clear else _followed(motion, program, k, values[k], unclear)


def _followed(motion: Motion, program: Program, channel: int, angle: Array, unclear: Mask) -> Array:
    """Return a continuous angle (N,) at the instants of a motion, from exact inversions within unclear intervals."""
    at = Moments(motion.t, np.vstack([motion.states, angle]))
    for _ in range(BISECTIONS):
        places = np.flatnonzero(unclear)
        if not len(places):
            return np.asarray(np.unwrap(at.states[-1])[np.searchsorted(at.t, motion.t)])
        left = at.of(places)
        t = (left.t + at.t[places + 1]) / 2.0
        states = motion.beside(left.t, left.states[:-1], t)
        if not np.isfinite(states).all():
            break
        found = along_path(motion.problem, program.observe, t, states)[0][channel]
        at = at.and_then(Moments(t, np.vstack([states, found])))
        at = at.of(np.argsort(at.t))
        new = np.isin(at.t, t)
        unclear = (new[1:] | new[:-1]) & ~(np.abs(wrapped_angle(np.diff(at.states[-1]))) < _QUARTER_TURN)
    k = int(unclear.argmax())
    begin = int(np.searchsorted(motion.t, at.t[k], side="right")) - 1
    raise IntegrationFailed(
        f"{program.name}: {program.channels[channel].name} cannot be followed from t = {motion.t[begin]:.6g} s to"
        f" {motion.t[begin + 1]:.6g} s, near t = {(at.t[k] + at.t[k + 1]) / 2.0:.9g} s it turns by more than a quarter"
        f" turn within {at.t[k + 1] - at.t[k]:.2g} s"
    )


@made_once
def _periodic_coordinates(resolved: ResolvedSystem) -> tuple[str, ...]:
    """Return the angles among the coordinates, reported as they are, of which an equation is a periodic function.

    Decided by numbers, at a point without symmetry. Any other angle, of a wheel or of a torsion spring say, may turn as
    far as it likes.
    """
    system = resolved.system
    terms = (system.constraints, system.output, system.potential, system.mass, system.input_matrix, system.force)
    arguments = [system.q, system.v, system.p, system.time]
    evaluate = Call(ca.Function("sc_terms", arguments, [ca.densify(ca.vertcat(*map(ca.vec, terms)))]))
    point, p = np.sin(1.0 + np.arange(len(system.coordinates))), system.parameters.values()
    time = np.full(system.time.numel(), 0.7)
    observed = {quantity.name: expression for quantity, expression in system.observables.items()}
    periodic = []
    for k, quantity in enumerate(system.coordinates.quantities):
        if quantity.unit != "rad" or not ca.is_equal(observed.get(quantity.name, system.q[k]), system.q[k]):
            continue
        aside = np.arange(len(point)) == k
        here, there, round_again = (evaluate(point + turn * aside, point, p, time)[0] for turn in (0.0, 1.0, 2 * np.pi))
        scale = ROUND_OFF * np.maximum(np.abs(here), np.abs(there))
        if ((np.abs(round_again - here) <= scale) & (np.abs(there - here) > scale)).any():
            periodic.append(quantity.name)
    return tuple(periodic)


def require_less_than_half_a_turn(problem: Problem, program: Program, t: Array, values: Array) -> None:
    """Raise `IntegrationFailed` if an angle that some equation knows up to full turns only turns too far in a step.

    A step of half a turn cannot be distinguished from one the other way round.
    """
    names = [channel.name for channel in program.channels]
    for name in _periodic_coordinates(problem.resolved):
        turns = np.abs(np.diff(values[:, names.index(name)]))
        if not (turns < np.pi).all():
            k = int((~(turns < np.pi)).argmax())
            cure = "a smaller step is needed"
            if not program.smaller_steps_help:
                cure = "another form is needed, such as Reduced()"
            raise IntegrationFailed(
                f"{program.name}: {name} turns by {turns[k]:.4g} rad in the step from t = {t[k]:.6g} s to"
                f" {t[k + 1]:.6g} s, a step resolves turns of less than pi only; {cure}"
            )
