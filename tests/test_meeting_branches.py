"""A linkage through its stretched position, where two motions meet: found, told, followed smoothly or refused."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from outside.writing import coordinates, lagrange
from scipy.optimize import brentq

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.references.rest_to_rest import RestToRest

CRANK, BASE, MASS, GRAVITY = 0.5, 1.1, 2.0, 9.81
THROUGH = sc.rest_to_rest((0.3,), (np.pi + 0.6,), 4.0)


@cache
def linkage(longer: float = 0.0, guess: str = "parallelogram") -> sc.MechanicalSystem:
    """A planar four-bar linkage of two point masses: joints of crank and coupler, coupler and rocker."""
    q = coordinates("x1 y1 x2 y2", "theta")
    x1, y1, x2, y2, theta = ca.vertsplit(q.q)

    def near(at: ca.SX) -> list[ca.SX]:
        y = at[0]
        twice = 2 * ca.atan2(-CRANK * ca.sin(y), BASE - CRANK * ca.cos(y))
        # Beyond the stretched position the other assembly: the parallelogram's corner mirrored at the diagonal.
        tilt = ca.if_else(y > ca.pi, twice - y, y) if guess == "crossed after" else y
        return [CRANK * ca.cos(y), CRANK * ca.sin(y), BASE + CRANK * ca.cos(tilt), CRANK * ca.sin(tilt), y]

    return lagrange(
        "linkage", q, MASS / 2 * ca.sumsqr(q.v[:4]), {"angle": theta}, {"torque": theta},
        potential=MASS * GRAVITY * (y1 + y2),
        constraints=ca.vertcat(
            x1 - CRANK * ca.cos(theta), y1 - CRANK * ca.sin(theta),
            (x2 - x1) ** 2 + (y2 - y1) ** 2 - BASE**2, (x2 - BASE) ** 2 + y2**2 - (CRANK + longer) ** 2,
        ),
        guess=near, home=(1.0,),
    )  # fmt: skip


def torque(jets: Array, _: object) -> dict[str, Array]:
    """Both masses ride on circles of the crank's radius."""
    y = jets[:, :, 0].T
    return {"torque": 2 * MASS * (CRANK**2 * y[2] + GRAVITY * CRANK * np.cos(y[0]))}


def scene(reference: RestToRest = THROUGH, follow_branch: bool = False, **model: Any) -> sc.Scene:
    return sc.Scene(
        "linkage", {"points": lambda: linkage(**model)}, reference, closed_form=torque, closed_form_order=2,
        follow_branch=follow_branch,
    )  # fmt: skip


def error(subject: sc.Scene, solution: sc.Solution) -> float:
    exact = torque(subject.reference.jet(solution.t, 2), None)["torque"]
    return float(np.abs(solution["torque"] - exact).max() / np.abs(exact).max())


MEETING = brentq(lambda t: THROUGH.jet(t, 0)[0, 0] - np.pi, 1.0, 4.0)
SENTENCE = rf"at t = {MEETING:.4f}\d* s the holonomic constraints lose rank and two motions go on from there"


@pytest.mark.parametrize("step", [0.005, 0.016, 0.1, 0.2])
def test_a_motion_that_goes_on_smoothly_is_right_and_comes_with_a_warning(step: float) -> None:
    subject = scene()
    with pytest.warns(sc.ServocoreWarning, match=SENTENCE + "; this one goes on smoothly"):
        solution = sc.solve(subject, sc.Reduced(), sc.BackwardEuler(), step=step)
    assert error(subject, solution) < 1e-9


@pytest.mark.parametrize("step", [0.005, 0.016, 0.1, 0.2])
def test_a_guess_that_changes_over_does_not_decide_about_the_motion(step: float) -> None:
    subject = scene(guess="crossed after")
    with pytest.warns(sc.ServocoreWarning, match=SENTENCE + "; this one goes on smoothly"):
        solution = sc.solve(subject, sc.Reduced(), sc.BackwardEuler(), step=step)
    assert error(subject, solution) < 1e-8
    assert solution.statistics.branch.startswith("one: followed")


@pytest.mark.parametrize("step", [0.005, 0.016, 0.1])
def test_following_the_branch_goes_on_smoothly_whatever_the_guess(step: float) -> None:
    subject = scene(guess="crossed after", follow_branch=True)
    with pytest.warns(sc.ServocoreWarning, match="goes on smoothly"):
        solution = sc.solve(subject, sc.Reduced(), sc.BackwardEuler(), step=step)
    assert error(subject, solution) < 1e-8


@pytest.mark.parametrize("form", [sc.Original(), sc.Projected()], ids=lambda form: form.name)
def test_forms_that_step_are_looked_at_as_well(form: sc.Formulation) -> None:
    system = linkage()
    massive = replace(system, mass=system.mass + ca.sparsify(ca.diag(ca.DM([0, 0, 0, 0, 1e-3]))))
    subject = replace(scene(), models={"points": lambda: massive})
    with pytest.warns(sc.ServocoreWarning, match="lose rank"):
        solution = sc.solve(subject, form, sc.BackwardEuler(), step=0.016)
    assert re.search(r"^one: .*; at t = .* lose rank .*; this one goes on smoothly$", solution.statistics.branch)
    assert error(subject, solution) < 0.05


def test_analysis_reports_the_instant_and_keeps_its_classification() -> None:
    report = sc.analyse(scene())
    assert report.classification == "flat"
    assert float(report.rank_loss.split("t = ")[1].split(" s")[0]) == pytest.approx(MEETING, abs=1e-4)
    assert f"loss of rank        {report.rank_loss}" in str(report)
    assert sc.analyse(scene(sc.rest_to_rest((0.3,), (2.5,), 4.0))).rank_loss == ""


@pytest.mark.parametrize("short_of", [0.5, 0.1, 1e-2, 1e-3])
def test_a_motion_that_ends_short_of_the_stretched_position_raises_no_alarm(short_of: float) -> None:
    subject = scene(sc.rest_to_rest((0.3,), (np.pi - short_of,), 4.0))
    assert error(subject, sc.solve(subject, step=0.02)) < 1e-9
    assert sc.analyse(subject).rank_loss == ""


@pytest.mark.parametrize("longer", [1e-2, 1e-4])
def test_a_motion_close_by_a_loss_of_rank_raises_no_alarm(longer: float) -> None:
    """A rocker that is longer keeps the assemblies apart by the square root of what it is longer."""
    subject = scene(longer=longer, follow_branch=True)
    sc.solve(subject, sc.Reduced(), sc.BackwardEuler(), step=0.005)
    assert sc.analyse(subject).rank_loss == ""


@pytest.mark.parametrize("steps", [100, 150, 200, 201, 250, 300, 400, 800])
def test_branches_that_come_within_a_thousandth_are_told_apart_at_every_step(steps: int) -> None:
    """The rocker turns back within a millisecond, and other steps than the instants' own are needed to see it."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "linkage, reduced: the path passes close to a pole", sc.ServocoreWarning)
        found = sc.solve(scene(longer=1e-6), step=4.0 / steps)
    assert found["y2"][-1] == pytest.approx(0.11446253077, abs=5e-10)  # proved by `certify`


def test_a_motion_that_ends_in_the_stretched_position_is_warned_of_or_refused_there() -> None:
    """Which of both is up to the last bit of a pivot."""
    ending = scene(sc.rest_to_rest((0.3,), (np.pi,), 4.0))
    refused = r"from t = 3\.98 s to 4 s was not solved"
    warned = r"at t = 4 s the holonomic constraints lose rank .*; this one begins or ends there"
    with pytest.raises((sc.IntegrationFailed, sc.ServocoreWarning), match=f"{refused}|{warned}"):
        sc.solve(ending, sc.Reduced(), sc.BackwardEuler(), step=0.02)


@pytest.mark.parametrize("steps", [4, 6, 40, 400])
def test_a_crane_in_bodies_that_turns_far_from_home_loses_no_rank(steps: int) -> None:
    """At home, along the girder, the path's 0.25 m turn directors by a square: no measure of where it goes."""
    path = sc.rest_to_rest((2.0, 2.0, -2.0), (3.0, 2.25, -2.0), 8.0)
    crane = sc.scenes.rotary_crane().with_reference(path)
    solution = sc.solve(crane, step=8.0 / steps, model="bodies")  # warnings are errors
    assert "lose rank" not in solution.statistics.branch
