"""The system Jacobian at answers along a path: whole where a few are looked at, and part by part."""

from __future__ import annotations

import casadi as ca
import numpy as np

from servocore.numerics.compiled_calls import Array, at_instants
from servocore.numerics.components import Part
from servocore.problem import Problem, ResolvedSystem
from servocore.structure.inversion import system_jacobian, system_jacobian_entries


def system_jacobians(problem: Problem, t: Array, states: Array) -> Array:
    """Return the system Jacobians at instants, shape (N, size, size), zeros for what is not finite.

    Parameters
    ----------
    problem : Problem
        Whose derivative array they belong to.
    t : ndarray, shape (N,)
        Instants.
    states : ndarray, shape (unknowns of the array, N)
        Its unknowns there.
    """
    function, on_path = problem.resolved.once(_compiled_jacobian)
    order = problem.array.reference_order
    jets = problem.reference.jet(t, order) if on_path else np.zeros((len(t), order + 1, problem.reference.dimension))
    (rows,) = at_instants(function, states, jets=jets, p=problem.p)
    matrices: Array = np.nan_to_num(rows).reshape(len(rows), len(t), -1).transpose(1, 0, 2)
    return matrices


def _compiled_jacobian(resolved: ResolvedSystem) -> tuple[ca.Function, bool]:
    """Compile the system Jacobian, and tell whether it depends on the path: most do so by the motion alone."""
    function = resolved.once(system_jacobian)
    return function, bool(function.jac_sparsity(0, 1).nnz())


def balanced(matrices: Array) -> Array:
    """Return matrices (N, size, size) with rows and columns scaled alike at all instants.

    At a single instant scaling would hide an equation that loses all its terms there.
    """
    for axes in ((0, 2), (0, 1)):
        largest = np.abs(matrices).max(axis=axes, keepdims=True)
        matrices = matrices / np.where(largest > 0.0, largest, 1.0)
    return matrices


def jacobian_entries(problem: Problem, t: Array, states: Array) -> tuple[tuple[Part, ...], Array]:
    """Return the independent parts of the system Jacobian, and its entries (nnz, N), zeros for what is not finite."""
    function, parts = problem.resolved.once(system_jacobian_entries)
    jets = problem.reference.jet(t, problem.array.reference_order)
    return parts, np.nan_to_num(at_instants(function, states, jets=jets, p=problem.p)[0])
