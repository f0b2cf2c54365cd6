"""Equations that hold the time, and initial values that are given: against differential equations of their own."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from outside import hanging, moving, timed
from outside.systems import arm
from outside.writing import coordinates, g, lagrange
from scipy.integrate import solve_ivp

import servocore as sc
from servocore.numerics.compiled_calls import Array

SWINGING = {"theta": 0.3, "theta_dot": -0.5}


def test_a_crane_on_a_ship_follows_its_path_in_every_form_that_is_stepped() -> None:
    case = timed.load_below_a_ship()
    runs = (sc.Projected(), sc.RadauIIA(3), 0.01, 1e-3), (sc.Projected(), sc.BDF(3), 0.01, 0.1)
    for formulation, method, step, tolerance in runs:
        solution = sc.solve(case.scene, formulation, method, step=step, checks=False)
        for name, exact in case.exact(solution.t, case.scene.reference).items():
            assert np.abs(solution[name] - exact).max() <= tolerance * np.abs(exact).max()
        assert solution.statistics.constraint_rate_violation < 1e-4


def test_its_inputs_drive_it_along_that_path() -> None:
    case = timed.load_below_a_ship()
    driven = sc.simulate(case.scene, sc.solve(case.scene, step=0.01))
    assert driven["tracking_error"].max() < 1e-6
    assert driven.statistics.constraint_violation < 1e-7


def test_a_pendulum_on_a_shaken_pivot_moves_as_its_own_differential_equation_says() -> None:
    scene = sc.Scene("shaken", {"pendulum": timed.shaken}, sc.rest_to_rest((0.2,), (0.5,), 1.0))
    t = np.linspace(0.0, 1.0, 101)

    def slope(time: float, s: Array) -> tuple[float, float]:
        weight = g - 0.05 * 3600.0 * np.cos(60.0 * time)
        return s[1], (weight * np.sin(s[0]) + 0.3 * np.cos(s[0])) / 0.5

    tilt, rate = 0.4, 0.7
    start = {"x": 0.5 * np.sin(tilt), "x_dot": 0.5 * rate * np.cos(tilt)}  # z and its rate follow
    found = sc.simulate(scene, lambda _: np.array([0.3]), t=t, start=start)
    exact = solve_ivp(slope, (0.0, 1.0), [tilt, rate], "DOP853", t, rtol=1e-12, atol=1e-12).y[0]
    np.testing.assert_allclose(found["x"], 0.5 * np.sin(exact), atol=2e-9)
    np.testing.assert_allclose(found["z"], 0.05 * np.cos(60.0 * t) + 0.5 * np.cos(exact), atol=2e-9)


def own_swing(scene: sc.Scene, t: np.ndarray) -> np.ndarray:
    def slope(time: float, s: Array) -> tuple[float, float]:
        x_2 = scene.reference.jet(min(time, 2.0 - 1e-15), 2)[2, 0]
        return s[1], -(g * np.sin(s[0]) + x_2 * np.cos(s[0])) / 0.7

    return np.asarray(solve_ivp(slope, (0.0, 2.0), list(SWINGING.values()), "DOP853", t, rtol=1e-12, atol=1e-12).y[0])


@pytest.mark.parametrize(
    ("formulation", "method", "step", "tolerance"),
    [
        (None, None, 0.005, 1e-10),
        (sc.Reduced(), sc.RadauIIA(3), sc.Adaptive(1e-9), 1e-9),
        (sc.Reduced(), sc.BDF(4), 0.005, 1e-6),
        (sc.Projected(), sc.RadauIIA(3), 0.005, 1e-10),
        (sc.Projected(), sc.BDF(3), 0.005, 1e-4),
    ],
    ids=str,
)
def test_a_pendulum_that_swings_already_goes_on_swinging(
    formulation: sc.Formulation | None,
    method: sc.Method | None,
    step: float | sc.Adaptive,
    tolerance: float,
) -> None:
    scene = moving.cart_with_a_pendulum().scene
    solution = sc.solve(scene, formulation, method, step=step, start=SWINGING)
    np.testing.assert_allclose(solution["theta"], own_swing(scene, solution.t), atol=tolerance)


def test_simulate_starts_where_it_is_told() -> None:
    scene = moving.cart_with_a_pendulum().scene
    solution = sc.solve(scene, start=SWINGING)
    driven = sc.simulate(scene, solution, start=SWINGING)
    np.testing.assert_allclose(driven["theta"], solution["theta"], atol=1e-6)
    assert driven["tracking_error"].max() < 1e-6


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ({"theta": 0.1}, "gives the 2 states of the internal dynamics, such as theta, theta_dot, not theta"),
        ({"phi": 0.1, "theta": 0.1}, "not phi"),
        ({"theta": 0.1, "theta_dot": float("nan")}, "theta_dot must be a finite number, not nan"),
        ({"x": 0.1, "x_dot": 0.0}, "x, x_dot cannot all be given: the path determines one of them; theta, theta_dot"),
    ],
)
def test_a_start_that_cannot_be_is_refused_by_name(start: dict[str, float], words: str) -> None:
    with pytest.raises(sc.InvalidSetting, match=words):
        sc.solve(moving.cart_with_a_pendulum().scene, start=start)


def test_what_has_no_internal_dynamics_takes_no_start() -> None:
    with pytest.raises(sc.InvalidSetting, match="no internal dynamics: its motion follows from the path"):
        sc.solve(moving.satellite().scene, start={"e_0": 1.0})


def test_a_bounded_inversion_takes_no_start() -> None:
    with pytest.raises(sc.InvalidSetting, match="determines the initial values itself"):
        sc.solve(moving.cart_pole().scene, start=SWINGING)


def test_a_simulation_refuses_a_start_at_which_the_constraints_do_not_hold() -> None:
    scene, t = hanging.boom_crane().scene, np.linspace(0.0, 1.0, 11)
    with pytest.raises(sc.InconsistentStart, match=r"with l = 1, luff = 1, x = 5, z = 5 .* g_1 cannot hold"):
        sc.simulate(scene, lambda _: np.zeros(2), t=t, start={"l": 1.0, "luff": 1.0, "x": 5.0, "z": 5.0})
    with pytest.raises(sc.InvalidSetting, match="a start gives coordinates and their rates, not swing"):
        sc.simulate(scene, lambda _: np.zeros(2), t=t, start={"swing": 1.0})


def test_a_mass_that_changes_with_time_is_refused() -> None:
    q, t = coordinates("x"), ca.SX.sym("t")
    with pytest.raises(sc.InvalidModel, match="mass must not depend on the time"):
        lagrange(
            "rocket", q, (2 - t) * q.v[0] ** 2 / 2, {"X": q["x"]}, {"F": q["x"]}, time=t, guess=lambda at: [at[0]],
            home=(0.1,),
        )  # fmt: skip


def test_a_time_that_is_no_symbol_is_refused() -> None:
    q = coordinates("x")
    with pytest.raises(sc.InvalidModel, match="the time must be one symbol"):
        lagrange(
            "car", q, q.v[0] ** 2 / 2, {"X": q["x"]}, {"F": q["x"]}, time=ca.SX(1.0), guess=lambda at: [at[0]],
            home=(0.1,),
        )  # fmt: skip


def test_a_plant_knows_no_time() -> None:
    with pytest.raises(sc.InvalidModel, match="depend on the time, which is not part of a plant's state; use simulate"):
        sc.compile_plant(timed.crane_on_a_ship())


def test_a_path_out_of_reach_is_told_of_a_system_that_knows_the_time_too() -> None:
    """Two links of 1 m reach 2 m: X^2 + 0.81 = 4 is passed on the way to X = 2.5, which is 0.657 m too far."""
    time, links = ca.SX.sym("t"), arm(lengths=(1.0, 1.0))
    pushed = replace(links, potential=ca.sin(time) * links.coordinates["a"], time=time)
    scene = sc.Scene("arm", {"links": lambda: pushed}, sc.rest_to_rest((1.0, 0.9), (2.5, 0.9), 2.0))
    with pytest.raises(sc.InvalidReference, match=r"at t = 2 s .* X = 2\.5 m by 0\.618 m and Y = .*, 0\.657 m in all"):
        sc.solve(scene)
    assert float(np.hypot(2.5, 0.9)) - 2.0 == pytest.approx(0.657, abs=5e-4)


def test_cases_of_a_sweep_are_the_solutions_where_the_time_counts() -> None:
    """The inputs depend on when the path is followed, so every case is solved by itself."""
    scene = timed.load_below_a_ship().scene
    own = scene.reference.duration
    found = sc.sweep(scene, {"duration": [own, 1.5 * own]}, instants=101)
    assert (found.failure == "").all()
    start, end = (scene.reference.jet(time, 0)[0] for time in (scene.reference.start_time, scene.reference.end_time))
    slow = scene.with_reference(sc.rest_to_rest(start, end, 1.5 * own))
    for k, each in enumerate((scene, slow)):
        solution = sc.solve(each, step=each.reference.duration / 100)
        for name in ("F", "W"):
            assert float(found[f"peak_{name}"][k]) == pytest.approx(np.abs(solution[name]).max(), rel=1e-9)


def test_what_knows_no_time_says_so() -> None:
    crane = timed.load_below_a_ship().scene.with_limits(F=10.0)
    with pytest.raises(sc.InvalidModel, match="its equations depend on time, and no duration can be found"):
        sc.shortest_duration(crane)
    with pytest.raises(sc.InvalidModel, match="depend on time, which Sundials excludes; use RadauIIA"):
        sc.solve(timed.pendulum_in_the_wind().scene, None, sc.Sundials())
    otherwise = r"cart in the wind depend on time; Reduced\(\) with a method computes the motion that starts at rest$"
    with pytest.raises(sc.InvalidModel, match=f"begins and ends at rest, but the equations of {otherwise}"):
        sc.solve(timed.pendulum_in_the_wind().scene, None, sc.StableInversion())


def test_a_coordinate_that_is_called_as_a_rate_is_told_from_it() -> None:
    q = coordinates("x s s_dot")
    x, s, other = ca.vertsplit(q.q)
    system = lagrange(
        "names", q, (3 * q.v[0] ** 2 + (q.v[0] + q.v[1]) ** 2 + q.v[2] ** 2) / 2, {"X": x}, {"F": x},
        potential=10 * (s**2 + other**2), guess=lambda at: [at[0], 0.0, 0.0], home=(0.1,),
    )  # fmt: skip
    scene = sc.Scene("names", {"only": lambda: system}, sc.rest_to_rest((0.0,), (1.0,), 2.0))
    words = "in a start s_dot is both a coordinate and the rate of s: the coordinate needs another name"
    with pytest.raises(sc.InvalidSetting, match=words):
        sc.simulate(scene, lambda _: np.zeros(1), t=np.linspace(0.0, 1.0, 11), start={"s_dot": 0.3})
    with pytest.raises(sc.InvalidSetting, match=words):
        sc.solve(scene, start={"s": 0.1, "s_dot": 0.3, "s_dot_dot": 0.0})
    found = sc.simulate(scene, lambda _: np.zeros(1), t=np.linspace(0.0, 1.0, 11), start={"s": 0.1, "s_dot_dot": 0.2})
    assert (found["s"][0], found["s_dot"][0]) == (0.1, 0.0)
