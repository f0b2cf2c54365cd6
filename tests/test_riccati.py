"""The first gains of the feedback are those of the stationary Riccati equation, at every step."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from loops import CRANE, Case, random_case
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from crane_fmu.build.feedback_law import (
    EFFORT,
    HEIGHT_TIMES_SQUARE,
    WEIGHT,
    WEIGHT_TIMES_SQUARE,
    feedback_functions,
    hanging,
)
from crane_fmu.build.flatness import flat_motion
from crane_fmu.build.sampling import sampled

LOAD = slice(2, 5)


@cache
def functions() -> dict[str, ca.Function]:
    """Return the law, a crane over a step, and the motion of its load."""
    system = CRANE.model("points")
    return {**feedback_functions(system), "sampled": sampled(hanging(system)), "flat": flat_motion()}


@pytest.mark.parametrize("h", [0.1, 0.01, 0.001, 0.0001])
@pytest.mark.parametrize("at", ["start", "end"])
def test_the_first_gains_are_those_of_scipys_stationary_solution(at: str, h: float) -> None:
    """They differ by no more than what the stationary equation leaves open where its terms are rounded."""
    random = np.random.default_rng(13)
    for case in (Case(), *(random_case(random, any_crane=True) for _ in range(4))):
        place = case.reference.jet(0.0, 0)[0]
        p = np.array([(CRANE.parameter_values() | case.crane)[name] for name in CRANE.model().parameters.names])
        A, B, *cost = regulated(at, place, p, h)
        exact, left_open = stationary(A, B, *cost)
        (gain, _), (best, inverse) = (gains(each, A, B, *cost[1:]) for each in (cost_at_start(at, place, p, h), exact))
        # dK = (R + B'MB)^-1 B' dM (A - BK), where no dM_ij is larger than the root of both its squares on the diagonal
        left = np.sqrt(left_open)
        tolerance = np.outer(np.abs(inverse @ B.T) @ left, left @ np.abs(A - B @ best))
        assert (np.abs(gain - best) <= tolerance).all(), case.name
        assert tolerance.max() < 1e-8 * np.abs(best).max()  # or it would not tell gains apart


def cost_at_start(at: str, place: np.ndarray, p: np.ndarray, h: float) -> np.ndarray:
    """Return the cost-to-go with which the feedback of a crane at rest begins."""
    x, y, z = place
    seen = np.concatenate([[np.arctan2(y, x), np.hypot(x, y), -z], np.zeros(3), place, np.zeros(3)])
    memory = functions()[f"begin_{at}"](np.concatenate([place, np.zeros(12)]), seen, p, h)
    return np.array(memory).ravel()[:100].reshape(10, 10)


def regulated(at: str, place: np.ndarray, p: np.ndarray, h: float) -> tuple[np.ndarray, ...]:
    """Return A, B, Q, R, S of z+ = A z + B w and of the cost z'Q z + w'R w + 2 z'S w of a step, for a crane at rest."""
    bridge, trolley, load, winch, radius, _ = p
    state, u = (np.array(each).ravel() for each in functions()["flat"](np.concatenate([place, np.zeros(12)]), p))
    A, first, second = map(np.array, functions()["sampled"](0, state, u, np.zeros(3), p, h))
    new, old = (second, first - second) if at == "end" else (first + second, -second)
    s = np.hypot(*state[:2])
    efforts = np.array([bridge / s + trolley * s, trolley, (load + winch / radius**2) * radius]) * EFFORT
    level, height = (min(WEIGHT, each / h**2) for each in (WEIGHT_TIMES_SQUARE, HEIGHT_TIMES_SQUARE))
    squares = np.zeros((10, 10))
    squares[LOAD, LOAD] = np.diag([level, level, height]) ** 2
    return A, A @ new + old, squares, np.diag(1 / efforts**2) + new.T @ squares @ new, squares @ new


def gains(M: np.ndarray, A: np.ndarray, B: np.ndarray, R: np.ndarray, S: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return K and (R + B'MB)^-1."""
    inverse = np.linalg.inv(R + B.T @ M @ B)
    return inverse @ (B.T @ M @ A + S.T), inverse


def stationary(
    A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray, S: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the stationary cost-to-go, and the squares of what rounding may leave open of it.

    SciPy's solution misses the equation by r and is off by e = F'e F + r, F the closed loop: it is corrected by that.
    Terms of r are products with two matrices of n rows, |r| <= 2 n eps t t'. No such r is above 2 n^2 eps diag(t^2),
    and no e above the solution for that.
    """
    n, found = len(A), solve_discrete_are(A, B, Q, R, s=S)
    K, _ = gains(found, A, B, R, S)
    closed = (A - B @ K).T
    missed = Q + A.T @ found @ A - (A.T @ found @ B + S) @ K - found
    exact = found + solve_discrete_lyapunov(closed, (missed + missed.T) / 2)
    terms = (np.abs(A.T) @ np.sqrt(np.diag(exact))) ** 2 + np.diag(Q)
    rounded = 2 * n**2 * np.finfo(float).eps * np.diag(terms)
    return exact, np.diag(solve_discrete_lyapunov(closed, rounded))
