"""The internal dynamics of a servo constraint problem near rest: equilibrium, eigenvalues, invariant subspaces."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.numerics.compiled_calls import Array, Call
from servocore.numerics.memoization import made_once
from servocore.structure.derivative_array import DerivativeArray
from servocore.structure.inversion import inversion

DAMPED = 1e-9
"""Relative real part of an eigenvalue below which it counts as zero."""

_EQUILIBRIUM_ITERATIONS = 20


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Equilibrium of the internal dynamics for an output at rest, and their linearization.

    Attributes
    ----------
    states : ndarray, shape (n_x,)
        Internal states.
    eigenvalues : tuple of complex
        Of the linearization.
    stable, unstable : ndarray, shapes (n_s, n_x) and (n_u, n_x)
        Rows that span the left eigenspaces: `unstable @ (x - states)` = 0 on the stable manifold (to first order) and
        the other way round. Eigenvalues on the imaginary axis count as stable.
    """

    states: Array
    eigenvalues: tuple[complex, ...]
    stable: Array
    unstable: Array


def _by_states(array: DerivativeArray, values: Array, gamma: Array, p: Array) -> Array:
    """Return the derivatives of all unknowns by the states, shape (unknowns, states); NaN where singular."""
    internal, others = array.places(array.states), array.places(array.determined)
    by_rest, by_states = (term.reshape(len(others), -1, order="F") for term in _terms(array)(values, gamma, p))
    result = np.full((len(values), len(internal)), np.nan)
    result[internal] = np.eye(len(internal))
    with contextlib.suppress(np.linalg.LinAlgError):
        # Implicit function theorem: R(z(x), x) = 0 gives dz/dx = -(dR/dz)^-1 dR/dx.
        result[others] = -np.linalg.solve(by_rest, by_states)
    return result


@made_once
def _terms(array: DerivativeArray) -> Call:
    """Compile (unknowns, gamma, p) -> derivatives of the residual by the determined unknowns and by the states."""
    reference = array.system.gamma[:, : array.reference_order + 1]
    arguments = [array.column(array.unknowns), reference, array.system.p]
    wanted = array.column(array.determined), array.column(array.states)
    matrices = [ca.densify(ca.jacobian(array.residual, unknowns)) for unknowns in wanted]
    return Call(ca.Function("sc_terms", arguments, matrices))


def internal_equilibrium(array: DerivativeArray, p: Array, output: Array) -> Equilibrium:
    """Find the equilibrium of the internal dynamics for an output at rest, by Newton's method from their guess."""
    inverse = inversion(array)
    gamma = np.zeros((array.system.gamma.size1(), array.reference_order + 1))
    gamma[:, 0] = output
    rates, states = array.places((j, order + 1) for j, order in array.states), array.places(array.states)
    guess, search = np.asarray(inverse.guess(gamma, p)).ravel(), Call(inverse.search)
    A = np.zeros((len(states), len(states)))
    for _ in range(_EQUILIBRIUM_ITERATIONS):
        values = search(gamma, p, guess)[0]
        A, rate = _by_states(array, values, gamma, p)[rates], values[rates]
        if not np.abs(rate).max() > 1e-12 or not np.isfinite(A).all():
            break
        guess = values
        # Newton's method on x_dot(x) = 0. Least squares, since an integrator among the states makes A singular.
        guess[states] -= np.linalg.lstsq(A, rate, rcond=1e-10)[0]
    if not np.isfinite(A).all():
        unknown = np.full(len(states), np.nan)
        return Equilibrium(
            unknown, tuple(map(complex, unknown)), np.zeros((0, len(states))), np.zeros((0, len(states)))
        )
    eigenvalues = tuple(
        complex(value) for value in sorted(np.linalg.eigvals(A), key=lambda eigenvalue: -eigenvalue.real)
    )
    # Round-off moves undamped modes off the imaginary axis: they must not count as unstable.
    growing = sum(value.real > DAMPED * abs(value) for value in eigenvalues)
    stable, unstable = (_left_space(A, growing, stable=decays) for decays in (True, False))
    return Equilibrium(guess[states], eigenvalues, stable, unstable)


def free_modes(array: DerivativeArray, values: Array, gamma: Array, p: Array) -> tuple[Array, Array]:
    """Linearize the internal dynamics at an instant, and decompose their motion there into modes.

    A mode of eigenvalue s, whose part of the rates of the states is r, is r/s away from where it would rest: to first
    order in 1/s from the motion that the output alone drives, which is slow beside a fast mode.

    Parameters
    ----------
    array : DerivativeArray
        With internal states.
    values : ndarray, shape (unknowns,)
        They satisfy the equations.
    gamma : ndarray, shape (m, reference_order + 1)
        Of the output.
    p : ndarray
        Parameters.

    Returns
    -------
    eigenvalues : ndarray, shape (n_x,)
        In 1/s; NaN where the equations are singular.
    swings : ndarray, shape (unknowns, n_x)
        Amplitudes of the free motion in all unknowns, mode by mode; both modes of a complex pair have that of the pair.
    """
    by_states, rates = _by_states(array, values, gamma, p), array.places((j, order + 1) for j, order in array.states)
    if not np.isfinite(by_states).all():
        return np.full(len(rates), np.nan), np.zeros_like(by_states)
    eigenvalues, modes = np.linalg.eig(by_states[rates])
    # Least squares, since modes of a defective matrix are dependent. One of eigenvalue zero rests anywhere.
    parts = np.linalg.lstsq(modes, values[rates].astype(complex), rcond=None)[0]
    away = np.divide(parts, eigenvalues, out=np.zeros_like(parts), where=eigenvalues != 0.0)
    return eigenvalues, np.abs(by_states @ (modes * away)) * np.where(eigenvalues.imag, 2.0, 1.0)


def _left_space(A: Array, growing: int, *, stable: bool) -> Array:
    """Return rows that span the left invariant subspace of stable or unstable eigenvalues (ordered Schur form)."""
    import scipy.linalg  # noqa: PLC0415 - kept out of the run time of an FMU

    limits = [np.inf, *sorted(np.linalg.eigvals(A).real, reverse=True), -np.inf]
    limit = float(limits[growing] + limits[growing + 1]) / 2

    def wanted(real: float, imaginary: float = 0.0) -> bool:  # noqa: ARG001 - called by SciPy with both
        return real <= limit if stable else real > limit

    # The Schur form of A^T orders left invariant spaces without eigenvectors, which defective matrices lack.
    _, basis, count = scipy.linalg.schur(A.T, output="real", sort=wanted)
    return np.asarray(basis[:, :count].T, dtype=np.float64)
