"""What physics says of any crane and any path: turned, mirrored, reversed, in other units, with other masses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy
from problems import scene

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.references.profiles import DEGREE9

CRANE = scene("rotary_crane")
INPUTS = ("M_b", "F", "M_w")
Route = tuple[sc.Formulation, str]
Manoeuvre = tuple[Array, Array, float]
ROUTES: list[Route] = [(sc.Projected(), model) for model in ("points", "generalized", "bodies")]
ROUTES += [(sc.Reduced(), "points")]
each_route = pytest.mark.parametrize("route", ROUTES, ids=[f"{form.name}-{model}" for form, model in ROUTES])


@st.composite
def manoeuvres(draw: Callable[[SearchStrategy[Any]], Any]) -> Manoeuvre:
    """Draw start, end and duration on one side of the axis, whole centimetres."""
    ends = []
    for _ in range(2):
        radius, angle, depth = draw(st.floats(3.0, 7.0)), draw(st.floats(-0.7, 0.7)), draw(st.floats(1.5, 7.0))
        ends.append(np.round([radius * np.cos(angle), radius * np.sin(angle), -depth], 2))
    return ends[0], ends[1], round(draw(st.floats(15.0, 40.0)), 1)


def solve(
    route: Route,
    start: Sequence[float] | Array,
    end: Sequence[float] | Array,
    duration: float,
    crane: sc.Scene = CRANE,
    steps: int = 100,
) -> sc.Solution:
    formulation, model = route
    subject = crane.with_reference(sc.rest_to_rest(tuple(start), tuple(end), duration, DEGREE9))
    return sc.solve(subject, formulation, sc.BackwardEuler(), step=duration / steps, model=model)


def assert_equal(found: sc.Solution, expected: sc.Solution, factors: Mapping[str, float] | None = None) -> None:
    """Inputs agree to rounding, relative to the sizes of all three."""
    factors = factors or {}
    for name in INPUTS:
        wanted = factors.get(name, 1.0) * expected[name]
        size = max(np.abs(wanted).max(), 1e-2 * abs(factors.get("M_w", 1.0)) * np.abs(expected["M_w"]).max())
        np.testing.assert_allclose(found[name], wanted, rtol=0.0, atol=1e-7 * size)


def turned(point: Array, angle: float) -> Array:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * point[0] - sin * point[1], sin * point[0] + cos * point[1], point[2]])


@each_route
@settings(max_examples=5)
@given(manoeuvre=manoeuvres(), angle=st.floats(-3.0, 3.0))
def test_a_path_turned_about_the_axis_takes_the_same_inputs_at_a_turned_bridge(
    route: Route, manoeuvre: Manoeuvre, angle: float
) -> None:
    start, end, duration = manoeuvre
    here = solve(route, start, end, duration)
    there = solve(route, turned(start, angle), turned(end, angle), duration)
    assert_equal(there, here)
    np.testing.assert_allclose(np.angle(np.exp(1j * (there["phi"] - here["phi"] - angle))), 0.0, atol=1e-9)


@each_route
@settings(max_examples=5)
@given(manoeuvre=manoeuvres())
def test_a_mirrored_path_takes_the_opposite_slewing_torque(route: Route, manoeuvre: Manoeuvre) -> None:
    start, end, duration = manoeuvre
    mirror = np.array([1.0, -1.0, 1.0])
    here = solve(route, start, end, duration)
    there = solve(route, mirror * start, mirror * end, duration)
    assert_equal(there, here, {"M_b": -1.0})
    np.testing.assert_allclose(there["phi"], -here["phi"], atol=1e-9)


@settings(max_examples=10)
@given(manoeuvre=manoeuvres())
def test_the_way_back_takes_the_same_inputs_backwards(manoeuvre: Manoeuvre) -> None:
    """Nothing dissipates: exact inputs do not know the direction of time. Backward Euler does."""
    start, end, duration = manoeuvre
    route = (sc.Reduced(), "points")
    there, back = solve(route, start, end, duration), solve(route, end, start, duration)
    for name in INPUTS:
        np.testing.assert_allclose(back[name][::-1], there[name], atol=1e-7 * np.abs(there["M_w"]).max())


@each_route
@settings(max_examples=4)
@given(manoeuvre=manoeuvres(), length=st.floats(0.2, 5.0), time=st.floats(0.3, 3.0), mass=st.floats(0.1, 10.0))
def test_other_units_of_length_time_and_mass_change_nothing_but_numbers(
    route: Route, manoeuvre: Manoeuvre, length: float, time: float, mass: float
) -> None:
    """Forces scale like mass length/time^2, torques with one length more: also in the errors of the method."""
    start, end, duration = manoeuvre
    powers = {
        "bridge_inertia": mass * length**2, "trolley_mass": mass, "load_mass": mass, "winch_inertia": mass * length**2,
        "winch_radius": length, "gravity": length / time**2,
    }  # fmt: skip
    values = CRANE.parameter_values()
    other = CRANE.with_parameters(**{name: factor * values[name] for name, factor in powers.items()})
    here = solve(route, start, end, duration)
    there = solve(route, length * start, length * end, time * duration, other)
    force = mass * length / time**2
    assert_equal(there, here, {"M_b": force * length, "F": force, "M_w": force * length})
    np.testing.assert_allclose(there["l"], length * here["l"], rtol=1e-10)
    np.testing.assert_allclose(there["phi"], here["phi"], atol=1e-10)


@each_route
@settings(max_examples=4)
@given(manoeuvre=manoeuvres(), inertias=st.lists(st.floats(0.5, 3.0), min_size=4, max_size=4))
def test_inputs_are_linear_in_masses_and_inertias(
    route: Route, manoeuvre: Manoeuvre, inertias: tuple[float, ...]
) -> None:
    """The path fixes the motion, masses only weigh it: inputs for the sum of two cranes are the sum of the inputs."""
    start, end, duration = manoeuvre
    names = ("bridge_inertia", "trolley_mass", "load_mass", "winch_inertia")
    values = CRANE.parameter_values()
    first = {name: values[name] for name in names}
    second = {name: factor * values[name] for name, factor in zip(names, inertias, strict=True)}
    both = {name: first[name] + second[name] for name in names}
    found = [solve(route, start, end, duration, CRANE.with_parameters(**data)) for data in (first, second, both)]
    for name in INPUTS:
        size = max(np.abs(found[2][name]).max(), 1e-2 * np.abs(found[2]["M_w"]).max())
        np.testing.assert_allclose(found[0][name] + found[1][name], found[2][name], atol=1e-7 * size)


@settings(max_examples=8)
@given(manoeuvre=manoeuvres())
def test_a_bridge_without_inertia_and_trolley_without_mass_carry_the_rope_force_alone(manoeuvre: Manoeuvre) -> None:
    """In the limit M_b and F are the rope's force on the trolley, s e_phi.R and e_s.R, whatever the acceleration."""
    start, end, duration = manoeuvre
    light = CRANE.with_parameters(bridge_inertia=1e-3, trolley_mass=1e-3, winch_inertia=1e-6)
    found = solve((sc.Reduced(), "points"), start, end, duration, light)
    pull = found["tension"] / found["l"]
    cos, sin = np.cos(found["phi"]), np.sin(found["phi"])
    trolley = np.array([found["s"] * cos, found["s"] * sin])
    force = -pull * (trolley - np.array([found["x"], found["y"]]))
    np.testing.assert_allclose(found["F"], -(cos * force[0] + sin * force[1]), atol=1e-2)
    np.testing.assert_allclose(found["M_b"], -found["s"] * (cos * force[1] - sin * force[0]), atol=1e-2)
    np.testing.assert_allclose(found["M_w"], -0.1 * found["tension"], rtol=1e-5)


@each_route
def test_a_path_that_stays_where_it_is_takes_the_weight_and_nothing_else(route: Route) -> None:
    rest = solve(route, (3.0, 2.0, -4.0), (3.0, 2.0, -4.0), 10.0)
    np.testing.assert_allclose(rest["M_b"], 0.0, atol=1e-8)
    np.testing.assert_allclose(rest["F"], 0.0, atol=1e-8)
    np.testing.assert_allclose(rest["M_w"], -98.1, rtol=1e-12)
