"""Why a motion is not proved on an interval, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from servocore.certificate.krawczyk import blocks_of
from servocore.certificate.proof import Interval, Proof
from servocore.certificate.statements import known
from servocore.model.limits import Named

_SMALL = 2e-2  # of its peak: a quantity that comes to its bound
_NEAR = 0.05  # of the duration


def cause_of(proof: Proof, unproved: Sequence[Interval]) -> str:
    """Return a sentence on the first interval that is not proved: where, in which equations, and why.

    Where not even the beginning is proved, the magnitudes of the unknowns are those of a singularity later on: that
    explains more.
    """
    unsolved = [each for each in unproved if each.c is None or not np.isfinite(each.c).all()]
    each = (unsolved or unproved)[0] if unproved[0] is proof.intervals[0] else unproved[0]
    at = f"not proved from t = {each.begin:.6g} s to {each.end:.6g} s"
    slack, given = _slack(proof, each), proof.given([each])
    if not np.isfinite(given[1]).all():
        return f"{at}: nothing bounds the derivatives of the path"
    if each.c is None or not np.isfinite(each.c).all():
        return f"{at}: no solution of the equations was found, the path may be out of reach{slack}"
    equations, array = proof.equations, proof.equations.array
    first = blocks_of(equations).around(max(each.failed, 0))
    names = array.signature.equations.equations
    rows = dict.fromkeys(names[array.rows[k][0]] for k in first)
    where = f"{at}, in the equations of {', '.join(list(rows)[:3])}"
    x = each.c[:, :, None]
    arguments = np.concatenate([x, given[0]], axis=1), np.concatenate([np.zeros((x.shape[1], 1)), given[1]])
    kinked = not np.isfinite(equations.jacobian(proof.ring, arguments)[1]).all()
    why = (
        ": they have a kink or a jump there"
        if kinked
        else ": the configuration is singular there, or two branches meet"
    )
    return where + (slack or why)


def _slack(proof: Proof, each: Interval) -> str:
    """Return the quantities that reach their lower bound near an interval: rope tensions, distances of the scene."""
    problem, system = proof.problem, proof.problem.system
    bounded = [(q.name, 0.0, q.wrong_sign, Named(q.name)(system)) for q in system.observables if q.positive]
    bounded += [
        (limit.quantity, limit.bound, limit.reason, limit.on(system))
        for limit in problem.limits if limit.of_path and known(proof.equations, limit)
    ]  # fmt: skip
    reach = _NEAR * problem.reference.duration
    near = [
        k for k in proof.intervals if k.c is not None and np.isfinite(k.c).all() and abs(k.begin - each.begin) < reach
    ]
    if not bounded or not near:
        return ""
    walk = proof.equations.walk([expression for *_, expression in bounded])
    given = proof.given(near)
    x = np.stack([other.c for other in near if other.c is not None], axis=2)
    c, _ = walk(proof.ring, (np.concatenate([x, given[0]], axis=1), np.concatenate([0.0 * x[0], given[1]])))
    values = proof.ring.values(c)
    for k, (name, bound, reason, _) in enumerate(bounded):
        distance = values[:, k] - bound
        if np.nanmin(distance) < _SMALL * np.nanmax(np.abs(distance)):
            return f": {name} comes to {bound:g}" + (f", {reason}" if reason else "")
    return ""
