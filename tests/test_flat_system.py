"""A scene as a flat system of python-control: its maps undo each other, and its planners get our inputs."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from outside.systems import vtol

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.references.base import Reference

SCENES = {
    "rotary crane": sc.scenes.rotary_crane(),
    "overhead crane": sc.scenes.overhead_crane(),
    "cars": sc.scenes.cars(),
    "aircraft of somebody else": vtol().scene,
}
ENDS = {
    "rotary crane": ((5.0, 0.0, -5.0), (-2.0, 2.0, -2.0)),
    "overhead crane": ((0.0, -4.0), (5.0, -3.0)),
    "cars": ((0.0,), (2.0,)),
    "aircraft of somebody else": ((0.0, 0.0), (3.0, 1.0)),
}
DURATION = 8.0
every_scene = pytest.mark.parametrize("name", SCENES)


def control() -> Any:
    """Return python-control, which takes a process that runs no test of this file too long to import."""
    pytest.importorskip("control.flatsys")
    return pytest.importorskip("control")


@cache
def flat(name: str) -> Any:
    control()
    return sc.to_control(SCENES[name])


def at_rest(name: str, place: tuple[float, ...]) -> Any:
    order = sc.Problem.of(SCENES[name]).array.reference_order
    return flat(name).reverse([[each, *[0.0] * order] for each in place])


def planned(name: str) -> Any:
    """A trajectory of python-control from rest to rest, its instants, state and inputs."""
    system = flat(name)
    ends = [each for place in ENDS[name] for each in at_rest(name, place)]
    order = sc.Problem.of(SCENES[name]).array.reference_order
    basis = control().flatsys.PolyFamily(2 * order + 2, T=DURATION)
    return control().flatsys.point_to_point(system, [0.0, DURATION], *ends, basis=basis)


@dataclass(frozen=True, kw_only=True, eq=False)
class OfBasis(Reference):
    """The path of a trajectory of python-control, by its own basis functions."""

    trajectory: Any  # python-control has no types

    def _derivatives(self, t: Array, order: int) -> Array:
        basis = self.trajectory.basis
        rows = [
            [sum(c * basis.eval_deriv(i, k, t) for i, c in enumerate(coefficients)) for k in range(order + 1)]
            for coefficients in self.trajectory.coeffs
        ]
        return np.array(rows).transpose(2, 1, 0)


def assert_inputs_of_the_inversion(name: str, trajectory: Any) -> None:
    path = OfBasis(
        start_time=0.0,
        end_time=DURATION,
        dimension=len(ENDS[name][0]),
        max_order=12,
        smoothness=12,
        trajectory=trajectory,
    )
    t = np.linspace(0.0, DURATION, 41)
    exact = sc.ExactInversion(SCENES[name].with_reference(path))(t)
    assert np.abs(trajectory.eval(t)[1].T - exact).max() <= 1e-9 * np.abs(exact).max()


@every_scene
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_state_and_inputs_come_back_from_their_flag(name: str, seed: int) -> None:
    system, draw = flat(name), np.random.default_rng(seed)
    x, u = at_rest(name, ENDS[name][0])
    x, u = x + 0.1 * draw.standard_normal(len(x)), u * (1.0 + 0.1 * draw.standard_normal(len(u)))
    found = system.reverse(system.forward(x, u))
    np.testing.assert_allclose(found[0], x, atol=1e-8)
    np.testing.assert_allclose(found[1], u, rtol=1e-8, atol=1e-8)


@every_scene
def test_a_point_to_point_plan_has_the_inputs_of_the_exact_inversion(name: str) -> None:
    assert_inputs_of_the_inversion(name, planned(name))


BASES = {
    "powers": lambda: control().flatsys.PolyFamily(12, T=DURATION),
    "Bezier": lambda: control().flatsys.BezierFamily(12, T=DURATION),
    "splines": lambda: control().flatsys.BSplineFamily([0.0, DURATION / 3, DURATION / 1.5, DURATION], degree=10),
}


@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize("name", ["rotary crane", "overhead crane", "aircraft of somebody else"])
def test_a_plan_from_motion_to_motion_in_any_basis_has_the_inputs_of_the_exact_inversion(name: str, basis: str) -> None:
    order, draw = sc.Problem.of(SCENES[name]).array.reference_order, np.random.default_rng(1)
    flags = [[[each, *(0.2 * draw.standard_normal(order))] for each in place] for place in ENDS[name]]
    ends = [each for flag in flags for each in flat(name).reverse(flag)]
    plan = control().flatsys.point_to_point(flat(name), [0.0, DURATION], *ends, basis=BASES[basis]())
    assert_inputs_of_the_inversion(name, plan)
    np.testing.assert_allclose(plan.eval([0.0, DURATION])[0].T, [ends[0], ends[2]], atol=1e-9)


@every_scene
def test_a_simulation_by_python_control_arrives_under_these_inputs(name: str) -> None:
    t = np.linspace(0.0, DURATION, 401)
    state, inputs = planned(name).eval(t)
    tight = {"rtol": 1e-9, "atol": 1e-9}
    found = control().input_output_response(flat(name), t, inputs, state[:, 0], solve_ivp_kwargs=tight)
    off = np.abs(np.atleast_2d(found.outputs)[:, -1] - ENDS[name][1]).max()
    assert off <= 1e-2 * np.ptp(ENDS[name], axis=0).max()  # inputs are linear between the instants


@pytest.mark.parametrize("name", ["rotary crane", "aircraft of somebody else"])
def test_an_optimal_plan_within_bounds_has_the_inputs_of_the_exact_inversion(name: str) -> None:
    system = flat(name)
    (x0, u0), (xf, uf) = (at_rest(name, place) for place in ENDS[name])
    order = sc.Problem.of(SCENES[name]).array.reference_order
    wide = 1.5 * np.maximum(np.abs(planned(name).eval(np.linspace(0.0, DURATION, 41))[1]).max(axis=1), 1.0)
    bounds = control().optimal.input_range_constraint(system, -wide, wide)
    effort = control().optimal.quadratic_cost(system, None, np.diag(wide**-2), x0=xf, u0=uf)
    at_the_end = control().optimal.quadratic_cost(system, np.eye(len(x0)), None, x0=xf)
    instants = np.linspace(0.0, DURATION, 9)
    line = [np.interp(instants, [0.0, DURATION], each) for each in zip(*ENDS[name], strict=True)]
    plan = control().flatsys.solve_flat_ocp(
        system, instants, x0, u0, effort, terminal_cost=at_the_end, trajectory_constraints=bounds,
        basis=control().flatsys.PolyFamily(order + 4, T=DURATION), initial_guess=np.array(line),
        minimize_options={"ftol": 1e-4},
    )  # fmt: skip
    assert (np.abs(plan.eval(instants)[1]) <= 1.001 * wide[:, None]).all()
    assert_inputs_of_the_inversion(name, plan)


@every_scene
def test_a_regulator_designed_by_python_control_is_stable(name: str) -> None:
    system = flat(name)
    linear = control().linearize(system, *at_rest(name, ENDS[name][0]))
    _, _, poles = control().lqr(linear, np.eye(system.nstates), np.eye(system.ninputs))
    assert poles.real.max() < 0.0


def test_names_and_parameters_are_those_of_the_scene() -> None:
    system = flat("rotary crane")
    assert system.input_labels == ["M_b", "F", "M_w"]
    assert system.state_labels[:3] == ["phi", "s", "l"]
    assert system.params["load_mass"] == 100.0
    _, u = system.reverse(system.forward(*at_rest("rotary crane", (5.0, 0.0, -5.0))), {"load_mass": 200.0})
    assert u[2] == pytest.approx(2.0 * at_rest("rotary crane", (5.0, 0.0, -5.0))[1][2])


def test_what_is_not_flat_is_refused() -> None:
    with pytest.raises(sc.InvalidModel, match="has internal dynamics"):
        sc.to_control(sc.scenes.mass_on_car())


def test_a_flag_that_is_too_short_is_refused() -> None:
    with pytest.raises(sc.InvalidSetting, match="derivatives up to order 4"):
        flat("rotary crane").reverse([[5.0], [0.0], [-5.0]])


def test_a_load_in_free_fall_has_no_state() -> None:
    with pytest.raises(sc.IntegrationFailed, match="no state belongs"):
        flat("rotary crane").reverse([[5.0, 0, 0, 0, 0], [0.0, 0, 0, 0, 0], [-5.0, 0, -9.81, 0, 0]])


def test_the_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(sc.InvalidSetting, match=r"pip install '\.\[control\]'"):
        sc.to_control(SCENES["cars"])
