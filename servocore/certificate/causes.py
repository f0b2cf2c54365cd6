"""Whether there is one motion on one branch, and why it is not proved on an interval, in words."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from servocore.certificate.chebyshev import arithmetic, model_of
from servocore.certificate.equations import block_signs, equations_of, given_models, radii
from servocore.certificate.proof import REACH, PartialProof, Proof, smallest_peaks
from servocore.certificate.statements import (
    DEFINITE,
    Claim,
    Statement,
    claims_of,
    known,
    reported_name,
    stated,
    walk_of_limits,
)
from servocore.numerics.compiled_calls import Array, Mask, Places
from servocore.solution import Solution
from servocore.stepping.exact_evaluation import unknowns_near
from servocore.structure.derivative_array import DerivativeArray

_MOTION, _BRANCH, _SMOOTH = (
    "one motion, regular at all times", "one branch from the beginning to the end", "path smooth enough for the motion"
)  # fmt: skip
_SMALL = 2e-2  # of its peak: a quantity that comes to its bound
_NEAR, _SHORT = 0.05, 1e-2  # of the duration
_PARTS = 20  # of a step that is proved by itself
_TIMES, _NONE = 10.0, 1e-6  # times the change that rates explain; of a peak: less is no jump


def motion_statements(proof: Proof, solution: Solution | None) -> list[Statement]:
    """State that there is one motion on one branch, regular at all times, and as smooth as motions are."""
    failing = [] if proof.proved.all() else [_impulse(proof) or _singular(proof, solution) or _undecided(proof)]
    for time, joint in zip(proof.end.tolist(), proof.joints, strict=False):
        if joint in {"apart", "not proved"}:
            text = f"not decided at t = {time:.6g} s that the motion goes on as it was before"
            failing.append(Statement(_BRANCH, "undecided", text, time))
        elif joint == "motion jumps":
            text = f"coordinates or velocities jump at t = {time:.6g} s: the path is too rough there"
            failing.append(Statement(_SMOOTH, "refuted", text, time))
    found = {what: Statement(what, "proved") for what in (_MOTION, _BRANCH, _SMOOTH)}
    return list((found | {each.what: each for each in reversed(failing)}).values())


def jumps_of(proof: Proof) -> tuple[float, ...]:
    """Return the times in s at which inputs alone jump: at joints of the path, and where equations switch."""
    path, edges = proof.problem.reference, np.flatnonzero(np.diff(proof.jumping, prepend=False, append=False))
    middles = (proof.begin[edges[::2]] + proof.end[edges[1::2] - 1]) / 2.0
    joints = proof.end[:-1][np.equal(proof.joints, "inputs jump")]
    return tuple(sorted([*joints.tolist(), *np.clip(middles, path.start_time, path.end_time).tolist()]))


def _impulse(proof: Proof) -> Statement | None:
    """State the first coordinate or velocity that jumps where equations with kinks or jumps switch.

    That is across short intervals without a proof between two with one. A jump is many times the change that the rates
    at both ends could explain.
    """
    array, settled = proof.equations.array, np.flatnonzero(proof.proved | ~proof.within)
    known, place = proof.solved, {unknown: k for k, unknown in enumerate(array.unknowns)}
    early, late = (each[0] for each in proof.ring.ends(proof.x))
    for a, b in pairwise([] if proof.boxed else settled.tolist()):
        gap = proof.begin[b] - proof.end[a]
        explicable = not (proof.switches[a + 1] and known[[a, a + 1, b]].all())
        if explicable or not 0.0 < gap < _SHORT * proof.problem.reference.duration:
            continue
        left, right = late[:, a], early[:, b]
        for k in proof.equations.motion:
            j, derivative = array.unknowns[k]
            rate = place[j, derivative + 1]
            explained = _TIMES * gap * max(abs(left[rate]), abs(right[rate]))
            if abs(right[k] - left[k]) > explained + _NONE * proof.peaks[k, 0]:
                what = "the velocity of " * derivative + array.names[j].removeprefix("q.")
                text = f"at t = {proof.end[a]:.6g} s {what} would have to jump from {left[k]:.4g} to {right[k]:.4g}"
                text += ": the equations have a kink or a jump there"
                return Statement(_MOTION, "refuted", text, float(proof.end[a]))
    return None


def _singular(proof: Proof, solution: Solution | None) -> Statement | None:
    """State between which instants of a solution no regular motion goes on: it passes a singular configuration.

    At each instant the one regular motion near the solution is proved: its ball and the coordinates and inputs of the
    solution are where that is the only one. Along a continuous motion the determinant of a block changes its sign only
    where the block is singular. Nothing follows where equations switch, or across joints of a path that is too rough.
    A scene that follows its branch may pass singular configurations: it is not refuted by them.
    """
    problem, ring = proof.problem, arithmetic((0,))
    path, array = problem.reference, problem.array
    if solution is None or proof.boxed or problem.follow_branch or not problem.flat:
        return None
    t, x, equations = solution.t, unknowns_near(problem, solution, solution.t), equations_of(problem.resolved, False)
    peaks = np.fmax(np.fmax.reduce(np.abs(x), axis=1), smallest_peaks(problem, array.unknowns))[:, None]
    given, D = given_models(problem, array, ring, np.stack([t, t]), {}), np.tile(REACH * peaks, len(t))
    rho, *_ = radii(equations, ring, x[None], given, D, peaks)
    near = (rho <= D)[equations.curved].all(axis=0) & np.isfinite(rho).all(axis=0)
    near &= _meets(array, solution, np.arange(len(t)), x, D)
    t, balls = t[near], np.concatenate([model_of(x[None], rho), given], axis=1)[..., near]
    if not len(t) or equations.steps(ring, balls).shape[1]:
        return None
    pieces = np.searchsorted(path.joints, t, side="right") * (path.smoothness < array.reference_order)
    for block, signs in enumerate(block_signs(equations, equations.jacobian(ring, balls))):
        for a, b in pairwise(np.flatnonzero(signs).tolist()):
            if signs[a] != signs[b] and pieces[a] == pieces[b]:
                text = f"the solution is singular between t = {t[a]:.6g} s and {t[b]:.6g} s, where a determinant"
                text += f" changes its sign, in the equations of {equations.around(block)}"
                return Statement(_MOTION, "refuted", text, float(t[a]))
    return None


def _meets(array: DerivativeArray, solution: Solution, at: Places, x: Array, D: Array) -> Mask:
    """Return at which instants of a solution, by number, what it reports of the unknowns is within D of x (size, N)."""
    meets = np.ones(len(at), dtype=bool)
    for k, unknown in enumerate(array.unknowns):
        if (name := reported_name(array, unknown)) in solution:
            meets &= np.abs(solution[name][at] - x[k]) <= D[k]
    return meets


def hidden(proof: Proof, solution: Solution, spikes: Sequence[Claim]) -> list[Statement]:
    """Refute that an input is nowhere far beyond its values at instants, in the step where its answers are largest.

    What it depends on is proved there alone, from the instant before, where it meets what the solution reports.
    """
    problem, t, found = proof.problem, solution.t, list[Statement]()
    times = proof.ring.values(proof.given[:, -1:])  # the last of what is given is the time
    rows = zip(proof.equations.inputs, problem.array.inputs, spikes, strict=False)  # no spikes for a box
    for own, unknown, claim in rows:
        values = np.nan_to_num(np.abs(proof.ring.values(proof.x[:, [own]])))
        step = np.clip(np.searchsorted(t, [times.flat[values.argmax()]], side="right") - 1, 0, len(t) - 2)
        grid = np.linspace(t[step[0]], t[step[0] + 1], _PARTS + 1)
        part = PartialProof(problem, unknown, proof.tolerance, grid)
        (early,), _ = part.ring.ends(part.x)
        if _meets(part.equations.array, solution, step, early[:, :1], part.D[:, :1]).all():
            found += [each for each in stated(part, [claim]) if each.verdict == "refuted"]
    return found


def _undecided(proof: Proof) -> Statement:
    """State on which interval the motion is not proved, in which equations, and why.

    Without a cause on the first interval an interval without a solution explains more: where not even the beginning is
    proved, the magnitudes of the unknowns are those of a singularity later on.
    """
    solved, first = proof.solved, int(proof.proved.argmin())
    if first == 0 and not solved.all() and not (solved[0] and proof.switches[0]):
        first = int(solved.argmin())
    text = f"not proved from t = {proof.begin[first]:.6g} s to {proof.end[first]:.6g} s"
    slack = _slack(proof, first)
    if not np.isfinite(proof.given[-1, :, first]).all():
        text += ": nothing bounds the derivatives of the path"
    elif not proof.tested[first]:
        text += f": {len(proof.begin)} intervals are not enough for the accuracy wanted of all inputs"
    elif not solved[first]:
        text += f": no solution of the equations was found, the path may be out of reach{slack}"
    else:
        beyond = ", and beyond it the path may be out of reach" if not solved[first : first + 2].all() else ""
        singular = f": the configuration is singular there{beyond or ', or two branches meet'}"
        kink = ": they have a kink or a jump there" if proof.switches[first] else singular
        text += f", in the equations of {proof.equations.around(max(int(proof.failed[first]), 0))}{slack or kink}"
    return Statement(_MOTION, "undecided", text, float(proof.begin[first]))


def _slack(proof: Proof, first: int) -> str:
    """Return the quantities that reach their lower bound near an interval: rope tensions, distances of the scene."""
    problem, equations = proof.problem, proof.equations
    claimed = [limit for what, limit in claims_of(problem.resolved) if what != DEFINITE]
    limits = [limit for limit in (*problem.path_limits, *claimed) if known(equations, limit)]
    near = proof.solved & (np.abs(proof.begin - proof.begin[first]) < _NEAR * problem.reference.duration)
    if not limits or not near.any():
        return ""
    models = np.concatenate([model_of(proof.x[:-1]), proof.given], axis=1)[..., near]
    values = proof.ring.values(walk_of_limits(equations, tuple(limits))(proof.ring, models))
    for k, limit in enumerate(limits):
        distance = values[:, k] - limit.bound
        if np.nanmin(distance) < _SMALL * np.nanmax(np.abs(distance)):
            return f": {limit.quantity} comes to {limit.bound:g}" + (f", {limit.reason}" if limit.reason else "")
    return ""
