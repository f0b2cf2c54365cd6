"""A pendulum held upright while its arm swings for ever: the one motion that stays bounded repeats itself."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from outside.writing import coordinates, lagrange, rate, square
from scipy.integrate import solve_bvp

import servocore as sc

MASS, LENGTH, ARM, INERTIA, GRAVITY = 0.3, 0.4, 0.25, 0.02, 9.81


@cache
def furuta() -> sc.MechanicalSystem:
    """Furuta's pendulum: a point mass on a rod that swings across a driven arm; alpha = 0 is upright."""
    q = coordinates("", "theta alpha")
    theta, alpha = ca.vertsplit(q.q)
    arm, across = (ca.vertcat(ca.cos(theta), ca.sin(theta), 0), ca.vertcat(-ca.sin(theta), ca.cos(theta), 0))
    place = ARM * arm + LENGTH * ca.sin(alpha) * across + ca.vertcat(0, 0, LENGTH * ca.cos(alpha))
    return lagrange(
        "Furuta pendulum", q, (INERTIA * q.v[0] ** 2 + MASS * square(rate(place, q))) / 2, {"Theta": theta},
        {"tau": theta}, potential=MASS * GRAVITY * place[2], guess=lambda at: (at[0], 0.0), home=(0.0,),
    )  # fmt: skip


def swinging(first: float, second: float, period: float, cycles: int = 1) -> sc.Scene:
    reference = sc.periodic((0.0,), [[0.0], [second]], [[first], [0.0]], period, cycles)
    return sc.Scene("furuta", {"pendulum": furuta}, reference)


def by_collocation(reference: sc.Reference, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """alpha and tau from Lagrange's equations, written out, by SciPy's boundary value solver."""

    def rates(time: np.ndarray, state: np.ndarray) -> np.ndarray:
        _, rate, acceleration = reference.jet(time, 2)[:, :, 0].T
        s, c = np.sin(state[0]), np.cos(state[0])
        return np.array([state[1], s * c * rate**2 + (GRAVITY * s - ARM * acceleration * c) / LENGTH])

    mesh = np.linspace(reference.start_time, reference.end_time, 201)
    found = solve_bvp(rates, lambda left, right: left - right, mesh, np.zeros((2, 201)), tol=1e-10, max_nodes=10**5)
    assert found.success
    alpha, alpha_rate = found.sol(t)
    _, rate, acceleration = reference.jet(t, 2)[:, :, 0].T
    s, c = np.sin(alpha), np.cos(alpha)
    tau = (INERTIA + MASS * (ARM**2 + (LENGTH * s) ** 2)) * acceleration
    tau += MASS * ARM * LENGTH * (c * rates(t, np.array([alpha, alpha_rate]))[1] - s * alpha_rate**2)
    return alpha, tau + 2 * MASS * LENGTH**2 * s * c * alpha_rate * rate


@settings(max_examples=8, deadline=None)
@given(st.floats(0.2, 1.2), st.floats(-0.4, 0.4), st.floats(1.2, 4.0))
def test_the_bounded_motion_of_a_periodic_path_is_periodic(first: float, second: float, period: float) -> None:
    scene = swinging(first, second, period)
    solution = sc.solve(scene, step=period / 100)
    alpha, tau = by_collocation(scene.reference, solution.t)
    assert np.abs(solution["alpha"] - alpha).max() <= 1e-8 * np.abs(alpha).max()
    assert np.abs(solution["tau"] - tau).max() <= 1e-8 * np.abs(tau).max()


def test_its_index_is_three_with_one_degree_of_freedom_of_internal_dynamics() -> None:
    report = sc.analyse(swinging(0.4, 0.0, 2.0))
    assert (report.index, report.internal_degrees_of_freedom) == (3, 2)


def test_three_periods_are_three_times_one() -> None:
    one, three = (sc.solve(swinging(0.9, 0.3, 2.0, cycles), step=0.05) for cycles in (1, 3))
    np.testing.assert_allclose(three["tau"], np.append(np.tile(one["tau"][:-1], 3), one["tau"][-1]), atol=1e-7)


def test_a_path_that_neither_rests_nor_comes_back_is_refused() -> None:
    t = np.linspace(0.3, 1.2, 40)
    cut = sc.sampled(t, np.sin(3.0 * t)[:, None])
    scene = sc.Scene("furuta", {"pendulum": furuta}, cut)
    with pytest.raises(sc.InvalidReference, match=r"moves at t = 0\.3 s and does not end as it began"):
        sc.solve(scene, None, sc.StableInversion())
