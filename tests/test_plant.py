"""The compiled plant moves as `simulate` says and holds with its brakes on."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from problems import began

import servocore as sc
from servocore.numerics.compiled_calls import Array, call_of
from servocore.stepping.forward_dynamics import Plant

CRANE = sc.scenes.rotary_crane()
STILL = np.zeros(3)
MODELS = ("points", "generalized")


def at_rest(model: str) -> tuple[Plant, Array, Array]:
    system = CRANE.model(model)
    return sc.compile_plant(system), began(CRANE, model)[0], system.parameters.values()


def push(time: float) -> Array:
    return np.array([300.0 * np.sin(time), 20.0 * np.sin(2 * time), -98.1 + 5.0 * np.sin(time)])


def run(plant: Plant, state: Array, p: Array, step: float, until: float = 2.0) -> Array:
    for k in range(round(until / step)):
        now, then = push(k * step), push((k + 1) * step)
        state = plant.advance(state, now, (then - now) / step, STILL, p, step)
    return state


@pytest.mark.parametrize("model", MODELS)
def test_it_goes_where_simulate_goes(model: str) -> None:
    plant, state, p = at_rest(model)
    found = plant.values(run(plant, state, p, 0.001), push(2.0), STILL, p)
    path = sc.rest_to_rest((5.0, 0.0, -5.0), (5.0 + 1e-9, 0.0, -5.0), 2.0)
    wanted = sc.simulate(CRANE.with_reference(path), push, t=np.array([0.0, 2.0]), model=model)
    for name in ("x", "y", "z", "phi", "s", "l"):
        assert found[name] == pytest.approx(wanted[name][-1], abs=2e-7), name


def linear(time: float, hold: Array) -> Array:
    return hold + (0.1 * np.abs(hold) + 2.0) * np.arange(1.0, len(hold) + 1.0) * time


@pytest.mark.parametrize("name", sc.scenes.REGISTRY)
def test_it_observes_what_simulate_reports_tensions_included_in_independent_coordinates_too(name: str) -> None:
    scene, h = sc.scenes.REGISTRY[name](), 0.001
    model = scene.independent_model
    (state, hold), system = began(scene, model), scene.model(model)
    plant, p, still = sc.compile_plant(system), system.parameters.values(), np.zeros(len(system.outputs))
    slope = linear(1.0, hold) - linear(0.0, hold)
    for k in range(300):
        state = plant.advance(state, linear(k * h, hold), slope, still, p, h)
    found = plant.values(state, linear(0.3, hold), still, p)
    whole = sc.simulate(scene, lambda t: linear(t, hold), t=np.array([0.0, 0.3]), rtol=1e-11, atol=1e-11)
    observables = scene.model().observables
    assert not observables or any(abs(np.ptp(whole[each.name])) > 1e-4 for each in observables)
    for each in observables:
        assert found[each.name] == pytest.approx(whole[each.name][-1], rel=1e-7, abs=1e-8), each.name


def test_the_tension_knows_the_force_of_a_wind() -> None:
    """At rest in still air the rope bears the weight; pulled down, the pull too, with brakes and without."""
    plant, state, p = at_rest("generalized")
    for u, bears in ((None, 1.0), (np.array([0.0, 0.0, -98.1]), 1.0 / 11.0)):
        calm, pulled = (plant.values(state, u, np.array([0.0, 0.0, -pull]), p)["tension"] for pull in (0.0, 50.0))
        assert calm == pytest.approx(981.0)
        # The free winch, 10 kg at the rope beside a load of 100 kg, gives way.
        assert pulled - calm == pytest.approx(50.0 * bears)


def test_its_steps_are_of_order_four_while_the_inputs_are_linear() -> None:
    plant, state, p = at_rest("generalized")
    slope = np.array([100.0, 5.0, 1.0])

    def end(count: int) -> Array:
        now, h = state, 1.0 / count
        for k in range(count):
            now = plant.advance(now, np.array([0.0, 0.0, -98.1]) + slope * k * h, slope, STILL, p, h)
        return now

    exact = end(512)
    errors = [np.abs(end(count) - exact).max() for count in (16, 32)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.2)


@pytest.mark.parametrize("model", MODELS)
def test_brakes_hold_the_crane_while_the_load_swings(model: str) -> None:
    plant, state, p = at_rest(model)
    wind = np.array([0.0, 50.0, 0.0])
    for _ in range(200):
        state = call_of(plant.held_step)(state, wind, p, 0.005)[0]
    found = plant.values(state, None, wind, p)
    assert (found["s"], found["l"]) == pytest.approx((5.0, 5.0), abs=1e-6)
    assert found["phi"] == pytest.approx(0.0, abs=1e-9)
    assert found["y"] > 0.1


def test_what_brakes_bear_at_rest_is_the_weight() -> None:
    plant, state, p = at_rest("generalized")
    found = plant.values(state, None, STILL, p)
    assert (found["M_b"], found["F"], found["M_w"]) == pytest.approx((0.0, 0.0, -98.1), abs=1e-9)


def test_energy_is_kept_without_inputs_that_work() -> None:
    """Brakes do no work; a swinging load keeps its energy."""
    plant, state, p = at_rest("generalized")
    state[3:5] = 0.3, -0.2
    before = plant.values(state, None, STILL, p)["energy"]
    for _ in range(2000):
        state = call_of(plant.held_step)(state, STILL, p, 0.005)[0]
    assert plant.values(state, None, STILL, p)["energy"] == pytest.approx(before, abs=1e-6)


def test_a_plant_whose_constraint_forces_are_not_determined_is_refused() -> None:
    points = sc.scenes.rotary_crane().model("points")
    twice = ca.vertcat(points.constraints, 2 * points.constraints[3])
    doubled = replace(points, constraints=twice, multipliers=ca.vertcat(points.lam, ca.SX.sym("lam_again")))
    with pytest.raises(sc.InvalidModel, match=r"1 of the 5 holonomic constraints are redundant \(rank 4\): g_5"):
        sc.compile_plant(doubled)
