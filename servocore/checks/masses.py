"""Masses that become negative along a motion."""

from __future__ import annotations

import casadi as ca
import numpy as np

from servocore.checks.branches import configurations
from servocore.errors import InvalidModel
from servocore.numerics.compiled_calls import Call
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.solution import Solution

_INSTANTS = 9
_ROUND_OFF = 1e-9  # of the largest eigenvalue


def require_positive_mass(problem: Problem, solution: Solution) -> None:
    """Raise `InvalidModel` if a mass matrix that depends on the configuration has a negative eigenvalue on the way.

    A constant one is looked at when the system is made.
    """
    evaluate = _compiled_mass(problem.resolved)
    q = configurations(problem, solution) if evaluate is not None else None
    if evaluate is None or q is None:
        return
    n = q.shape[1]
    for k in np.unique(np.linspace(0, len(q) - 1, _INSTANTS).round().astype(int)):
        eigenvalues = np.linalg.eigvalsh(evaluate(q[k], problem.p)[0].reshape(n, n))
        if eigenvalues[0] < -_ROUND_OFF * np.abs(eigenvalues).max():
            raise InvalidModel(
                f"{problem.system.name}: at t = {solution.t[k]:.6g} s the mass matrix has the negative eigenvalue"
                f" {eigenvalues[0]:.4g}; no mechanism has negative mass"
            )


@made_once
def _compiled_mass(resolved: ResolvedSystem) -> Call | None:
    system = resolved.system
    if not ca.depends_on(system.mass, system.q):
        return None
    return Call(ca.Function("sc_mass", [system.q, system.p], [ca.densify(system.mass)]))
