"""Properties of a model that are checked at its home and may fail along a motion.

Constraints that were left out as redundant, and masses that are positive.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np

from servocore.checks.branches import configurations
from servocore.errors import InvalidModel
from servocore.model.limits import Limit
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array, Call, at_instants
from servocore.numerics.memoization import made_once
from servocore.problem import LEFT_OUT_HOLDS, Problem, ResolvedSystem
from servocore.references.base import survey
from servocore.solution import Solution

_WHY = "it follows from the others where the model is at home, and was left out"


def require_redundant_constraints(problem: Problem, t: Array, q: Array | None) -> None:
    """Raise `InvalidModel` if a holonomic constraint that was left out does not hold along a motion.

    Around home it follows from the others. A stop that is not touched there does as well, and so do two supports that
    begin to move apart.

    Parameters
    ----------
    problem : Problem
        The problem that was solved.
    t : ndarray, shape (N,)
        Instants.
    q : ndarray, shape (N, n), or None
        Configurations there; None where they are not known.
    """
    if q is None or not problem.resolved.redundant:
        return
    function = _compiled_left_out(problem.resolved)
    jets = problem.reference.jet(t, 0)
    values, shares = at_instants(function, q.T, jets=jets, p=problem.p)
    broken = np.abs(shares) > LEFT_OUT_HOLDS
    if broken.any():
        row, k = (int(place) for place in np.argwhere(broken.T)[0][::-1])
        raise InvalidModel(
            f"{problem.system.name}: at t = {t[k]:.6g} s the holonomic constraint {_names(problem)[row]} does not hold,"
            f" by {abs(values[row, k]):.3g}: {_WHY}"
        )


def require_redundant_constraints_along_path(problem: Problem, states: Callable[[Array], Array]) -> None:
    """Raise the same along the path, for a motion that is known at all times."""
    if problem.resolved.redundant:
        t, n = survey(problem.reference), len(problem.system.coordinates)
        require_redundant_constraints(problem, t, states(t)[problem.array.places((k, 0) for k in range(n))].T)


def with_redundant_constraints_as_limits(problem: Problem) -> Problem:
    """Return the problem with limits that refuse a motion on which a constraint that was left out does not hold.

    For exported models, which follow other paths than the one of their scene.
    """
    if not problem.resolved.redundant:
        return problem
    limits = tuple(
        Limit(
            f"the share of {name} that is left", "1",
            -LEFT_OUT_HOLDS, f"the holonomic constraint {name} does not hold, {_WHY}",
            partial(_share, problem.resolved, row), upper=LEFT_OUT_HOLDS,
        )
        for row, name in enumerate(_names(problem))
    )  # fmt: skip
    return replace(problem, limits=problem.limits + limits)


def _share(resolved: ResolvedSystem, row: int, system: MechanicalSystem) -> ca.SX:  # noqa: ARG001 - a part of the key
    return resolved.left_out_shares[row]


def _names(problem: Problem) -> list[str]:
    names, rows = problem.left_out.split(", "), problem.resolved.left_out.numel()
    return names if len(names) == rows else [problem.left_out] * rows


@made_once
def _compiled_left_out(resolved: ResolvedSystem) -> ca.Function:
    """Compile (q, path with the time, p) -> constraints left out, and how far they are from holding."""
    system = resolved.system
    results = [ca.densify(resolved.left_out), resolved.left_out_shares]
    return ca.Function("sc_left_out", [system.q, system.gamma[:, 0], system.p], results)


_INSTANTS = 9
_ROUND_OFF = 1e-9  # of the largest eigenvalue


def require_positive_mass(problem: Problem, solution: Solution) -> None:
    """Raise `InvalidModel` if a mass matrix that depends on the configuration has a negative eigenvalue on the way.

    A constant one is checked when the system is made.
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
