"""Whether there is one motion on one branch, and why it is not proved on an interval, in words."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby, pairwise

import numpy as np

from servocore.certificate.chebyshev import model_of
from servocore.certificate.proof import Interval, Proof
from servocore.certificate.statements import Statement, claims_of, known, walk_of_limits

_MOTION, _BRANCH, _SMOOTH = (
    "one motion, regular at all times", "one branch from the beginning to the end", "path smooth enough for the motion"
)  # fmt: skip
_SMALL = 2e-2  # of its peak: a quantity that comes to its bound
_NEAR, _SHORT = 0.05, 1e-2  # of the duration
_TIMES, _NONE = 10.0, 1e-6  # times the change that rates explain; of a peak: less is no jump


def motion_statements(proof: Proof) -> list[Statement]:
    """State that there is one motion on one branch, regular at all times, and as smooth as motions are."""
    failing = [_cause(proof)] if proof.unproved else []
    for a, joint in zip(proof.intervals, proof.joints, strict=False):
        if joint in {"apart", "not proved"}:
            text = f"not decided at t = {a.end:.6g} s that the motion goes on as it was before"
            failing.append(Statement(_BRANCH, "undecided", text, a.end))
        elif joint == "motion jumps":
            text = f"coordinates or velocities jump at t = {a.end:.6g} s: the path is too rough there"
            failing.append(Statement(_SMOOTH, "refuted", text, a.end))
    found = {what: Statement(what, "proved") for what in (_MOTION, _BRANCH, _SMOOTH)}
    return list((found | {each.what: each for each in reversed(failing)}).values())


def _cause(proof: Proof) -> Statement:
    """Return whether a motion that is not proved everywhere is refuted, when, and why in a sentence.

    Without a cause on the first interval an interval without a solution explains more: where not even the beginning is
    proved, the magnitudes of the unknowns are those of a singularity later on.
    """
    impulse, first = next(_impulses(proof), None), proof.unproved[0]
    if impulse is not None:
        return impulse
    unsolved = [each for each in proof.unproved if not each.solved]
    if first is proof.intervals[0] and unsolved and not (first.solved and first.switches):
        first = unsolved[0]
    return Statement(_MOTION, "undecided", _sentence(proof, first), first.begin)


def jumps_of(proof: Proof) -> tuple[float, ...]:
    """Return the times in s at which inputs alone jump: at joints of the path, and where equations switch."""
    path = proof.problem.reference
    times = [each.end for each, joint in zip(proof.intervals, proof.joints, strict=False) if joint == "inputs jump"]
    for switching, run in groupby(proof.intervals, proof.jumps_within):
        first, *_, last = 2 * list(run)
        if switching:
            times.append(float(np.clip((first.begin + last.end) / 2.0, path.start_time, path.end_time)))
    return tuple(sorted(times))


def _impulses(proof: Proof) -> Iterator[Statement]:
    """Yield coordinates and velocities that jump where equations with kinks or jumps switch.

    That is across short intervals without a proof between two with one. A jump is many times the change that the rates
    at both ends could explain.
    """
    array, order = proof.equations.array, proof.intervals
    settled = [each for each in order if (each.proved or each.outside) and not proof.boxed]
    place = {unknown: k for k, unknown in enumerate(array.unknowns)}
    for a, b in pairwise(settled):
        gap, between = b.begin - a.end, order[order.index(a) + 1]
        known = between.switches and all(each.solved for each in (a, between, b))
        if not (known and 0.0 < gap < _SHORT * proof.problem.reference.duration):
            continue
        left, right = a.x[:-1].sum(axis=0), (-1.0) ** np.arange(len(b.x) - 1) @ b.x[:-1]
        for k in proof.equations.motion:
            j, derivative = array.unknowns[k]
            rate = place[j, derivative + 1]
            explained = _TIMES * gap * max(abs(left[rate]), abs(right[rate]))
            if abs(right[k] - left[k]) > explained + _NONE * proof.peaks[k]:
                what = "the velocity of " * derivative + array.names[j].removeprefix("q.")
                text = f"at t = {a.end:.6g} s {what} would have to jump from {left[k]:.4g} to {right[k]:.4g}"
                yield Statement(_MOTION, "refuted", f"{text}: the equations have a kink or a jump there", a.end)


def _sentence(proof: Proof, each: Interval) -> str:
    """Return where an interval is, in which equations it is not proved, and why."""
    at = f"not proved from t = {each.begin:.6g} s to {each.end:.6g} s"
    slack = _slack(proof, each)
    if not np.isfinite(proof.given([each])[-1]).all():
        return f"{at}: nothing bounds the derivatives of the path"
    if not each.solved:
        return f"{at}: no solution of the equations was found, the path may be out of reach{slack}"
    array = proof.equations.array
    names = array.signature.equations.equations
    rows = dict.fromkeys(names[array.rows[k][0]] for k in proof.equations.around(max(each.failed, 0)))
    where = f"{at}, in the equations of {', '.join(list(rows)[:3])}"
    singular = ": the configuration is singular there, or two branches meet"
    if not all(other.solved for other in proof.intervals[proof.intervals.index(each) :][:2]):
        singular = ": the configuration is singular there, and beyond it the path may be out of reach"
    return where + (slack or (": they have a kink or a jump there" if each.switches else singular))


def _slack(proof: Proof, each: Interval) -> str:
    """Return the quantities that reach their lower bound near an interval: rope tensions, distances of the scene."""
    problem, equations = proof.problem, proof.equations
    limits = [limit for limit in problem.limits if limit.of_path]
    limits += [claim.limit for claim in claims_of(problem.resolved) if not claim.told]
    limits = [limit for limit in limits if known(equations, limit)]
    reach = _NEAR * problem.reference.duration
    near = [k for k in proof.intervals if k.solved and abs(k.begin - each.begin) < reach]
    if not limits or not near:
        return ""
    x = model_of(np.stack([other.x[:-1] for other in near], axis=2))
    walk = walk_of_limits(equations, tuple(limits))
    values = proof.ring.values(walk(proof.ring, np.concatenate([x, proof.given(near)], axis=1)))
    for k, limit in enumerate(limits):
        distance = values[:, k] - limit.bound
        if np.nanmin(distance) < _SMALL * np.nanmax(np.abs(distance)):
            return f": {limit.quantity} comes to {limit.bound:g}" + (f", {limit.reason}" if limit.reason else "")
    return ""
