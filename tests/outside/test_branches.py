"""Where several configurations belong to one output, the answer is one motion: that of the first instant."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from functools import cache, partial

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from outside.systems import GRAVITY, LOOP, MASS, elbow_arm, vtol
from outside.writing import coordinates, g, lagrange

import servocore as sc
from servocore.numerics.compiled_calls import Array


def assert_right(
    found: sc.Solution | Mapping[str, Array], exact: Mapping[str, Array], tolerance: float = 1e-10
) -> None:
    for name, values in exact.items():
        if name in found:
            assert np.abs(found[name] - values).max() <= tolerance * np.abs(values).max()


@pytest.mark.parametrize("steps", [25, 200, 1000])
def test_an_aircraft_turns_over_on_one_branch(steps: int) -> None:
    aircraft = vtol()
    solution = sc.solve(aircraft.scene, step=5.0 / steps)
    assert_right(solution, aircraft.exact(solution.t))
    assert 13.9 < solution["f"].min() < 14.1
    assert solution.statistics.branch.startswith("one: followed")


@cache
def inputs_of_the_aircraft() -> sc.ExactInversion:
    return sc.ExactInversion(vtol().scene)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(0.0, 5.0), min_size=7, max_size=7))
def test_the_inputs_at_any_instants_in_any_order_are_those_of_that_branch(times: Array) -> None:
    exact, found = vtol().exact(np.array(times)), inputs_of_the_aircraft()(times)
    for k, name in enumerate(("f", "torque")):
        np.testing.assert_allclose(found[:, k], exact[name], rtol=1e-9, atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(duration=st.floats(3.0, 12.0), turn=st.floats(-0.6, 0.6), lift=st.floats(0.6, 1.5))
def test_other_loops_are_flown_on_one_branch_too(duration: float, turn: float, lift: float) -> None:
    """Where the thrust vanishes the branches meet, and refusal or a warning is right; elsewhere the answer is."""
    cos, sin = np.cos(turn), np.sin(turn)
    points = [(cos * x - sin * z, lift * (sin * x + cos * z)) for x, z in LOOP]
    aircraft = vtol(path=sc.through(points, duration=duration))
    exact = aircraft.exact(np.linspace(0.0, duration, 2001))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            solution = sc.solve(aircraft.scene)
        except sc.ServocoreError:
            assert exact["f"].min() < 1.0
            return
    assert not said or exact["f"].min() < 1.0
    assert_right(solution, aircraft.exact(solution.t), 1e-8)


@pytest.mark.parametrize("guess", [(0.3, 1.0), (-0.5, 1.5), (0.0, 0.5), (0.5, 2.0), (0.2, 1.2)])
def test_a_constant_guess_is_a_start_and_not_a_law(guess: tuple[float, float]) -> None:
    arm = elbow_arm(guess)
    assert sc.analyse(arm.scene).classification == "flat"
    solution = sc.solve(arm.scene)
    exact = arm.exact(solution.t)
    if np.mod(solution["b"][0], 2 * np.pi) > np.pi:
        pytest.skip("this guess leads to the other assembly, whose torques are others")
    assert_right({name: solution[name] for name in ("T_1", "T_2")}, {name: exact[name] for name in ("T_1", "T_2")})


def test_round_after_round_the_arm_keeps_its_elbow() -> None:
    arm = elbow_arm(cycles=5)
    solution = sc.solve(arm.scene, step=0.05)
    assert_right(solution, {name: values for name, values in arm.exact(solution.t).items() if name != "b"})
    assert np.ptp(np.sign(np.sin(solution["b"]))) == 0.0


@settings(max_examples=10, deadline=None)
@given(drop=st.floats(25.0, 300.0))
def test_a_fall_faster_than_free_is_told_as_two_singularities_passed(drop: float) -> None:
    """The thrust goes through zero, where the torque tells nothing of the path; the guess of the model stays exact."""
    aircraft = vtol(path=sc.rest_to_rest((0.0, 0.0), (0.0, -drop), duration=4.0))
    solution = sc.solve(aircraft.scene)
    exact = MASS * (GRAVITY + aircraft.scene.reference.jet(solution.t, 2)[:, 2, 1])
    np.testing.assert_allclose(solution["f"], exact, atol=1e-12 * np.abs(exact).max())
    passed = np.flatnonzero(exact[:-1] * exact[1:] < 0.0)
    assert len(passed) == 2
    told = [f"between t = {solution.t[k]:.6g} s and {solution.t[k + 1]:.6g} s" for k in passed]
    assert all(each in solution.statistics.branch for each in told)


@cache
def rod_that_turns(closed: bool) -> sc.MechanicalSystem:
    """A torque on a rod whose end moves sideways as prescribed: every place but the outermost belongs to two angles."""
    q = coordinates("", "theta")
    return lagrange(
        "rod", q, q.v[0] ** 2 / 2, {"Y": ca.sin(q["theta"])}, {"T": q["theta"]}, potential=-g * ca.cos(q["theta"]),
        guess=lambda at: (ca.asin(at[0]) if closed else 0.0,), home=(0.1,),
    )  # fmt: skip


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("follow", [False, True])
@pytest.mark.parametrize("steps", [40, 41, 200, 333, 1000])
def test_a_rod_turns_on_where_its_angles_meet_or_is_refused_there(steps: int, follow: bool, closed: bool) -> None:
    """Instants that are singular themselves tell nothing of the torque: no answer may be made to continue another."""
    path = sc.periodic((0.0,), [[0.0]], [[1.0]], 2 * np.pi)
    scene = sc.Scene("rod", {"rod": partial(rod_that_turns, closed)}, path, follow_branch=follow)
    if steps % 4 == 0 and not follow:
        with pytest.raises(sc.IntegrationFailed, match=r"singular at t = 1\.5708 s"):
            sc.solve(scene, step=2 * np.pi / steps)
        return
    try:
        solution = sc.solve(scene, step=2 * np.pi / steps)
    except sc.IntegrationFailed as error:
        refused = str(error)
    else:
        refused = ""
        np.testing.assert_allclose(solution["theta"], solution.t, atol=1e-6)
        np.testing.assert_allclose(solution["T"], g * np.sin(solution.t), atol=1e-6)
    assert not refused or (steps % 4 == 0 and "t = 1.5708 s" in refused)
