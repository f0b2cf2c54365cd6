"""The arm with a passive joint: where its tracked point lies decides whether it can be driven forward in time."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest

import servocore as sc
from servocore.scenes.passive_joint_arm import generalized, passive_joint_arm

DURATION = 2.0
PERCUSSION = 2 / 3  # of a homogeneous rod of 1 m


@cache
def scene(tip: bool = False) -> sc.Scene:
    return passive_joint_arm(tip)


@pytest.mark.parametrize("model", ["generalized", "points"])
@pytest.mark.parametrize("distance", [0.0, 0.3, 0.65, 0.68, 1.0])
def test_the_eigenvalues_follow_from_the_coefficient_of_the_theory(distance: float, model: str) -> None:
    this = scene().with_parameters(tracked_distance=distance)
    p = this.parameter_values()
    J_2 = p["second_inertia"] + p["second_mass"] * p["second_centre"] ** 2
    margin = J_2 - p["second_mass"] * p["second_centre"] * distance
    inertia = p["first_length"] * margin / (p["first_length"] + distance)
    assert (inertia > 0.0) == (distance < PERCUSSION)
    report = sc.analyse(this, model=model)
    kind = "minimum phase" if distance < PERCUSSION else "non-minimum phase"
    assert (report.index, report.internal_degrees_of_freedom, report.classification) == (3, 2, kind)
    expected = np.roots([inertia, p["joint_damping"], p["joint_stiffness"]])
    np.testing.assert_allclose(np.sort_complex(np.array(report.eigenvalues)), np.sort_complex(expected), rtol=1e-8)


def test_the_mass_matrix_derived_from_directors_is_that_of_the_textbook() -> None:
    system = generalized()
    a, b, p = 0.7, -1.1, scene().parameter_values()
    M = np.asarray(ca.Function("M", [system.q, system.p], [system.mass])([a, b], system.parameters.values()))
    J_2 = p["second_inertia"] + p["second_mass"] * p["second_centre"] ** 2
    bent = p["second_mass"] * p["first_length"] * p["second_centre"] * np.cos(b)
    first = p["first_inertia"] + p["second_mass"] * p["first_length"] ** 2 + J_2 + 2 * bent
    np.testing.assert_allclose(M, [[first, J_2 + bent], [J_2 + bent, J_2]], rtol=1e-14)


def test_the_linear_output_stays_close_to_the_angle_of_the_tracked_point() -> None:
    solution = sc.solve(scene(), sc.Reduced(), step=0.01)
    assert np.abs(solution["b"]).max() > 0.1
    assert np.abs(solution["point_angle"] - solution["y"]).max() < 1e-3
    radius = np.hypot(solution["point_x"], solution["point_y"])
    np.testing.assert_allclose(radius**2, 1.0 + 0.16 + 0.8 * np.cos(solution["b"]), rtol=1e-12)


def test_the_tip_follows_its_path_when_the_arm_is_simulated_under_the_bounded_inputs() -> None:
    arm = scene(tip=True)
    tracked = sc.simulate(arm, sc.solve(arm, step=DURATION / 400))["tracking_error"].max()
    assert tracked < 1e-6


def test_tracking_the_centre_of_percussion_is_refused_with_the_reason() -> None:
    there = scene().with_parameters(tracked_distance=PERCUSSION)
    with pytest.raises(sc.InvalidReference, match="joint 2 does not feel the acceleration of the tracked point"):
        sc.solve(there, sc.Reduced(), sc.BackwardEuler())
    assert sc.analyse(there).classification == "singular here"


def test_without_a_spring_the_tip_has_no_bounded_solution() -> None:
    with pytest.raises(sc.InvalidModel, match="decaying and growing modes and no others"):
        scene(tip=True).with_parameters(joint_stiffness=0.0).exact(np.zeros(1))
