"""Systems that are flat, though no equation says so as it stands, and those that are not: refused with the reason."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from outside.reach_systems import (
    CHARTS,
    adjustable_flyer,
    ball_and_beam,
    hanging_rods,
    huygens_flyer,
    mixed_rods,
    rod_on_one_drive,
    swinging_rod,
)
from outside.systems import LOOP, Outsider
from outside.writing import named

import servocore as sc
from servocore.analysis import StructureReport
from servocore.model.system import reference_symbols
from servocore.numerics.step_operations import evaluate


def assert_exact(outsider: Outsider, index: int, tolerance: float = 1e-10) -> StructureReport:
    """Flat with this index, and all inputs right at all instants of a solution and at random ones."""
    report = sc.analyse(outsider.scene)
    assert (report.classification, report.index, report.internal_degrees_of_freedom) == ("flat", index, 0), str(report)
    solution, reference = sc.solve(outsider.scene), outsider.scene.reference
    for name, values in outsider.exact(solution.t).items():
        assert np.abs(solution[name] - values).max() <= tolerance * np.abs(values).max(), name
    t = np.random.default_rng(11).uniform(reference.start_time, reference.end_time, 40)
    for values, each in zip(sc.ExactInversion(outsider.scene)(t).T, outsider.scene.model().inputs, strict=True):
        exact = outsider.exact(t)[each.name]
        assert np.abs(values - exact).max() <= tolerance * np.abs(exact).max(), each.name
    return report


@pytest.mark.parametrize("chart", CHARTS)
def test_an_aircraft_tracked_at_its_huygens_point_is_flat_in_any_coordinates(chart: str) -> None:
    report = assert_exact(huygens_flyer(chart), 5)
    assert report.remedy.startswith("combined with others so that highest derivatives cancel: ")


@settings(max_examples=4, deadline=None)
@given(
    mass=st.floats(0.1, 50.0), inertia=st.floats(1e-3, 10.0), share=st.floats(0.01, 2.0), chart=st.sampled_from(CHARTS)
)
def test_it_is_flat_whatever_its_data(mass: float, inertia: float, share: float, chart: str) -> None:
    """`share` is the height of the tracked point in units of the radius of gyration."""
    assert_exact(huygens_flyer(chart, mass, inertia, share * (mass / inertia) ** 0.5), 5, 1e-9)


def test_it_may_turn_over_for_no_configuration_was_lost() -> None:
    loop = huygens_flyer("centre", path=sc.through(LOOP, duration=5.0))
    assert_exact(loop, 5)
    assert np.ptp(sc.solve(loop.scene)["theta"]) > 6.0


@pytest.mark.parametrize(
    ("count", "chart", "dimension"),
    [(1, "centre", 2), (1, "tip", 2), (2, "joints", 2), (1, "tip", 3),
     (2, "directors", 3)],
)  # fmt: skip
def test_rods_that_hang_from_a_cart_are_flat_at_the_centre_of_oscillation_of_the_last(
    count: int, chart: str, dimension: int
) -> None:
    assert_exact(hanging_rods(count, chart, dimension), 3 + 2 * count)


@pytest.mark.parametrize("chart", ["pivot", "centre", "tip"])
def test_constants_that_cancel_are_known_to_cancel(chart: str) -> None:
    """With numbers in the place of parameters J + m s^2 - m s l is 1e-17, and was once taken for an inertia."""
    assert_exact(swinging_rod(chart), 5)


def test_where_a_parameter_decides_the_point_beside_has_internal_dynamics() -> None:
    system = adjustable_flyer()
    scene = sc.Scene("flyer", {"body": lambda: system}, sc.rest_to_rest((0.3, 0.2), (2.0, 1.0), 3.0, sc.DEGREE13))
    found = [sc.analyse(scene.with_parameters(height=height)) for height in (2.0 * 0.02 / 1.5, 0.1, 0.0)]
    assert [(each.classification, each.index, each.internal_degrees_of_freedom) for each in found] == [
        ("flat", 5, 0), ("weakly minimum phase", 3, 2), ("non-minimum phase", 3, 2),
    ]  # fmt: skip
    # Linearized at hover: (h - side J / m) theta'' = -g theta.
    for report, height in zip(found[1:], (0.1, 0.0), strict=True):
        rate = np.sqrt(complex(-9.81 / (height - 2.0 * 0.02 / 1.5)))
        np.testing.assert_allclose(sorted(map(abs, report.eigenvalues)), [abs(rate)] * 2, rtol=1e-9)


# What is refused, and why ---------------------------------------------------------------------------------------------


def refusal(system: sc.MechanicalSystem, end: tuple[float, ...], solved: bool = False) -> str:
    """Return why the analysis calls a system singular; it is refused, unless steps lead away from there."""
    scene = sc.Scene(system.name, {"m": lambda: system}, sc.rest_to_rest(system.home, end, 3.0))
    report = sc.analyse(scene)
    assert report.classification == "singular here"
    with nullcontext() if solved else pytest.raises(sc.ServocoreError):
        sc.solve(scene)
    return report.reason


def test_a_ball_on_a_beam_has_no_relative_degree_at_rest() -> None:
    reason = refusal(ball_and_beam(), (0.6,))
    assert reason.startswith(
        "ball and beam has no relative degree at rest, at t = 0 s (q.r = 0.3, q.a = 0): the system Jacobian is singular"
        " there, and with velocities it is not; it loses rank in the equations"
    )


def test_a_rod_on_one_drive_has_none_while_it_hangs_straight() -> None:
    """y'' = sin(a) (sin(a) x'' - g cos(a) - l a'^2)."""
    reason = refusal(rod_on_one_drive(), (1.0,), solved=True)
    assert reason.startswith("rod on one drive has no relative degree at t = 0 s (q.x = 0.3, q.a = 0): the system")
    assert "whatever the velocities" in reason


def test_terms_that_cancel_only_where_other_equations_hold_are_out_of_reach_and_no_answer_is_given(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("servocore.checks.failure_causes._INSTANTS", 5)  # where another cause is looked for
    reason = refusal(mixed_rods(), (0.5, -0.9))
    assert "terms cancel where its combined equations hold and nowhere else" in reason


def skate(**changed: Callable[[sc.Coordinates], ca.SX]) -> sc.MechanicalSystem:
    coordinates = sc.Coordinates(*named("x z"))
    fields: dict[str, Any] = {
        "name": "skate", "coordinates": coordinates, "parameters": sc.Parameters(), "inputs": named("F"),
        "outputs": named("speed"), "mass": ca.SX.eye(2), "input_matrix": -ca.SX([[1, 0]]),
        "gamma": reference_symbols(1), "output": coordinates.q[0],
    }  # fmt: skip
    return sc.MechanicalSystem(**fields | {name: make(coordinates) for name, make in changed.items()})


def test_a_velocity_as_output_is_refused_by_name_with_the_alternative() -> None:
    with pytest.raises(sc.InvalidModel, match=r"the output speed depends on velocities \(v_x\).*integral of the path"):
        skate(output=lambda c: c.v[0] * ca.cos(c.q[1]))


def test_a_nonholonomic_constraint_is_refused_by_name_with_the_alternative() -> None:
    with pytest.raises(sc.InvalidModel, match=r"the constraint g_1 depends on velocities \(v_x, v_z\).*nonholonomic"):
        skate(constraints=lambda c: c.v[0] - 0.3 * c.v[1])
    assert skate(constraints=lambda c: c.q[0] - 0.3 * c.q[1]).lam.numel() == 1  # its integral


# Round-off ------------------------------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(st.floats(0.1, 3.0), st.floats(0.1, 3.0), st.floats(-14.0, -1.0))
def test_a_small_number_is_told_from_terms_that_cancel(x: float, y: float, power: float) -> None:
    symbol, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    a, b = ca.vertsplit(symbol)
    small, quotient = 10.0**power, ca.atan2(a, b) + ca.exp(-a) * ca.sqrt(b) / (a + 3)
    nothing = [
        (a + b) ** 2 - a**2 - 2 * a * b - b**2,
        ca.sin(a) ** 2 + ca.cos(a) ** 2 - 1,
        (0.1 + p) * a - 0.1 * a - p * a,
    ]
    function = ca.Function("f", [symbol, p], [ca.vertcat(*nothing, quotient, small * a, quotient * small)])
    point = np.array([x, y]), np.array([0.2])
    (values,), (errors,) = evaluate(function, [point])
    np.testing.assert_allclose(values, np.asarray(function(*point)), rtol=1e-13, atol=1e-13)
    assert list(np.abs(values.ravel()) > errors.ravel()) == [False] * 3 + [True] * 3
