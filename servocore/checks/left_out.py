"""Constraints that were left out as redundant where a model is at home, and do not hold farther along a motion."""

from __future__ import annotations

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel
from servocore.numerics.compiled_calls import Array, at_instants
from servocore.problem import Problem, ResolvedSystem

_BROKEN = 1e-4  # of how far its gradient lets a row go: solvers keep the others better


def require_left_out(problem: Problem, t: Array, q: Array | None) -> None:
    """Raise `InvalidModel` if a holonomic constraint that was left out does not hold along a motion.

    Around home it follows from the others. A stop that is not touched there does as well, and so do two supports that
    begin to move apart.

    Parameters
    ----------
    problem : Problem
        What was solved.
    t : ndarray, shape (N,)
        Instants.
    q : ndarray, shape (N, n), or None
        Configurations there; None where they are not known.
    """
    if q is None or not problem.resolved.redundant:
        return
    function = problem.resolved.once(_compiled_left_out)
    jets = problem.reference.jet(t, 0)
    values, reach = at_instants(function, q.T, jets=jets, p=problem.p)
    broken = np.abs(values) > _BROKEN * np.maximum(reach, np.finfo(float).tiny)
    if broken.any():
        row, k = (int(place) for place in np.argwhere(broken.T)[0][::-1])
        names = problem.left_out.split(", ")
        name = names[row] if len(names) == len(values) else problem.left_out
        raise InvalidModel(
            f"{problem.system.name}: at t = {t[k]:.6g} s the holonomic constraint {name} does not hold, by"
            f" {abs(values[row, k]):.3g}: it follows from the others where the model is at home, and was left out"
        )


def _compiled_left_out(resolved: ResolvedSystem) -> ca.Function:
    """Compile (q, path with the time, p) -> constraints left out, and how much a motion as large as q changes them."""
    system = resolved.system
    nominal = ca.DM(system.coordinates.nominal)
    reach = ca.mtimes(ca.fabs(ca.jacobian(resolved.left_out, system.q)), ca.fmax(ca.fabs(system.q), nominal))
    results = [ca.densify(resolved.left_out), ca.densify(reach)]
    return ca.Function("sc_left_out", [system.q, system.gamma[:, 0], system.p], results)
