"""Effects that cranes leave out: their models against formulas, estimates against simulations, and what reports say."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from command_lines import servocore, write
from present import present
from problems import along_its_line

import servocore as sc
from servocore.effects.closed_loop import run_loop
from servocore.effects.model_inversion import inverted
from servocore.effects.report import HEADINGS, EffectsReport
from servocore.problem import Problem
from servocore.references.profiles import polynomial

CRANES = ("rotary_crane", "overhead_crane", "gantry_crane")
ROWS = {  # index, derivatives of the path and unknowns of the rotary crane with an effect; all are flat
    "elastic rope": (5, 4, 45), "rope mass": (7, 6, 68), "rope mass 2": (9, 8, 102), "rope mass 3": (11, 10, 144),
    "friction": (5, 4, 42), "air drag": (5, 4, 42), "wind": (5, 4, 42), "hook": (7, 6, 68), "load inertia": (7, 6, 68),
    "flexible bridge": (7, 6, 73), "sheave offset": (5, 4, 42),
}  # fmt: skip
NOTHING = {  # values with which an effect nearly vanishes, and the structure remains
    "elastic rope": {"rope_stiffness": 1e8},
    "rope mass": {"rope_mass": 1e-5},
    "friction": {"trolley_friction": 1e-5, "bridge_friction": 1e-5, "winch_friction": 1e-5},
    "air drag": {"drag_area": 1e-7},
    "wind": {"drag_area": 1e-7},
    "hook": {"hook_mass": 1e-5},
    "load inertia": {"hook_mass": 1e-5, "body_gyration": 1e-3},
    "flexible bridge": {"bridge_frequency": 500.0},
    "flexible rail": {"bridge_frequency": 500.0},
    "sheave offset": {"exit_side": 1e-6, "exit_drop": 1e-6},
}  # fmt: skip
G = 9.81


@cache
def crane(name: str) -> sc.Scene:
    return sc.scenes.REGISTRY[name]()


def smooth(scene: sc.Scene, duration: float, order: int = 8) -> sc.Scene:
    return along_its_line(scene, duration, polynomial(2 * order + 1))


def known_only(scene: sc.Scene, values: dict[str, float]) -> dict[str, float]:
    return {name: each for name, each in values.items() if name in scene.model().parameters.names}


def listed(name: str) -> list[str]:
    return [each.name for each in crane(name).effects.declared if each.listed and not each.left_out]


@pytest.mark.parametrize("name", CRANES)
def test_a_crane_assembled_without_effects_has_the_inputs_of_the_closed_form(name: str) -> None:
    scene = crane(name)
    effects = scene.effects
    bare = replace(scene, models={"bare": effects})
    solution = sc.solve(bare, step=0.1)
    exact = scene.exact(solution.t)
    for each in scene.model().inputs:
        np.testing.assert_allclose(
            solution[each.name], exact[each.name], rtol=0, atol=1e-9 * np.abs(exact[each.name]).max()
        )


@pytest.mark.parametrize(("name", "row"), ROWS.items())
def test_lumps_fixed_to_the_rope_and_every_other_effect_leave_the_crane_flat(
    name: str, row: tuple[int, int, int]
) -> None:
    problem = Problem.of(smooth(crane("rotary_crane").with_effects(name), 10.0))
    assert problem.flat
    assert (problem.signature.index, problem.array.reference_order, len(problem.array.unknowns)) == row


@pytest.mark.parametrize("name", CRANES)
def test_every_effect_vanishes_with_its_parameters(name: str) -> None:
    small = smooth(crane(name), 8.0)
    expected = sc.solve(small, step=0.5)
    for effect in listed(name) if name != "gantry_crane" else ["friction", "flexible bridge"]:
        scene = smooth(crane(name).with_effects(effect), 8.0)
        scene = scene.with_parameters(**known_only(scene, NOTHING[effect]))
        inputs = sc.ExactInversion(scene)(expected.t)
        for k, each in enumerate(small.model().inputs):
            atol = 1e-4 * np.abs(expected[each.name]).max()
            np.testing.assert_allclose(inputs[:, k], expected[each.name], rtol=0, atol=atol, err_msg=effect)


def test_without_the_winch_its_torque_lacks_inertia_times_angular_acceleration() -> None:
    scene = smooth(crane("overhead_crane"), 3.0)
    exact, without = scene.exact, sc.solve(scene.with_effects(without=["winch inertia"]), step=2e-3)
    t = without.t
    l_ddot = np.gradient(np.gradient(exact(t)["l"], t, edge_order=2), t, edge_order=2)
    lacking = exact(t)["M_w"] - without["M_w"]
    np.testing.assert_allclose(lacking[5:-5], 0.1 / 0.1 * l_ddot[5:-5], atol=2e-3 * np.abs(l_ddot).max())


def test_friction_adds_its_own_law_to_the_inputs_and_leaves_the_motion_as_it_is() -> None:
    scene = smooth(crane("overhead_crane"), 3.0)
    plain, rough = sc.solve(scene, step=1e-3), sc.solve(scene.with_effects("friction"), step=1e-3)
    v = np.gradient(plain["s"], plain.t, edge_order=2)
    law = 10.8 * (np.tanh(v / 0.01) + 0.2 * v)
    moving = np.abs(v) > 0.05
    np.testing.assert_allclose((rough["F"] - plain["F"])[moving], law[moving], atol=1e-3)
    np.testing.assert_allclose(rough["s"], plain["s"], atol=1e-12)


DRAG = 0.5 * 1.25 * 12.0 * math.hypot(12.0, 0.01)
AT_REST: list[tuple[str, dict[str, float], dict[str, float]]] = [
    ("elastic rope", {"rope_stiffness": 2e4}, {"l": 4.0 / (1 + 100.0 * G / 2e4)}),  # it stretches
    ("rope mass", {"rope_mass": 3.0}, {"M_w": -(100.0 + 3.0 * 4.0) * G * 0.1}),  # the winch holds what is paid out
    ("rope mass 2", {"rope_mass": 3.0}, {"M_w": -(100.0 + 3.0 * 4.0) * G * 0.1}),
    ("wind", {"wind_speed": 12.0}, {"overhang_x": 4.0 * DRAG / (100.0 * G), "F": -DRAG}),
    ("sheave offset", {"exit_drop": 0.7}, {"l": 3.3}),
    ("load inertia", {"body_centre": 0.4, "body_gyration": 0.3}, {"hook_z": -4.0 + 0.4 + 0.3**2 / 0.4}),
]


@pytest.mark.parametrize(("effect", "given", "expected"), AT_REST)
def test_at_rest_effects_have_closed_forms(effect: str, given: dict[str, float], expected: dict[str, float]) -> None:
    scene = smooth(crane("overhead_crane").with_effects(effect), 5.0)
    solution = sc.solve(scene.with_parameters(**given), step=5.0)
    assert {name: solution[name][0] for name in expected} == pytest.approx(expected, rel=1e-12)


def test_the_spring_of_a_flexible_bridge_carries_what_moves_behind_it() -> None:
    scene = smooth(crane("gantry_crane").with_effects("flexible bridge"), 6.0)
    solution, share, frequency = sc.solve(scene, step=2e-3), 0.3, 6.0
    stiffness = (2 * math.pi * frequency) ** 2 * 40.0 * share * (1 - share)
    t, motor = solution.t, solution["s_x_motor"]
    own = share * 40.0 * np.gradient(np.gradient(motor, t, edge_order=2), t, edge_order=2)
    np.testing.assert_allclose(stiffness * (motor - solution["s_x"])[5:-5], (solution["F_x"] - own)[5:-5], atol=1e-3)


@pytest.mark.parametrize("name", ["rotary_crane", "overhead_crane"])
def test_the_own_inputs_of_every_effects_model_drive_its_plant_along_the_path(name: str) -> None:
    for effect in [*listed(name), "rope mass 2"]:
        scene = smooth(crane(name).with_effects(effect), 6.0, order=8 if effect == "rope mass 2" else 6)
        problem, measured = Problem.of(scene), scene.effects.measured
        fine = 4 if effect == "friction" else 1  # it turns from one side to the other within a fiftieth of a second
        own = inverted(problem, measured, 3000 * fine + 1)
        assert run_loop(own, own, own.gains(None), coarsest=1e-3 / fine).error < 1e-9, effect


def test_a_stiff_elastic_rope_has_inputs_without_noise() -> None:
    # 5e6 N at a stretch of a millimetre: as a difference of lengths the pull would be known to nine digits.
    scene = smooth(crane("rotary_crane").with_effects("elastic rope"), 5.0)
    t = 2.0 + 1e-4 * np.arange(200)
    for each in sc.ExactInversion(scene)(t).T:
        fitted = np.polynomial.Chebyshev.fit(t, each, 8)(t)
        np.testing.assert_allclose(each, fitted, rtol=0, atol=1e-11 * np.abs(each).max())


def test_effects_combine_in_one_model_that_solve_takes() -> None:
    names = ("friction", "sheave offset", "air drag", "elastic rope", "hook")
    problem = Problem.of(smooth(crane("rotary_crane").with_effects(*names), 10.0))
    assert (problem.flat, problem.signature.index, len(problem.array.unknowns)) == (True, 7, 71)
    scene = smooth(crane("rotary_crane").with_effects("friction", "flexible bridge"), 10.0)
    assert sc.solve(scene, step=0.1)["phi_motor"][0] == pytest.approx(0.0, abs=1e-12)
    again = scene.with_effects("hook", without=["friction"])
    assert again.effects.added == {"flexible bridge", "hook"}


def test_a_scene_with_effects_is_exported_like_any_other(tmp_path: Path) -> None:
    scene = smooth(crane("overhead_crane").with_effects("friction"), 5.0)
    assert sc.export_fmu(scene, tmp_path / "crane.fmu", targets="host").stat().st_size > 10_000


def test_equal_scenes_with_effects_share_what_was_made() -> None:
    one, two = (crane("rotary_crane").with_effects("friction", "hook") for _ in range(2))
    assert one.model() is two.model()


@pytest.mark.parametrize(
    ("words", "name", "names", "without"),
    [
        ("no effect is called stiction; there are elastic rope", "rotary_crane", ["stiction"], []),
        ("choose one number of lumps", "rotary_crane", ["rope mass", "rope mass 2"], []),
        ("cannot be both with and without hook", "rotary_crane", ["hook"], ["hook"]),
        ("^cars declares no effects that could be added or left out$", "cars", [], []),
    ],
)
def test_effects_that_make_no_sense_are_refused(words: str, name: str, names: list[str], without: list[str]) -> None:
    with pytest.raises(sc.InvalidModel, match=words):
        crane(name).with_effects(*names, without=without)


# Reports.


@cache
def report(name: str, simulate: bool = False) -> EffectsReport:
    return sc.effects(along_its_line(crane(name), 10.0), simulate=simulate)


def test_simulated_errors_of_the_rotary_crane_are_those_of_an_independent_study() -> None:
    # Forward simulations by fourth-order steps of 1 to 2 ms in another program, degree 9, 10 s, drives of 6 rad/s.
    known = {"elastic rope": 0.57, "friction": 76.0, "winch inertia": 0.73, "air drag": 16.0, "wind": 490.0,
             "sheave offset": 128.0}  # fmt: skip
    found = report("rotary_crane", simulate=True)
    for name, error in known.items():
        assert found[name].how == "simulated"
        assert found[name].law == "law degree-9"
        assert found[name].error == pytest.approx(1e-3 * error, rel=0.05), name


@pytest.mark.parametrize("name", ["rotary_crane", "overhead_crane"])
def test_estimates_that_are_shown_are_near_what_simulations_show(name: str) -> None:
    # Estimates are shown but near the tolerance, where they are as good, and where plants answer otherwise.
    estimated, simulated = report(name), report(name, simulate=True)
    shown = [each for each in estimated.rows if each.how == "estimated"]
    good = [*shown, *(each for each in estimated.rows if "near the tolerance" in each.reason)]
    assert len(good) >= 8
    assert all(row.error == row.estimate for row in shown)
    for row in good:
        assert row.estimate == pytest.approx(simulated[row.name].error, rel=0.12), row.name


def test_a_plant_that_answers_otherwise_than_the_small_model_is_simulated() -> None:
    # A body a metre and a quarter below its hook swings about it, within five seconds too fast to be left out; drives
    # with dry friction stick. Everywhere else the small model answers like the plant.
    quick = crane("gantry_crane").with_reference(sc.rest_to_rest((0.0, 0.0, -5.0), (6.0, 3.0, -2.0), 5.0))
    found = sc.effects(quick, tolerance=1e-9)
    assert {"load inertia", "friction"} <= {each.name for each in found.rows if each.how == "simulated"}
    assert "the plant's dynamics differ" in found["load inertia"].reason
    assert present(found["load inertia"].estimate) < 0.9 * present(found["load inertia"].error)
    assert found["hook"].how == "estimated"


def test_effects_of_index_seven_are_looked_at_on_a_smoother_law_which_is_named() -> None:
    assert {each.law for each in report("rotary_crane").rows if each.index == 7} == {"law degree-13"}
    assert "law degree-13: " in str(report("rotary_crane"))


def test_a_path_through_points_that_is_too_rough_for_a_row_refuses_that_row_by_name() -> None:
    t = np.linspace(0.0, 10.0, 41)
    points = crane("overhead_crane").with_reference(sc.rest_to_rest((0.0, -4.0), (5.0, -1.0), 10.0)).reference.jet(t, 0)
    scene = crane("overhead_crane")
    rough, fine = (sc.effects(scene.with_reference(sc.sampled(t, points[:, 0], rest_order=k))) for k in (4, 6))
    assert rough["hook"].how == "refused"
    assert "continuous up to its derivative of order 4, this effect needs order 6" in rough["hook"].reason
    assert fine["hook"].how == "estimated"
    assert fine["hook"].law == "the scene's own law"
    assert rough["friction"].error == pytest.approx(fine["friction"].error, rel=0.01)


def test_rows_come_worst_first_and_what_is_left_out_adds_up_to_less_than_the_tolerance() -> None:
    found = report("rotary_crane")
    errors = [each.error for each in found.rows]
    assert errors == sorted(errors, reverse=True)
    assert sum(each.error for each in found.rows if not each.needed) <= 0.005
    least = min(each.error for each in found.rows if each.needed)
    assert sum(each.error for each in found.rows if not each.needed) + least > 0.005


def test_rows_near_the_tolerance_are_simulated_and_say_so() -> None:
    found = report("rotary_crane")
    assert {each.name for each in found.rows if "near the tolerance" in each.reason} == {"hook"}
    assert all((each.how == "simulated") == bool(each.reason) for each in found.rows)


def test_the_verdict_builds_the_smallest_model() -> None:
    found = report("rotary_crane")
    added, without = found.arguments
    assert "air drag" not in added  # it comes with the wind
    assert {"wind", "friction", "sheave offset"} <= set(added)
    assert without == ("winch inertia",)
    smallest = found.smallest()
    assert smallest.effects.added == set(added)
    assert f"with {', '.join(added)} added and winch inertia left out: " in found.verdict


@pytest.mark.parametrize("name", ["rotary_crane", "overhead_crane"])
def test_the_verdict_says_which_path_the_smallest_model_needs(name: str) -> None:
    found = report(name)
    degree = int(found.verdict.split("a path of degree ")[1].split()[0])
    smooth_enough = smooth(found.scene, 10.0, (degree - 1) // 2)
    smallest = sc.Problem.of(found.smallest().with_reference(smooth_enough.reference))
    assert smallest.array.reference_order == smooth_enough.reference.smoothness
    assert "continuous derivatives" not in sc.effects(smooth_enough, tolerance=0.005, simulate=False).verdict


def test_the_table_has_the_columns_of_its_headings() -> None:
    text = str(report("rotary_crane"))
    assert all(heading in text for heading in HEADINGS)
    assert all(len(row) == len(HEADINGS) for row in report("rotary_crane").cells())


def test_a_plant_of_ones_own_is_a_row_like_any_other() -> None:
    effects = crane("overhead_crane").effects
    own = replace(effects, added=frozenset({"hook"}), left_out=frozenset())
    found = sc.effects(smooth(crane("overhead_crane"), 5.0), plant={"our hook": own}, parameters={"hook_mass": 20.0})
    assert found["our hook"].error == pytest.approx(found["hook"].error, rel=1e-9)
    assert "our hook" in found.needed


def test_a_plant_with_internal_dynamics_is_simulated() -> None:
    # A rod hangs from the rope: its hook follows the path, and nothing holds the rod.
    scene = smooth(crane("overhead_crane"), 5.0)
    rod = scene.with_effects("hook").model()
    hook = rod.q[[4, 5]]
    outputs = (sc.Quantity("hook_x", "m"), sc.Quantity("hook_z", "m"))
    below = ca.substitute(rod.guess, rod.gamma[1, 0], rod.gamma[1, 0] - 0.4)
    plant = replace(rod, name="rod", output=hook, outputs=outputs, home=(1.0, -3.6), guess=below)
    found = sc.effects(scene, plant={"rod": lambda: plant})["rod"]
    assert found.how == "simulated"
    assert found.internal_states == 2
    assert "internal dynamics" in found.reason
    assert found.input_change is None


def test_without_drives_a_hundredth_of_a_percent_of_the_inputs_is_a_wide_miss() -> None:
    found = sc.effects(along_its_line(crane("rotary_crane"), 10.0), loops=None)
    assert present(found["elastic rope"].input_change) < 2e-4
    assert found["elastic rope"].error == pytest.approx(0.044, rel=0.05)


BAD: list[tuple[dict[str, Any], str]] = [
    ({"tolerance": 0.0}, "the tolerance must be positive and finite, not 0"),
    ({"loops": 6.0}, r"loops must be PositionLoops\(...\) or None, not 6.0"),
    ({"parameters": {"hook": 1.0}}, "no parameter of an effect is called hook"),
    ({"plant": {"ours": 3}}, "the plant ours must be a function that returns a model, not 3"),
    ({"plant": {"ours": sc.scenes.cars}}, "the result of the plant ours must be a MechanicalSystem"),
    ({"plant": {"ours": sc.scenes.cars().model}}, "the plant ours has the inputs u, overhead_crane"),
    ({"plant": {"hook": sc.scenes.cars}}, "hook is an effect of overhead_crane; the plant needs"),
    ({"parameters": {"hook_mass": -1.0}}, "hook_mass = -1 kg is outside its range"),
]


@pytest.mark.parametrize(("options", "words"), BAD)
def test_bad_settings_are_refused_by_name(options: dict[str, Any], words: str) -> None:
    with pytest.raises((sc.InvalidSetting, sc.InvalidModel), match=words):
        sc.effects(crane("overhead_crane"), **options)


def test_a_rope_shorter_than_its_lumps_refuses_its_row() -> None:
    scene = smooth(crane("overhead_crane"), 5.0)
    few = tuple(each for each in scene.effects.declared if "rope" in each.name)
    found = sc.effects(replace(scene, effects=replace(scene.effects, declared=few)), parameters={"rope_piece": 3.0})
    assert found["rope mass"].how == "refused"
    assert "rope_above is -" in found["rope mass"].reason
    assert ", apart from rope mass, which cannot be judged, the load keeps" in found.verdict


# Paths that are too rough.


def rough(index_seven: bool = True) -> sc.Scene:
    scene = crane("overhead_crane").with_reference(sc.rest_to_rest((0.0, -4.0), (5.0, -1.0), 5.0, sc.DEGREE9))
    return scene.with_effects("hook") if index_seven else scene


def test_simulate_and_solve_refuse_a_path_on_which_a_plant_of_index_seven_would_start_in_motion() -> None:
    words = "has index 7: its velocities need the path's derivative of order 5, .* continuous up to order 4 only"
    with pytest.raises(sc.InvalidReference, match=words + ".* polynomial of degree 13"):
        sc.solve(rough())
    with pytest.raises(sc.InvalidReference, match=words):
        sc.simulate(rough(), lambda _: np.zeros(2), t=np.linspace(0.0, 1.0, 3))


def test_the_same_path_serves_index_five_and_simulations_that_start_before_it_or_from_a_state_of_ones_own() -> None:
    assert sc.solve(rough(index_seven=False)).statistics.servo_violation < 1e-9
    start = sc.solve(rough().with_reference(sc.rest_to_rest((0.0, -4.0), (5.0, -1.0), 5.0, sc.DEGREE13)))
    hold = np.array([start["F"][0], start["M_w"][0]])
    motion = sc.simulate(rough(), lambda _: hold, t=np.linspace(-1.0, -0.5, 3))
    assert motion["tracking_error"].max() < 1e-9
    names = rough().model().coordinates.names
    state = {name: float(start[name][0]) for name in names} | {f"{name}_dot": 0.0 for name in names}
    moved = sc.simulate(rough(), lambda _: hold, t=np.array([0.0, 1e-3]), start=state)
    assert abs(moved["s"][-1]) < 1e-9


# The command.


@pytest.mark.usefixtures("empty_folder")
def test_the_command_prints_the_table_and_writes_the_page() -> None:
    write("crane.toml", "load_mass = 80.0\nhook_mass = 2.0\n")
    options = ("--deviation", "2cm", "--parameters", "crane.toml", "--markdown", "page.md")
    result = servocore("effects", "overhead_crane", *options)
    assert result.exit_code == 0, result.output
    assert "the load keeps 20 mm with" in " ".join(result.stdout.split())
    assert "with_effects" not in result.stdout
    page = Path("page.md").read_text(encoding="utf-8")
    assert page.startswith("# Effects that overhead_crane may neglect")
    assert "| effect | index | internal states |" in page
