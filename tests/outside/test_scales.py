"""Units decide nothing: the same machine in nanometres or in kilometres has the same answer."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from outside.linkages import elastic_rod_in_two_coordinates
from outside.systems import arm
from outside.writing import lagrange, named, rate, square

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.numerics.newton import QUICK_ITERATIONS
from servocore.rotationless import Assembly, RigidBody
from servocore.scenes import jets


def cars(size: float, nominal: float | None, scaled_guess: bool) -> sc.MechanicalSystem:
    """Two cars whose spring is as stiff again as at rest when it is stretched by `size`."""
    quantities = [sc.Quantity(name, "m", nominal=nominal) for name in ("x_1", "x_2")]
    of = sc.Coordinates(*quantities)
    first, second = ca.vertsplit(of.q)
    d = second - first
    return lagrange(
        "cars",
        of,
        square(of.v) / 2,
        {"y": second},
        {"u": first},
        guess=lambda y: [y[0], y[0]] if scaled_guess else [0, 0],
        home=(0.0,),
        potential=d**2 / 2 + d**4 / (4 * size**2),
    )


def exact_force(reference: np.ndarray, size: float) -> np.ndarray:
    """d + d^3/size^2 = -y'', by Newton's method on jets, which gains digits and orders alike; u = (2 y - d)''."""
    (y,) = jets.components(reference)
    pull = -1.0 * y.d().d()
    d = pull
    for _ in range(30):
        d = d - (d + d * d * d * (1 / size**2) - pull) / (1.0 + d * d * (3 / size**2))
    return np.asarray(y.derivatives()[2] + (y - d).derivatives()[2])


@settings(max_examples=25, deadline=None)
@given(st.floats(-10.0, 6.0), st.sampled_from([None, 1.0]), st.booleans())
def test_cars_on_a_path_of_any_size_are_driven_alike(power: float, nominal: float, scaled_guess: bool) -> None:
    size = 10.0**power
    reference = sc.rest_to_rest((0.0,), (size,), 4.0)
    scene = sc.Scene("cars", {"spring": partial(cars, size, nominal, scaled_guess)}, reference)
    for form, method in ((None, None), (sc.Reduced(), sc.BackwardEuler())):
        solution = sc.solve(scene, form, method, step=0.1)
        exact = exact_force(reference.jet(solution.t, 4), size)
        assert np.abs(solution["u"] - exact).max() <= 1e-10 * np.abs(exact).max()
    t = np.linspace(0.3, 3.9, 7)
    exact = exact_force(reference.jet(t, 4), size)
    assert np.abs(sc.ExactInversion(scene)(t).ravel() - exact).max() <= 1e-10 * np.abs(exact).max()


def small_arm(size: float) -> sc.MechanicalSystem:
    """Two links of length `size` with a motor in each joint."""
    return arm((0.3, 1.2), (size, size), (1.0, 1.0), (1.1 * size, 1.0 * size))


@pytest.mark.parametrize("size", [1e-9, 1e-6, 1e6])
def test_an_arm_of_any_size_moves_alike_in_every_form(size: float) -> None:
    def torques(unit: float, form: sc.Formulation) -> Array:
        reference = sc.rest_to_rest((1.1 * unit, 1.0 * unit), (0.4 * unit, 1.5 * unit), 2.0)
        scene = sc.Scene("arm", {"links": partial(small_arm, unit)}, reference)
        found = sc.solve(scene, form, sc.RadauIIA(2), step=0.05)
        return np.array([found["T_1"], found["T_2"]]) / unit**2

    for form in (sc.Projected(), sc.Reduced()):
        expected = torques(1.0, form)
        assert np.abs(torques(size, form) - expected).max() <= 1e-9 * np.abs(expected).max()


def hanging(size: float, nominal: float) -> sc.MechanicalSystem:
    """A bead on a circle of radius `size`, in Cartesian coordinates, pushed along x."""
    of = sc.Coordinates(*(sc.Quantity(name, "m", nominal=nominal) for name in ("x", "z")))
    x, z = ca.vertsplit(of.q)
    return lagrange(
        "bead",
        of,
        square(of.v) / 2,
        {"X": x},
        {"f": x},
        guess=lambda y: [y[0], -size],
        home=(0.0,),
        constraints=(x**2 + z**2 - size**2) / 2,
    )


@pytest.mark.parametrize("size", [1e-9, 1e-5, 1.0, 1e5])
@pytest.mark.parametrize("honest", [False, True])
def test_a_constraint_is_not_redundant_because_it_is_small(size: float, honest: bool) -> None:
    """Without gravity a bead on a circle needs f = x'' + x lam with z'' + z lam = 0."""
    reference = sc.rest_to_rest((0.0,), (0.7 * size,), 2.0)
    scene = sc.Scene("bead", {"bead": partial(hanging, size, size if honest else 1.0)}, reference)
    assert scene.model().constraint_rank().rank == 1
    solution = sc.solve(scene, step=0.05)
    (x,) = jets.components(reference.jet(solution.t, 4))
    z = -1.0 * jets.sqrt(size**2 - x * x)
    exact = x.derivatives()[2] - x.value * z.derivatives()[2] / z.value
    assert np.abs(solution["f"] - exact).max() <= 1e-10 * np.abs(exact).max()


@pytest.mark.parametrize("rod", [0.3, 1.0])
@pytest.mark.parametrize("order", [("a", "stretch"), ("stretch", "a")])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_mechanism_that_does_not_reach_far_is_looked_at_nearby(rod: float, order: tuple[str, ...], sign: int) -> None:
    reference = sc.rest_to_rest((rod + 0.02,), (rod + 0.1,), 0.5)
    model = partial(elastic_rod_in_two_coordinates, rod, 1e-5, order=order, sign=sign)
    scene = sc.Scene("crank", {"elastic": model}, reference)
    report = sc.analyse(scene)
    assert (report.classification, report.index) == ("flat", 5)
    solution = sc.solve(scene)
    jet = reference.jet(solution.t, 2)
    # The spring carries the slider: the force along the rod is 2 X'' over the cosine of the rod's angle.
    slope = 0.15 * np.sin(solution["a"]) / (rod + sign * solution["stretch"])
    force = 2.0 * jet[:, 2, 0] / np.sqrt(1.0 - slope**2)
    assert np.abs(-sign * 1e7 * solution["stretch"] - force).max() <= 1e-9 * np.abs(force).max()


def test_newtons_method_stops_where_corrections_are_round_off() -> None:
    """Round-off of a rod of 0.3 m in a spring of 1e6 N/m is far more than a small part of the nominal 1e-5 m."""
    of = sc.Coordinates(sc.Quantity("a", "rad"), sc.Quantity("w", "m", nominal=1e-5))
    (a, w), masses = ca.vertsplit(of.q), ca.SX([0.01, 0.2])
    slider = 0.1 * ca.cos(a) + ca.sqrt((0.3 + w) ** 2 - (0.1 * ca.sin(a)) ** 2)
    home = 0.1 * np.cos(1.2) + np.sqrt(0.3**2 - (0.1 * np.sin(1.2)) ** 2)
    system = lagrange(
        "slider crank",
        of,
        (rate(slider, of) ** 2 + ca.dot(masses, of.v**2)) / 2,
        {"X": slider},
        {"T": a},
        guess=lambda _: [1.2, 0.0],
        home=(home,),
        potential=1e6 * w**2 / 2,
    )
    system = replace(system, inputs=named("T", "N.m"))
    scene = sc.Scene("crank", {"elastic": lambda: system}, sc.rest_to_rest((home,), (home - 0.02,), 1.0))
    statistics = sc.solve(scene, sc.Reduced(), sc.RadauIIA(3), step=0.002).statistics
    assert statistics.newton_iterations <= (QUICK_ITERATIONS + 1) * statistics.steps


def test_a_director_that_the_path_does_not_turn_is_as_large_as_one() -> None:
    """How far the path turns it comes out as the round-off of a matrix that is inverted: that is no magnitude."""
    body = Assembly(parts=(RigidBody("body", 3.0, (0.2, 0.5, 0.6)),), parameters=sc.Parameters(), gravity=(0, 0, 0))
    place = body.body("body").origin[0]
    system = body.system(
        "body",
        constraints={},
        inputs={sc.Quantity("f", "N"): place},
        outputs={sc.Quantity("X", "m"): place},
        guess=lambda y: {"body": ((y[0], 0, 0), ca.SX.eye(3))},
    )
    scene = sc.Scene("body", {"only": lambda: system}, sc.rest_to_rest((0.0,), (1.0,), 10.0))
    assert sc.Problem.of(scene).system.coordinates.nominal == (1.0,) * 12


def test_a_direction_cosine_is_as_small_as_its_change_to_either_side_of_home() -> None:
    """A trolley 4 m out leaves home by 0.1 m: inwards the cosine of its bridge loses 3.3e-4, outwards 3.0e-4."""
    small = sc.scenes.rotary_crane().with_reference(sc.rest_to_rest((4.0, 0.0, -5.0), (4.1, 0.1, -5.1), 10.0))
    assert sc.Problem.of(small).system.coordinates.nominal[0] == pytest.approx(1e-3)
