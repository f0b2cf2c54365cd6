"""States of internal dynamics are chosen again where they become a bad choice."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from outside.writing import coordinates, lagrange, named, rate
from scipy.integrate import solve_ivp

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.solution import Statistics

DURATION = 2.0


@cache
def cart_with_pendulum() -> sc.MechanicalSystem:
    """A cart whose position is prescribed; the pendulum on it, x and y of its bob, swings as it likes."""
    q = coordinates("s x y")
    (s, x, y), (v_s, v_x, v_y) = ca.vertsplit(q.q), ca.vertsplit(q.v)
    return lagrange(
        "cart with pendulum",
        q,
        ca.sumsqr(q.v) / 2,
        {"position": s},
        {"u": s},
        potential=9.81 * y,
        damping=0.3 * ((v_x - v_s) ** 2 + v_y**2) / 2,
        constraints=(x - s) ** 2 + y**2 - 1,
        guess=lambda at: (at[0], at[0], -1.0),
        home=(0.0,),
    )


@cache
def scene() -> sc.Scene:
    return sc.Scene("cart", {"redundant": cart_with_pendulum}, sc.rest_to_rest((0.0,), (12.0,), DURATION))


@cache
def angle(steps: int) -> Array:
    """Angle of the pendulum from its own equation, theta'' = -g sin - s'' cos - d theta'."""
    reference = scene().reference

    def slopes(t: float, state: Array) -> list[float]:
        theta, omega = state
        return [omega, -9.81 * np.sin(theta) - reference.jet(t, 2)[2, 0] * np.cos(theta) - 0.3 * omega]

    t = np.linspace(0.0, DURATION, steps + 1)
    return np.asarray(solve_ivp(slopes, (0.0, DURATION), [0.0, 0.0], t_eval=t, rtol=1e-12, atol=1e-13).y[0])


def error(method: sc.Method, steps: int) -> tuple[Array, Statistics]:
    solution = sc.solve(scene(), sc.Reduced(), method, step=DURATION / steps)
    return np.abs(solution["x"] - solution["s"] - np.sin(angle(steps))).max(), solution.statistics


def test_the_pendulum_goes_over_the_top_so_no_single_coordinate_serves_as_state() -> None:
    assert np.degrees(np.abs(angle(200)).max()) > 360.0


@pytest.mark.parametrize(("method", "order"), [(sc.BDF(3), 3), (sc.RadauIIA(3), 5)])
def test_order_survives_every_new_choice_of_states(method: sc.Method, order: int) -> None:
    (coarse, _), (fine, statistics) = error(method, 400), error(method, 800)
    assert statistics.choices_of_states > 2
    assert np.log2(coarse / fine) > order - 0.4
    assert statistics.constraint_violation < 1e-13


def test_a_system_that_never_needs_another_choice_makes_one() -> None:
    solution = sc.solve(sc.scenes.mass_on_car(), step=0.02)
    assert solution.statistics.choices_of_states == 1


def stretching(crank: float, nominal: float) -> sc.Scene:
    """A slider-crank that starts straight, with a rod of 1e6 N/m and twice the crank's length."""
    q = sc.Coordinates(*named("a b", "rad"), *named("x"), sc.Quantity("e", "m", nominal=nominal))
    (a, b, x, e), (turn, tilt, slide, _) = ca.vertsplit(q.q), ca.vertsplit(q.v)
    rod = (2.0 * crank + e) * ca.vertcat(ca.cos(b), ca.sin(b))
    pin = crank * ca.vertcat(ca.cos(a), ca.sin(a))
    centre = rate(pin + rod / 2.0, q)
    kinetic = 0.04 * ca.sumsqr(centre) + crank**2 * (0.005 * turn**2 + 0.01 * tilt**2) + 0.02 * slide**2
    system = lagrange(
        "slider-crank", q, kinetic, {"angle": a}, {"torque": a}, potential=5e5 * e**2,
        constraints=pin + rod - ca.vertcat(x + 3.0 * crank, 0), guess=lambda _: (0.0,) * 4, home=(1.0,),
    )  # fmt: skip
    return sc.Scene("slider-crank", {"bars": lambda: system}, sc.rest_to_rest((0.0,), (5.0,), 1.0))


@pytest.mark.parametrize("crank", [0.1, 0.15])
def test_a_slider_crank_that_starts_straight_is_solved_and_moves_as_a_rigid_one(crank: float) -> None:
    """Finding: states chosen where nothing is symmetric leave the rod's length free where the linkage is straight."""
    scene, a = stretching(crank, 1.0), ca.SX.sym("a")
    b = -ca.asin(ca.sin(a) / 2.0)
    pin, rod = (r * crank * ca.vertcat(ca.cos(c), ca.sin(c)) for r, c in ((1.0, a), (2.0, b)))
    slope, slide, turn = (ca.jacobian(each, a) for each in (pin + rod / 2.0, (pin + rod)[0], b))
    inertia = 0.08 * ca.sumsqr(slope) + 0.04 * slide**2 + (0.01 + 0.02 * turn**2) * crank**2
    law = ca.Function("torque", [a], [inertia, ca.jacobian(inertia, a) / 2.0])
    solution = sc.solve(scene)
    jets = scene.reference.jet(solution.t, 2)[:, :, 0]
    exact = [float(law(q)[0]) * acceleration + float(law(q)[1]) * v**2 for q, v, acceleration in jets]
    np.testing.assert_allclose(solution["torque"], exact, atol=1e-3 * np.abs(exact).max())
    np.testing.assert_allclose(
        solution["torque"], sc.solve(stretching(crank, 1e-4))["torque"], atol=1e-12 * np.abs(exact).max()
    )
