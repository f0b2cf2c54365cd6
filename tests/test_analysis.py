"""The analysis says before a run what a run will find: index, internal dynamics, singular points, and what to do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from functools import cache, partial

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import actuated_chain, driven_pendulum, redundant_pendulum
from thinned import thinned

import servocore as sc
from servocore.checks.before_run import ADVICE
from servocore.numerics.components import condition_number
from servocore.references.rest_to_rest import RestToRest

CRANES = ("rotary_crane", "overhead_crane", "gantry_crane")
CRANE_MODELS = [(name, model) for name in CRANES for model in sc.scenes.REGISTRY[name]().models]
FLAT_SCENES = (*CRANES, "cars")
LEVEL, UNDAMPED, PUSHED = {"inclination": 0.0}, {"damping": 0.0}, {"stiffness": -5.0}


@cache
def scene(name: str) -> sc.Scene:
    return sc.scenes.REGISTRY[name]()


@cache
def mass_on_car(**changed: float) -> sc.Scene:
    return scene("mass_on_car").with_parameters(**changed)


def internal_roots(this: sc.Scene) -> np.ndarray:
    """Roots of m2 sin(alpha)^2 r^2 + d r + k = 0."""
    p = this.parameter_values()
    inertia = p["mass"] * np.sin(p["inclination"]) ** 2
    return np.roots(np.trim_zeros(np.array([inertia, p["damping"], p["stiffness"]]), "f"))


# Structure -----------------------------------------------------------------------------------------------------------


def test_the_rotary_crane_is_analysed_in_42_9_and_5_coordinates() -> None:
    crane = scene("rotary_crane")
    sizes = {model: len(crane.model(model).coordinates) for model in crane.models}
    assert sizes == {"points": 9, "generalized": 5, "bodies": 42}
    for model, size in sizes.items():
        report = sc.analyse(crane, model=model)
        assert (report.degrees_of_freedom, report.inputs, report.outputs) == (5, 3, 3)
        assert (report.classification, report.eigenvalues, report.reason) == ("flat", (), "")
        assert 1.0 <= report.condition < 1e4
        assert len(report.variable_offsets) == size + crane.model(model).lam.numel() + 3
        assert len(report.equation_offsets) == len(report.variable_offsets)


@pytest.mark.parametrize(
    "make",
    [actuated_chain, driven_pendulum, redundant_pendulum, partial(redundant_pendulum, "theta")],
    ids=["chain", "pendulum", "x of a redundant one", "its angle"],
)
def test_as_many_inputs_as_degrees_of_freedom_make_index_three(make: Callable[[], sc.MechanicalSystem]) -> None:
    report = sc.analyse(make())
    assert report.degrees_of_freedom == report.inputs
    assert (report.index, report.internal_degrees_of_freedom, report.classification) == (3, 0, "flat")


@pytest.mark.parametrize(
    ("chain", "count"),
    [*((sc.scenes.cars, n) for n in range(2, 9)), *((sc.scenes.elastic_bar, n) for n in (2, 3, 6, 12))],
)
def test_chains_of_n_masses_have_index_2n_plus_1_and_are_flat(chain: Callable[[int], sc.Scene], count: int) -> None:
    report = sc.analyse(chain(count))
    assert (report.index, report.internal_degrees_of_freedom) == (2 * count + 1, 0)
    assert dict(report.equation_offsets)["servo constraint on y"] == 2 * count
    assert report.classification == "flat"


def test_generalized_coordinates_need_a_remedy_and_redundant_ones_do_not() -> None:
    for name, model in CRANE_MODELS:
        remedy = sc.analyse(scene(name), model=model).remedy
        assert bool(remedy) == (model == "generalized")
        assert "combined with servo accelerations" in remedy or not remedy


# Internal dynamics ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["generalized", "points"])
@pytest.mark.parametrize(
    ("changed", "index", "states", "kind"),
    [
        ({}, 3, 2, "minimum phase"),
        (UNDAMPED, 3, 2, "weakly minimum phase"),
        (LEVEL, 4, 1, "minimum phase"),
        (LEVEL | UNDAMPED, 5, 0, "flat"),
        (PUSHED, 3, 2, "non-minimum phase"),
        (LEVEL | PUSHED, 4, 1, "non-minimum phase"),
    ],
)
def test_the_data_of_the_mass_on_a_car_decide_about_index_and_internal_dynamics(
    model: str, changed: dict[str, float], index: int, states: int, kind: str
) -> None:
    this = mass_on_car(**changed)
    report = sc.analyse(this, model=model)
    assert (report.index, report.internal_degrees_of_freedom, report.classification) == (index, states, kind)
    assert report.internal_states == ("q.s", "q.s'")[:states]
    assert report.advice == ADVICE[kind]
    expected = internal_roots(this) if states else np.zeros(0)
    np.testing.assert_allclose(
        np.sort_complex(np.array(report.eigenvalues)), np.sort_complex(expected), rtol=1e-9, atol=1e-12
    )


@settings(max_examples=15, deadline=None)
@given(
    stiffness=st.floats(0.5, 50.0) | st.floats(-50.0, -0.5),
    damping=st.floats(0.1, 10.0),
    inclination=st.floats(0.2, 1.5),
    mass=st.floats(0.1, 10.0),
)
def test_eigenvalues_are_those_of_the_mass_on_its_spring_for_any_data(
    stiffness: float, damping: float, inclination: float, mass: float
) -> None:
    this = mass_on_car(stiffness=stiffness, damping=damping, inclination=inclination, mass=mass)
    report = sc.analyse(this)
    expected = internal_roots(this)
    # Coefficients instead of roots: a double root is known to half the digits only.
    np.testing.assert_allclose(np.poly(report.eigenvalues), np.poly(expected), rtol=1e-9)
    assert report.classification == ("minimum phase" if stiffness > 0.0 else "non-minimum phase")
    assert [each.real for each in report.eigenvalues] == sorted(
        (each.real for each in report.eigenvalues), reverse=True
    )


def test_an_unstable_problem_is_not_stepped_forward_unless_one_insists_and_then_with_the_rate() -> None:
    this = mass_on_car(**PUSHED)
    rate = max(internal_roots(this).real)
    solution = sc.solve(this)
    assert solution.advice == f"non-minimum phase: {ADVICE['non-minimum phase']}"
    exact = this.exact(solution.t)["u"]
    np.testing.assert_allclose(solution["u"], exact, rtol=0.0, atol=1e-8 * np.abs(exact).max())
    assert solution.t[0] < this.reference.start_time  # it moves before the path does
    with pytest.warns(sc.ServocoreWarning, match=rf"non-minimum phase.* like exp\({rate:.3g} t\)"):
        forward = sc.solve(this, sc.Reduced(), sc.RadauIIA(3))
    assert np.abs(forward["u"] - this.exact(forward.t)["u"]).max() > 0.1 * np.abs(exact).max()


# Redundant constraints and singular points ---------------------------------------------------------------------------


def with_constraint(system: sc.MechanicalSystem, extra: ca.SX, at: int) -> sc.MechanicalSystem:
    rows = ca.vertsplit(system.constraints)
    constraints = ca.vertcat(*rows[:at], extra, *rows[at:])
    return replace(system, constraints=constraints, multipliers=ca.SX.sym("lam", len(rows) + 1), observables={})


@pytest.mark.parametrize(
    ("factors", "at", "named"),
    [
        ((0, 0, 0, 1), 4, "g_5"),
        ((0, 0, 0, -3), 4, "g_5"),
        ((1, 0, 0, 0), 0, "g_2"),
        ((1, -2, 0, 0.5), 4, "g_5"),
    ],
)
def test_a_redundant_constraint_is_named_and_left_out(
    factors: tuple[int, int, int, float], at: int, named: str
) -> None:
    points = scene("rotary_crane").model("points")
    doubled = with_constraint(points, ca.dot(ca.DM(factors), points.constraints), at)
    report, alone = sc.analyse(doubled), sc.analyse(points)
    assert report.remedy == f"redundant constraints left out: {named}"
    assert report.name == doubled.name
    assert (report.degrees_of_freedom, report.index, report.internal_degrees_of_freedom) == (5, 5, 0)
    assert report.classification == "flat"
    if at == 4:
        assert report.condition == pytest.approx(alone.condition)


THROUGH_AXIS = sc.rest_to_rest((3.0, 0.0, -5.0), (-3.0, 0.0, -5.0), 20.0)
HURRIED = sc.rest_to_rest((3.0, 0.0, -5.0), (3.0, 0.0, -1.0), 1.0)
ABOVE_GIRDER = sc.rest_to_rest((3.0, 0.0, -5.0), (3.0, 0.0, 1.0), 20.0)


@pytest.mark.parametrize("model", ["points", "generalized", "bodies"])
@pytest.mark.parametrize(
    ("path", "said"),
    [
        (THROUGH_AXIS, r"at t = 10 s the trolley reaches the slewing axis"),
        (HURRIED, r"at t = 0\.\d+ s the rope goes slack: g \+ z'' is -"),
        (ABOVE_GIRDER, r"at t = 1\d\.\d+ s the load"),
    ],
)
def test_solve_refuses_a_singular_path_before_it_steps_with_the_sentence_of_the_analysis(
    model: str, path: RestToRest, said: str
) -> None:
    this = scene("rotary_crane").with_reference(path)
    report = sc.analyse(this, model=model)
    assert report.classification == "singular here"
    assert report.index == 5
    assert report.condition == np.inf
    for formulation in (None, sc.Projected()):
        with pytest.raises(sc.InvalidReference, match=said) as refused:
            sc.solve(this, formulation, model=model, progress=lambda *_: pytest.fail("it stepped"))
        assert str(refused.value) == report.reason


@pytest.mark.parametrize("model", thinned(["points", "generalized", "bodies"], lambda model: model == "points"))
def test_without_limits_the_system_jacobian_shows_the_singular_point(model: str) -> None:
    unlimited = replace(scene("rotary_crane").with_reference(THROUGH_AXIS), limits=())
    report = sc.analyse(unlimited, model=model)
    assert report.classification == "singular here"
    assert report.reason.startswith(f"rotary crane, {model} is singular at t = 10 s: the system Jacobian has condition")
    with pytest.raises(sc.IntegrationFailed, match=r"is singular at t = 10 s"):
        sc.solve(unlimited, model=model)


def test_parameters_can_make_the_same_path_singular() -> None:
    report = sc.analyse(scene("overhead_crane").with_parameters(gravity=0.1))
    assert report.classification == "singular here"
    assert "the rope goes slack" in report.reason
    assert report.advice == "another path, other parameters or another model"


def test_the_condition_tells_units_from_singularity() -> None:
    assert condition_number(np.diag([1e8, 1.0, 1e-8])) < 100.0
    assert condition_number(np.array([[1e6, 1e6], [1e-6, 1e-6]])) > 1e12
    assert condition_number(np.diag([1.0, 0.0])) == np.inf
    assert condition_number(np.array([[1.0, np.nan], [0.0, 1.0]])) == np.inf


# The report ----------------------------------------------------------------------------------------------------------


def test_a_report_is_frozen_and_prints_a_page() -> None:
    report = sc.analyse(mass_on_car())
    with pytest.raises(FrozenInstanceError):
        report.index = 7  # type: ignore[misc]  # wrong on purpose
    lines = str(report).splitlines()
    assert lines[0] == "mass on car, generalized"
    assert "  index               3" in lines
    assert "  internal dynamics   2 degrees of freedom (q.s, q.s')" in lines
    assert "  classification      minimum phase" in lines
    assert "  equations           2: servo constraint on y; 0: momentum of x, momentum of s" in lines
    assert "  variables           2: q.x, q.s; 0: u.u" in lines
    assert not any(line.strip() in ("reason", "remedy") for line in lines)


def test_long_lists_of_a_printed_report_are_cut_and_the_report_keeps_them() -> None:
    report = sc.analyse(scene("rotary_crane"), model="bodies")
    assert " more" in str(report)
    assert max(map(len, str(report).splitlines())) < 400
    assert len(report.variable_offsets) == 42 + 37 + 3


# What solve makes of it ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*FLAT_SCENES, "mass_on_car"])
def test_solve_without_arguments_takes_the_reduced_form_and_says_why(name: str) -> None:
    solution = sc.solve(scene(name))
    kind = sc.analyse(scene(name)).classification
    assert solution.advice == f"{kind}: {ADVICE[kind]}"
    assert "reduced" in solution.route
    assert sc.solve(scene(name), sc.Reduced()).advice == ""


def test_a_small_coefficient_beside_a_large_one_is_not_taken_for_zero() -> None:
    """Entries of 0.1 beside one of 1e9: an absolute threshold once dropped them, and M_b was wrong without a word."""
    heavy = sc.scenes.rotary_crane().with_parameters(bridge_inertia=1e9, load_mass=1e6)
    for model in heavy.models:
        solution = sc.solve(heavy, sc.Reduced(), step=1.0, model=model)
        exact = heavy.exact(solution.t)
        for name in ("M_b", "F", "M_w"):
            peak = np.abs(exact[name]).max()
            np.testing.assert_allclose(solution[name], exact[name], rtol=0.0, atol=1e-9 * peak)


def test_a_tiny_damper_is_a_damper() -> None:
    level = sc.scenes.mass_on_car().with_parameters(inclination=0.0, damping=1e-6)
    assert (sc.analyse(level).index, sc.analyse(level).internal_degrees_of_freedom) == (4, 1)
