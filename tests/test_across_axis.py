"""Passing through the slewing axis with a signed trolley position, where the caller asks for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_lines import PROGRAMS

import servocore as sc
from servocore.references.rest_to_rest import RestToRest

STRAIGHT = sc.rest_to_rest((5.0, 0.0, -5.0), (-4.0, 0.0, -4.0), 20.0)
SLANTED = sc.rest_to_rest((4.0, 3.0, -5.0), (-4.0, -3.0, -3.0), 15.0)
STEPS = {STRAIGHT: 201, SLANTED: 301}  # odd numbers, so that no instant falls on the axis


def scene(reference: RestToRest) -> sc.Scene:
    return sc.scenes.rotary_crane(across_axis=True).with_reference(reference)


@pytest.mark.parametrize("model", ["points", "generalized"])
@pytest.mark.parametrize("reference", [STRAIGHT, SLANTED])
def test_the_exact_inversion_follows_its_branch_through_the_axis(reference: RestToRest, model: str) -> None:
    this = scene(reference)
    solution = sc.solve(this, sc.Reduced(), step=reference.duration / STEPS[reference], model=model)
    exact = this.exact(solution.t)
    assert solution["s"].min() < -1.0 < 1.0 < solution["s"].max()
    assert np.ptp(solution["phi"]) < 1e-6  # a straight path through the axis needs no slewing at all
    scales = {name: np.abs(exact[name]).max() for name in ("F", "M_w", "s")}
    scales |= {"phi": 1.0, "M_b": scales["F"] * scales["s"]}  # M_b vanishes: the trolley's force at its lever scales it
    for name, scale in scales.items():
        np.testing.assert_allclose(solution[name], exact[name], rtol=0.0, atol=1e-9 * scale)


def test_the_papers_scheme_passes_the_axis_too() -> None:
    this = scene(STRAIGHT)
    solution = sc.solve(this, sc.Projected(), sc.BackwardEuler(), step=STRAIGHT.duration / 201)
    np.testing.assert_allclose(solution["s"], this.exact(solution.t)["s"], atol=1e-9)


def test_the_trolley_arrives_when_the_crane_is_simulated_across_the_axis() -> None:
    this = scene(SLANTED)
    plant = sc.simulate(this, sc.solve(this, sc.Reduced(), step=SLANTED.duration / 1501))
    assert plant["tracking_error"].max() < 1e-4


def test_an_instant_on_the_axis_is_refused_with_its_time() -> None:
    middle = sc.rest_to_rest((5.0, 0.0, -5.0), (-5.0, 0.0, -5.0), 20.0)
    with pytest.raises(sc.InvalidReference, match="at t = 10 s the trolley reaches the slewing axis"):
        sc.solve(scene(middle), sc.Reduced(), step=0.1)


# Commands ------------------------------------------------------------------------------------------------------------

COMMANDS = [
    ["crane-fmu", "feedforward", "-o", "result.csv"],
    ["crane-fmu", "ssp", "--targets", "host", "-o", "out"],
    ["crane-fmu", "ssp", "--native", "--targets", "host", "-o", "out"],
    ["servocore", "feedforward", "SCENE", "-o", "result.csv"],
    ["servocore", "sensitivities", "SCENE"],
    ["servocore", "sweep", "SCENE", "--vary", "load_mass=50..100:2", "-o", "result.zarr"],
    ["servocore", "view", "SCENE", "-o", "result.html"],
    ["servocore", "export", "SCENE", "--trajectory", "--targets", "host", "-o", "result.fmu"],
]


@pytest.mark.usefixtures("empty_folder")
@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_with_a_path_refuses_one_through_the_axis_in_the_same_sentence(command: list[str]) -> None:
    Path("path.csv").write_text(sc.path_to_csv(sc.rest_to_rest((5.0, 0.0, -5.0), (-5.0, 0.0, -5.0), 20.0)))
    name, *words = ("rotary_crane" if word == "SCENE" else word for word in command)
    line = PROGRAMS[name]
    line.assert_refused(line(*words, "--reference", "path.csv"), "at t = 10 s the trolley reaches the slewing axis")
    assert [each.name for each in Path().iterdir()] == ["path.csv"]


@pytest.mark.usefixtures("compiler", "empty_folder")
@pytest.mark.parametrize("command", [each for each in COMMANDS if "SCENE" in each], ids=" ".join)
def test_a_scene_that_can_pass_the_axis_is_not_refused(command: list[str]) -> None:
    Path("path.csv").write_text(sc.path_to_csv(STRAIGHT))
    Path("passing.py").write_text(
        "import servocore as sc\n\ndef crane():\n    return sc.scenes.rotary_crane(across_axis=True)\n"
    )
    name, *words = ("passing:crane" if word == "SCENE" else word for word in command)
    done = PROGRAMS[name](*words, "--reference", "path.csv")
    assert done.exit_code == 0, done.output
