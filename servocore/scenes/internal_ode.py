"""Differential equations of internal dynamics, integrated by SciPy: the independent answer of a scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from servocore.errors import IntegrationFailed, InvalidModel
from servocore.numerics.compiled_calls import Array
from servocore.references.base import Reference

Rate = Callable[[float, Array], Array]
"""(time in s, state (n,)) -> its rate (n,)."""

Rates = Callable[[Array | float, Array], Array]
"""(times in s (N,), states (n, N)) -> their rates (n, N); or one time and state (n,)."""

_RTOL, _ATOL = 1e-13, 1e-14
_LONGEST_STEP = 1 / 100  # of the whole time, so that interpolation within a step is as accurate as the step

_STIFF = 2e4  # steps of an explicit method, about
_FADING = 32.0  # exp(-32) is round-off
_BOUNDARY_TOLERANCE = 1e-10
_UNDECIDED = 1e-12  # real parts of smaller magnitude, relative to the eigenvalue, count as zero


def _suited(rate: Rate, start: float, size: int, span: tuple[float, float]) -> Literal["DOP853", "Radau"]:
    """Return DOP853, or Radau where the fastest eigenvalue would make an explicit method crawl."""
    columns = [(rate(start, 1e-6 * unit) - rate(start, np.zeros(size))) / 1e-6 for unit in np.eye(size)]
    fastest = float(np.abs(np.linalg.eigvals(np.array(columns).T)).max(initial=0.0))
    return "Radau" if fastest * (span[1] - span[0]) > _STIFF else "DOP853"


def forward(rate: Rate, t: Array, start: float, size: int) -> Array:
    """Solve x' = rate(t, x), x = 0 until `start`, by DOP853 close to round-off.

    Parameters
    ----------
    rate : callable
        Right-hand side; it vanishes for x = 0 before `start`.
    t : ndarray, shape (N,)
        Times of the solution in s, increasing.
    start : float
        In s.
    size : int
        Number n of states.

    Returns
    -------
    ndarray, shape (n, N)

    Raises
    ------
    IntegrationFailed
        If the integrator gives up.
    """
    import scipy.integrate  # noqa: PLC0415 - kept out of the run time of an FMU

    states = np.zeros((size, len(t)))
    later = t > start
    if later.any():
        span = (start, float(t[-1]))
        solution = scipy.integrate.solve_ivp(
            rate, span, np.zeros(size), method=_suited(rate, start, size, span), t_eval=t[later],
            rtol=_RTOL, atol=_ATOL,
            max_step=(span[1] - span[0]) * _LONGEST_STEP,
        )  # fmt: skip
        _require_solved(solution.status == 0, solution.message)
        states[:, later] = solution.y
    return states


def backward(rate: Rate, t: Array, end: float, size: int) -> Array:
    """Solve x' = rate(t, x), x = 0 from `end` on, towards earlier times; otherwise as `forward`."""
    return forward(lambda reversed_time, x: -rate(-reversed_time, x), -t[::-1], -end, size)[:, ::-1]


def two_sided(rate: Rates, t: Array, start: float, end: float, matrix: Array) -> Array:
    """Solve x' = rate(t, x) for the solution that stays bounded for all times, with growing and decaying modes.

    It leaves rest before `start` along the unstable directions and returns to rest after `end` along the stable ones:
    a boundary value problem, given to SciPy's `solve_bvp`. Other arguments as in `forward`.

    Parameters
    ----------
    rate : callable
        Right-hand side for many times (N,) and states (n, N) at once; autonomous before `start` and after `end`, with
        rest at x = 0.
    t : ndarray, shape (N,)
        In s, increasing.
    start, end : float
        Between these times the path moves, in s.
    matrix : ndarray, shape (n, n)
        Jacobian of `rate` at rest, without eigenvalues on the imaginary axis.

    Returns
    -------
    ndarray, shape (n, N)

    Raises
    ------
    InvalidModel
        If an eigenvalue lies on the imaginary axis, or none in the left half plane.
    IntegrationFailed
        If the boundary value problem is not solved.
    """
    import scipy.integrate  # noqa: PLC0415 - kept out of the run time of an FMU

    values = np.linalg.eigvals(matrix)
    decided = np.abs(values.real) > _UNDECIDED * np.abs(values)
    stable, unstable = decided & (values.real < 0.0), decided & (values.real > 0.0)
    if not (decided.all() and stable.any() and unstable.any()):
        raise InvalidModel(
            "a two-sided solution needs internal dynamics with decaying and growing modes and no others; their"
            f" eigenvalues are {', '.join(f'{value:.4g}' for value in np.real_if_close(values))}"
        )
    before = start - _FADING / values[unstable].real.min()
    after = end - _FADING / values[stable].real.max()

    decaying, growing = _left_invariant(matrix, "lhp"), _left_invariant(matrix, "rhp")
    mesh = np.unique(np.concatenate([np.linspace(before, start, 100), np.linspace(start, end, 400),
                                     np.linspace(end, after, 100)]))  # fmt: skip
    solution = scipy.integrate.solve_bvp(
        rate, lambda first, last: np.concatenate([decaying @ first, growing @ last]), mesh,
        np.zeros((len(matrix), len(mesh))), tol=_BOUNDARY_TOLERANCE, max_nodes=100_000,
    )  # fmt: skip
    _require_solved(solution.status == 0, solution.message)
    return np.where((t >= before) & (t <= after), solution.sol(np.clip(t, before, after)), 0.0)


def bounded(rate: Rates, t: Array, reference: Reference, coefficients: tuple[float, float, float]) -> Array:
    """Solve x' = rate(t, x) of one coordinate and its rate for the solution that stays bounded for all times.

    Parameters
    ----------
    rate : callable
        As in `two_sided`.
    t : ndarray, shape (N,)
        In s, increasing.
    reference : Reference
        The path, whose motion begins and ends that of the right-hand side.
    coefficients : (float, float, float)
        Of acceleration, rate and coordinate at rest: of non-minimum phase where the first or the last is negative.

    Returns
    -------
    ndarray, shape (2, N)
    """
    inertia, damping, stiffness = coefficients
    if inertia > 0.0 and stiffness >= 0.0:
        return forward(rate, t, reference.start_time, 2)
    matrix = np.array([[0.0, 1.0], [-stiffness / inertia, -damping / inertia]])
    return two_sided(rate, t, reference.start_time, reference.end_time, matrix)


def _left_invariant(matrix: Array, half: Literal["lhp", "rhp"]) -> Array:
    """Rows that span the left invariant subspace of the eigenvalues in one half plane, real where those are complex."""
    import scipy.linalg  # noqa: PLC0415 - kept out of the run time of an FMU

    _, basis, size = scipy.linalg.schur(matrix.T, output="real", sort=half)
    return np.asarray(basis[:, :size].T, dtype=np.float64)


def _require_solved(solved: bool, message: str) -> None:
    if not solved:
        raise IntegrationFailed(f"the equation of the internal dynamics was not solved: {message}")
