"""The internal dynamics of a servo constraint problem near rest: equilibrium, eigenvalues, invariant subspaces."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from servocore.numerics.calls import Call
from servocore.structure.derivative_array import DerivativeArray, compile_array_solver, first_guess
from servocore.model.symbols import Array

DAMPED = 1e-9
"""Real parts of smaller magnitude, relative to the eigenvalue, count as zero."""

_EQUILIBRIUM_ITERATIONS = 20


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Where the internal dynamics rest while the output does, and how they leave from there.

    Attributes
    ----------
    states : ndarray, shape (n_x,)
        Internal states.
    eigenvalues : tuple of complex
        Of the linearisation.
    stable, unstable : ndarray, shapes (n_s, n_x) and (n_u, n_x)
        Rows that span the left eigenspaces: `unstable @ (x - states)` = 0 on the stable manifold (to first order) and
        the other way round. Eigenvalues on the imaginary axis count as stable.
    """

    states: Array
    eigenvalues: tuple[complex, ...]
    stable: Array
    unstable: Array


def internal_eigenvalues(array: DerivativeArray, p: Array) -> tuple[complex, ...]:
    """Eigenvalues of the internal dynamics, linearised at their equilibrium with the output at rest at home."""
    if not array.states:
        return ()
    return internal_equilibrium(array, p, np.array(array.system.home)).eigenvalues


def internal_equilibrium(array: DerivativeArray, p: Array, output: Array) -> Equilibrium:
    """Find the equilibrium of the internal dynamics for an output at rest, by Newton's method from their guess."""
    gamma = np.zeros((len(array.system.outputs), array.reference_order + 1))
    gamma[:, 0] = output
    places = [array.unknowns.index((j, order + 1)) for j, order in array.states]
    own = [array.unknowns.index(each) for each in array.states]
    solver, sensitivity, guess_function = _linearisation(array)
    guess = np.asarray(guess_function(gamma, p)).ravel()
    A = np.zeros((len(own), len(own)))
    for _ in range(_EQUILIBRIUM_ITERATIONS):
        values = np.asarray(solver(gamma, p, guess)[0]).ravel()
        A, rate = sensitivity(values, gamma, p)[places], values[places]
        if not np.abs(rate).max() > 1e-12 or not np.isfinite(A).all():
            break
        guess = values
        guess[own] -= np.linalg.lstsq(A, rate, rcond=1e-10)[0]
    if not np.isfinite(A).all():
        unknown = np.full(len(own), np.nan)
        return Equilibrium(unknown, tuple(map(complex, unknown)), np.zeros((0, len(own))), np.zeros((0, len(own))))
    eigenvalues = tuple(complex(value) for value in sorted(np.linalg.eigvals(A), key=lambda each: -each.real))
    growing = sum(value.real > DAMPED * abs(value) for value in eigenvalues)
    return Equilibrium(
        guess[own], eigenvalues, _left_space(A, growing, stable=True), _left_space(A, growing, stable=False)
    )


def _left_space(A: Array, growing: int, *, stable: bool) -> Array:
    """Rows that span the left invariant subspace of the stable or of the unstable eigenvalues (ordered Schur form)."""
    import scipy.linalg  # noqa: PLC0415 - kept out of the run time of an FMU

    threshold = sorted(np.linalg.eigvals(A).real, reverse=True)
    limit = (
        -np.inf
        if growing == len(A)
        else (np.inf if growing == 0 else (threshold[growing - 1] + threshold[growing]) / 2)
    )

    def wanted(real: float, imaginary: float = 0.0) -> bool:  # noqa: ARG001 - the signature SciPy calls
        return real <= limit if stable else real > limit

    _, basis, count = scipy.linalg.schur(A.T, output="real", sort=wanted)
    return np.asarray(basis[:, :count].T, dtype=np.float64)


@lru_cache(maxsize=32)
def _linearisation(
    array: DerivativeArray,
) -> tuple[ca.Function, Callable[[Array, Array, Array], Array], ca.Function]:
    return compile_array_solver(array), _sensitivity(array), first_guess(array)


def _sensitivity(array: DerivativeArray) -> Callable[[Array, Array, Array], Array]:
    """Return (unknowns, gamma (m, orders), p) -> derivatives of all unknowns by the states, (unknowns, states)."""
    system = array.system
    states, rest = array.column(array.states), array.column(array.determined)
    reference = system.gamma[:, : array.reference_order + 1]
    arguments = [array.column(array.unknowns), reference, system.p]
    matrices = [ca.densify(ca.jacobian(array.residual, each)) for each in (rest, states)]
    terms = Call(ca.Function("sc_terms", arguments, matrices))
    own = [array.unknowns.index(each) for each in array.states]
    others = [array.unknowns.index(each) for each in array.determined]

    def sensitivity(values: Array, gamma: Array, p: Array) -> Array:
        by_rest, by_states = (each.reshape(len(others), -1, order="F") for each in terms(values, gamma, p))
        result = np.full((len(values), len(own)), np.nan)
        result[own] = np.eye(len(own))
        with contextlib.suppress(np.linalg.LinAlgError):
            result[others] = -np.linalg.solve(by_rest, by_states)
        return result

    return sensitivity
