"""`Solution`: arrays by name with units, files that are whole or absent, angles that do not jump."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_lines import table
from problems import problem, scene, solved

import servocore as sc
from servocore.references.piecewise import PiecewisePolynomial

CRANE = scene("rotary_crane")


@pytest.fixture(scope="module")
def solution() -> sc.Solution:
    return solved(problem("rotary_crane", "points"), 200)


def test_it_lists_inputs_then_observables_outputs_and_coordinates(solution: sc.Solution) -> None:
    expected = ("M_b", "F", "M_w", "phi", "s", "l", "tension", "swing", "x", "y", "z", "d_x", "d_y", "p_x", "p_y")
    assert solution.names == expected
    units = ["N.m", "N", "N.m", "rad", "m", "m", "N", "rad", "m", "m", "m", "1", "1", "m", "m"]
    assert [solution.unit(name) for name in solution.names] == units


def test_names_give_columns(solution: sc.Solution) -> None:
    assert "M_b" in solution
    assert "M_c" not in solution
    np.testing.assert_array_equal(solution["F"], solution.values[:, 1])
    assert solution["F"].shape == solution.t.shape


@pytest.mark.parametrize("ask", [lambda s: s["M_c"], lambda s: s.unit("M_c")])
def test_an_unknown_name_is_refused_and_the_known_ones_listed(
    solution: sc.Solution, ask: Callable[[sc.Solution], object]
) -> None:
    with pytest.raises(KeyError, match="M_c; there are M_b, F, M_w, phi, s, l"):
        ask(solution)


def test_the_route_says_model_formulation_and_method(solution: sc.Solution) -> None:
    assert solution.route == "rotary crane, points, projected, backward-euler"


def test_the_fit_error_of_a_sampled_path_is_handed_on(solution: sc.Solution) -> None:
    assert solution.fit_error is None
    t = np.linspace(0.0, 20.0, 401)
    path = sc.sampled(t, CRANE.reference.jet(t, 0)[:, 0])
    found = sc.solve(CRANE.with_reference(path), sc.Projected(), sc.BackwardEuler(), step=0.1)
    assert found.fit_error == path.fit_error is not None


# Statistics ----------------------------------------------------------------------------------------------------------


def test_violations_are_those_of_the_theory(solution: sc.Solution) -> None:
    """Positions satisfy the constraints to rounding; velocities, differenced, miss them by a first-order amount."""
    statistics = solution.statistics
    assert statistics.servo_violation < 1e-12
    assert statistics.constraint_violation < 1e-12
    assert statistics.worst_residual < 1e-12
    h = 0.1
    path = CRANE.reference.jet(solution.t, 1)
    differenced = np.diff(path[:, 0], axis=0) / h
    assert statistics.servo_rate_violation == pytest.approx(np.abs(differenced - path[1:, 1]).max(), rel=1e-9)


# Files ---------------------------------------------------------------------------------------------------------------


def test_csv_brings_every_digit_back(solution: sc.Solution, tmp_path: Path) -> None:
    solution.to_csv(tmp_path / "inputs.csv")
    header, found = table((tmp_path / "inputs.csv").read_text())
    assert header == ["time", *solution.names]
    np.testing.assert_array_equal(found[:, 0], solution.t)
    np.testing.assert_array_equal(found[:, 1:], solution.values)


def test_csv_holds_the_names_asked_for_in_their_order(solution: sc.Solution, tmp_path: Path) -> None:
    solution.to_csv(tmp_path / "some.csv", ["z", "M_b"])
    header, found = table((tmp_path / "some.csv").read_text())
    assert header == ["time", "z", "M_b"]
    np.testing.assert_array_equal(found[:, 2], solution["M_b"])


def test_csv_holds_numbers_that_are_hard_to_write(tmp_path: Path) -> None:
    values = np.array([[np.pi], [1e-310], [-0.0], [np.nan], [np.inf], [1 / 3]])
    sc.Solution(np.arange(6.0), (sc.Quantity("v", "m"),), values, "by hand").to_csv(tmp_path / "hard.csv")
    _, found = table((tmp_path / "hard.csv").read_text())
    np.testing.assert_array_equal(found[:, 1:], values)
    assert np.signbit(found[2, 1])


def test_unknown_names_write_nothing(solution: sc.Solution, tmp_path: Path) -> None:
    with pytest.raises(KeyError, match="M_c"):
        solution.to_csv(tmp_path / "inputs.csv", ["M_c"])
    assert os.listdir(tmp_path) == []


# Angles --------------------------------------------------------------------------------------------------------------


def turns(count: int, duration: float = 60.0) -> PiecewisePolynomial:
    """Waypoints around the axis, every 30 degrees."""
    angles = np.linspace(0.0, 2 * np.pi * count, 12 * abs(count) + 1)
    return sc.through(np.column_stack([4 * np.cos(angles), 4 * np.sin(angles), -5 + 0 * angles]), duration=duration)


@pytest.mark.parametrize("model", ["points", "generalized", "bodies"])
@pytest.mark.parametrize("count", [2, -2])
def test_the_bridge_angle_goes_on_beyond_full_turns(model: str, count: int) -> None:
    crane = CRANE.with_reference(turns(count))
    found = sc.solve(crane, sc.Projected(), sc.BackwardEuler(), step=0.3, model=model)
    assert np.abs(np.diff(found["phi"])).max() < 0.3
    assert found["phi"][-1] - found["phi"][0] == pytest.approx(2 * np.pi * count, abs=1e-9)
    np.testing.assert_allclose(found["phi"], crane.exact(found.t)["phi"], atol=1e-9)


@pytest.mark.parametrize("model", ["points", "generalized"])
def test_crossing_the_cut_of_the_arc_tangent_leaves_no_trace(model: str) -> None:
    """From 170 to 190 degrees: the same inputs as from -10 to 10 degrees."""

    def sweep(degrees: int) -> sc.Scene:
        angles = np.radians([degrees - 10, degrees, degrees + 10])
        path = np.column_stack([5 * np.cos(angles), 5 * np.sin(angles), [-5, -4, -5]])
        return CRANE.with_reference(sc.through(path, duration=15.0))

    across, ahead = (sc.solve(sweep(d), sc.Projected(), sc.BackwardEuler(), step=0.1, model=model) for d in (180, 0))
    for name in ("M_b", "F", "M_w"):
        np.testing.assert_allclose(across[name], ahead[name], rtol=1e-8, atol=1e-7)
    np.testing.assert_allclose(np.diff(across["phi"]), np.diff(ahead["phi"]), atol=1e-10)


def test_nobody_writes_into_a_solution_or_what_its_copies_hold() -> None:
    times = np.linspace(0.0, CRANE.reference.end_time, 11)
    solution = sc.solve(CRANE, step=2.0)
    copies = (solution, replace(solution, route="copied"), pickle.loads(pickle.dumps(solution)))
    for array in [each for one in copies for each in (one.t, one.values, one["M_b"], one.values[3])]:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    made = sc.Solution(times, solution.channels[:1], solution.values[: len(times), :1], "by hand")
    assert not made.t.flags.writeable
    assert times.flags.writeable  # whoever made it keeps an array of his own


def test_nobody_writes_into_sensitivities_or_a_problem() -> None:
    found = sc.sensitivities(CRANE, step=2.0, wrt="load_mass")
    for array in (found.t, found.values, found.sizes, found["F", "load_mass"], sc.Problem.of(CRANE).p):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
