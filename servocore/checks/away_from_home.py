"""Properties of a model that are checked at its home and may fail along a motion.

Constraints that were left out as redundant, and masses that are positive.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np

from servocore.checks.findings import ROUND_OFF, Finding, told
from servocore.checks.motion import Motion
from servocore.errors import InvalidModel
from servocore.model.limits import Limit
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array, at_instants
from servocore.numerics.memoization import made_once
from servocore.problem import LEFT_OUT_HOLDS, Problem, ResolvedSystem
from servocore.references.base import survey
from servocore.stepping.exact_evaluation import along_path

_WHY = "it follows from the others where the model is at home, and was left out"
_INSTANTS = 9  # at which masses are looked at


def left_out(problem: Problem, t: Array, q: Array) -> Iterator[Finding]:
    """Find the first holonomic constraint that was left out and does not hold along a motion q, shape (n, N).

    Around home it follows from the others. A stop that is not touched there does as well, and so do two supports that
    begin to move apart.
    """
    if not problem.resolved.redundant:
        return
    values, shares = along_path(problem, _compiled_left_out(problem.resolved), t, q)
    broken = np.abs(shares) > LEFT_OUT_HOLDS
    if broken.any():
        row, k = (int(place) for place in np.argwhere(broken.T)[0][::-1])
        what = f"the holonomic constraint {_names(problem)[row]} does not hold, by {abs(values[row, k]):.3g}"
        yield Finding(what, float(t[k]), _WHY, error=InvalidModel)


def require_redundant_constraints(problem: Problem, motion: Motion) -> None:
    """Raise `InvalidModel` if a constraint that was left out does not hold along the path of a problem."""
    if problem.resolved.redundant:
        t = survey(problem.reference)
        places = problem.array.places((k, 0) for k in range(len(problem.system.coordinates)))
        told(problem.system.name, "", left_out(problem, t, motion.at(t)[places]))


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


def negative_masses(problem: Problem, t: Array, q: Array) -> Iterator[Finding]:
    """Find the first instant at which a mass matrix that depends on the configuration has a negative eigenvalue.

    A constant one is checked when the system is made.
    """
    function = _compiled_mass(problem.resolved)
    if function is None:
        return
    few = np.unique(np.linspace(0, len(t) - 1, _INSTANTS).round().astype(int))
    t, q, jets = t[few], q[:, few], np.zeros((len(few), 1, 1))
    masses = at_instants(function, q, jets=jets, p=problem.p)[0].reshape(len(q), len(q), -1, order="F")
    eigenvalues = np.linalg.eigvalsh(np.nan_to_num(np.moveaxis(masses, 2, 0)))
    negative = np.flatnonzero(eigenvalues[:, 0] < -ROUND_OFF * np.abs(eigenvalues).max(axis=1))
    if len(negative):
        k = int(negative[0])
        what = f"the mass matrix has the negative eigenvalue {eigenvalues[k, 0]:.4g}"
        yield Finding(what, float(t[k]), advice="no mechanism has negative mass", error=InvalidModel)


@made_once
def _compiled_mass(resolved: ResolvedSystem) -> ca.Function | None:
    """Compile (q, nothing of the path, p) -> mass matrix; None if it is constant."""
    system = resolved.system
    if not ca.depends_on(system.mass, system.q):
        return None
    return ca.Function("sc_mass", [system.q, ca.SX.sym("none", 1), system.p], [ca.vec(ca.densify(system.mass))])
