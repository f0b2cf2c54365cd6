"""Drives from data sheets: closed forms, balance of power, limits between instants, and where motors are reported."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest
from command_lines import CommandLine, write
from present import of_kind
from problems import DRIVES, driven_crane
from scipy.integrate import simpson
from thinned import thinned

import servocore as sc
from servocore.checks.motion_limits import limited_values
from servocore.cli.commands import app
from servocore.model.drives import largest_torque
from servocore.model.limits import Bounds
from servocore.problem import Problem
from servocore.references.rest_to_rest import RestToRest
from servocore.solvers.branch_continuation import exact_states, prepared_table
from servocore.stepping.forward_dynamics import compile_plant

line = CommandLine(app, "servocore")
SHEET = """
[F]
ratio = 25
drum_radius = "125 mm"
motor_inertia = "4 kg cm^2"
viscous = 2e-4
coulomb = 0.02
[M_w]
ratio = 12
rope_falls = 2
motor_inertia = "0.0003 kg m^2"
efficiency = "85 %"
viscous = 3e-4
torque_constant = "1.1 N m/A"
torque_speed = [["0 rpm", "12 N m"], ["3000 rpm", 11], ["8000 rpm", 9]]
rated_torque = "5 N m"
rated_power = "1.5 kW"
"""
QUANTITIES = {"motor_torque": "N.m", "motor_speed": "rad/s", "power": "W", "current": "A", "torque_reserve": "N.m"}
OF_WINCH = {f"M_w.{name}": unit for name, unit in QUANTITIES.items()}


CRANES = ("rotary_crane", "overhead_crane", "gantry_crane")


def ends(scene: sc.Scene) -> tuple[tuple[float, ...], tuple[float, ...]]:
    path = of_kind(RestToRest, scene.reference)
    return path.start, path.end


@cache
def random_crane(seed: int) -> tuple[sc.Scene, dict[str, tuple[float | None, float | None]]]:
    """Return a crane with random drives, and limits of its motors that its own path breaks if it is made faster."""
    draw = np.random.default_rng(seed)
    crane = sc.scenes.REGISTRY[CRANES[seed % 3]]()
    slow = crane.with_reference(sc.rest_to_rest(*ends(crane), 30.0))
    peaks = {name: np.abs(sc.solve(slow)[name]).max() for name in (e.name for e in crane.model().inputs)}
    drives, limits = {}, dict[str, tuple[float | None, float | None]]()
    for each in crane.model().inputs:
        n = draw.uniform(10.0, 60.0)
        torque = draw.uniform(1.5, 3.0) * peaks[each.name] / n
        speeds = np.cumsum(draw.uniform(0.3, 1.0, 3)) * n
        drives[each.name] = sc.Drive(
            ratio=n, drum_radius=1.0 if each.unit == "N" else None, motor_inertia=draw.uniform(0.0, 20.0) / n**2,
            viscous=draw.uniform(0.0, 1.0) / n**2, coulomb=0.02 * torque, efficiency=draw.uniform(0.8, 1.0),
            torque_speed=[(0.0, torque), *zip(speeds, torque * np.sort(draw.uniform(0.5, 1.2, 3))[::-1], strict=True)],
        )  # fmt: skip
        limits[f"{each.name}.torque_reserve"] = (0.0, None)
    return crane.with_drives(**drives), limits


@pytest.mark.parametrize("name", CRANES)
def test_a_crane_with_drives_is_the_crane_with_their_reflected_inertia(name: str) -> None:
    """To 1e-12 of the peaks, by every model: what turns about an axis is one inertia, wherever it sits."""
    bare, slewing = sc.scenes.REGISTRY[name](), name == "rotary_crane"
    drives = {"M_w": sc.Drive(ratio=20, rope_falls=2, motor_inertia=5e-4)}
    drives |= {"M_b": sc.Drive(ratio=90, motor_inertia="120 kg cm^2")} if slewing else {}
    drives |= {"F": sc.Drive(ratio=30, drum_radius=0.2, motor_inertia=1e-3)} if name == "overhead_crane" else {}
    added = {"winch_inertia": 40**2 * 5e-4, "bridge_inertia": 90**2 * 0.012, "trolley_mass": 150.0**2 * 1e-3}
    own = {"winch_inertia"} | ({"bridge_inertia"} if slewing else {"trolley_mass"} if "F" in drives else set())
    same = bare.with_parameters(**{each: bare.parameter_values()[each] + added[each] for each in own})
    for model in bare.models:
        found = sc.solve(bare.with_drives(**drives), step=bare.reference.duration / 40, model=model)
        expected = same.exact(found.t)
        for each in bare.model().inputs:
            peak = np.abs(expected[each.name]).max()
            np.testing.assert_allclose(found[each.name], expected[each.name], rtol=0.0, atol=1e-12 * peak)


@pytest.mark.parametrize("model", ["points", "generalized"])
def test_the_power_of_the_motors_is_the_rate_of_energy_and_friction_to_round_off(model: str) -> None:
    lossless = {name: replace(drive, efficiency=1.0) for name, drive in DRIVES.items()}
    problem = Problem.of(driven_crane().with_drives(**lossless), model)
    system, array = problem.system, problem.array
    energy, v_dot = ca.dot(system.v, system.mass @ system.v) / 2 + system.potential, ca.SX.sym("a", system.v.numel())
    stored = ca.jtimes(energy, ca.vertcat(system.q, system.v), ca.vertcat(system.v, v_dot))
    motors = sum(expression for each, expression in system.observables.items() if each.unit == "W")
    terms = ca.vertcat(motors, stored, -ca.dot(system.force, system.v))  # the forces are those of friction
    balance = ca.Function("balance", [system.q, system.v, v_dot, system.u, system.p], [terms])
    for state in exact_states(problem, prepared_table(problem))(np.linspace(0.2, 2.8, 21)).T:
        motion = [[state[array.position(f"q.{name}", k)] for name in system.coordinates.names] for k in range(3)]
        u = [state[array.position(f"u.{each.name}", 0)] for each in system.inputs]
        power, change, lost = np.asarray(balance(*motion, u, problem.p)).ravel()
        assert lost > 0.0
        assert power == pytest.approx(change + lost, abs=1e-12 * 5e3)  # of the peak


def test_energies_are_the_integrals_of_powers_and_losses_of_the_gear_count_by_the_direction_of_power() -> None:
    drive = sc.Drive(ratio=24, motor_inertia=3e-4)
    scene = sc.scenes.overhead_crane().with_drives(M_w=drive, F=sc.Drive(drum_radius=0.1))
    for solution in (found := sc.solve(scene, step=0.005), sc.simulate(scene, found)):
        lifted = 100.0 * 9.81 * 3.0
        assert solution["M_w.energy"][-1] + solution["F.energy"][-1] == pytest.approx(lifted, rel=1e-6)
        assert solution.unit("M_w.energy") == "J"
    lossy = sc.solve(scene.with_drives(M_w=sc.Drive(ratio=24, motor_inertia=3e-4, efficiency=0.8)), step=0.005)
    np.testing.assert_array_equal(lossy["M_w"], found["M_w"])
    power = found["M_w.power"]
    share = np.divide(lossy["M_w.motor_torque"], found["M_w.motor_torque"])[np.abs(found["M_w.motor_speed"]) > 5.0]
    expected = np.where(power > 0.0, 1 / 0.8, 0.8)[np.abs(found["M_w.motor_speed"]) > 5.0]
    np.testing.assert_allclose(share, expected, rtol=1e-6)
    assert found["M_w.motor_torque"][0] == pytest.approx(-100.0 * 9.81 * 0.1 / 24)


@pytest.mark.parametrize(
    "curve",
    [[(0, 30), (151, 25), (314, 10)], [(0, 30), (314, 30)], [(0, 20), (100, 50), (150, 30), (300, 12), (301, 0)]],
)
def test_the_smooth_torque_speed_curve_is_close_to_that_of_the_sheet_and_never_above(
    curve: list[tuple[float, float]],
) -> None:
    speed, most = ca.SX.sym("speed"), float(curve[-1][0])
    smooth = ca.Function("smooth", [speed], [largest_torque(sc.Drive(torque_speed=curve), speed)])
    at = np.linspace(-most, most, 4001)
    sheet, found = np.interp(np.abs(at), *zip(*curve, strict=True)), np.asarray(smooth(at)).ravel()
    assert (found < sheet).all()
    slopes = np.diff(np.array([*curve, (1.05 * most, 0.0)]), axis=0)
    bend = np.abs(np.diff(slopes[:, 1] / slopes[:, 0])).max()
    assert (found > sheet - 1.1e-3 * most * bend).all()
    assert float(smooth(1.05 * most)) < 0.0


@pytest.mark.parametrize("seed", thinned(range(12), lambda seed: seed < 2))
def test_plans_keep_torque_speed_curves_of_random_drives_between_all_instants(seed: int) -> None:
    crane, limits = random_crane(seed)
    plan, report = sc.fastest(crane, ends(crane), limits, intervals=40)
    assert report.certificate.violation <= 1e-9
    bounded = crane.with_limits(**limits).with_reference(plan)
    problem = Problem.of(bounded)
    t = np.linspace(plan.start_time, plan.end_time, 50_001)
    reserves = limited_values(problem, exact_states(problem, prepared_table(problem)), t)
    peak = max(torque for drive in crane.drives.values() for _, torque in drive.corners)
    assert -1e-6 * peak < reserves.min() < 0.02 * peak  # one of them is used up
    with pytest.raises(sc.LimitBroken, match="torque_reserve goes beyond its lower limit of 0 N"):
        sc.solve(bounded.with_reference(sc.rest_to_rest(*ends(crane), report.duration)))


def test_a_certificate_proves_the_limits_of_the_motors() -> None:
    limits: dict[str, Bounds] = {"M_w.torque_reserve": (0.0, None), "M_w.motor_speed": "8000 rpm"}
    limits |= {"M_w.power": "5 kW", "M_w.current": 12.0}
    certificate = sc.certify(driven_crane(), limits)
    assert certificate.verdict == "proved"
    assert {each.what for each in certificate.statements} > {f"limit of {name}" for name in limits}
    assert sc.certify(driven_crane(), {"M_w.current": 5.0}).verdict == "refuted"


def test_tables_sweeps_and_pages_have_the_quantities_of_the_motors_with_units(tmp_path: Path) -> None:
    scene = driven_crane().with_limits(**{"M_w.current": 12.0})
    solution = sc.solve(scene)
    assert {name: solution.unit(name) for name in OF_WINCH} == OF_WINCH
    solution.to_csv(tmp_path / "run.csv")
    assert set(OF_WINCH) < set((tmp_path / "run.csv").read_text().partition("\n")[0].split(","))
    swept = sc.sweep(scene, {"load_mass": [80.0, 100.0], "M_w.ratio": [12.0, 14.0]}, instants=201)
    for name, unit in OF_WINCH.items():
        assert swept[f"peak_{name}"].attrs["units"] == unit
        assert float(swept[f"peak_{name}"][1, 0]) == pytest.approx(np.abs(solution[name]).max(), rel=1e-9)
    assert float(swept["margin_M_w.current"][1, 0]) == pytest.approx(12.0 - np.abs(solution["M_w.current"]).max())
    page = sc.view(solution, tmp_path / "page.html").read_text()
    for name, unit in OF_WINCH.items():
        assert json.dumps({"name": name, "unit": unit}, separators=(",", ":"))[1:-1] in page


@pytest.mark.parametrize("fmi", [2, 3])
def test_both_kinds_of_fmus_have_them_as_outputs(tmp_path: Path, fmi: int) -> None:
    scene = driven_crane()
    inverse, plant = (
        export(scene, tmp_path / f"{export.__name__}.fmu", fmi=fmi, targets="host")
        for export in (sc.export_fmu, sc.export_plant)
    )
    for file in (inverse, plant):
        known = {each.name: each for each in fmpy.read_model_description(file).modelVariables}
        for name, unit in OF_WINCH.items():
            assert (known[name].causality, known[name].unit or known[name].declaredType.unit) == ("output", unit)
        assert known["M_w.motor_inertia"].causality == "parameter"
    if fmi == 3:
        return
    solution = sc.solve(scene, step=0.01)
    names = ("position", "velocity", "acceleration", "jerk", "snap")
    jets = scene.reference.jet(solution.t, 4).reshape(len(solution.t), -1)
    columns = [f"load.{name}[{k}]" for name in names for k in (1, 2)]
    signals = np.rec.fromarrays([solution.t, *jets.T], names=["time", *columns])
    run = fmpy.simulate_fmu(str(inverse), input=signals, output=list(OF_WINCH), output_interval=0.01, stop_time=3.0)
    for name in OF_WINCH:
        assert np.abs(run[name]).max() == pytest.approx(np.abs(solution[name]).max(), rel=1e-3)


@pytest.mark.usefixtures("empty_folder")
def test_the_file_of_a_data_sheet_gives_the_drives_and_the_command_their_duty() -> None:
    write("drives.toml", SHEET)
    result = line("drives", "overhead_crane", "--drives", "drives.toml")
    assert result.exit_code == 0, result.stderr
    solution = sc.solve(sc.scenes.overhead_crane().with_drives(**DRIVES))
    t, torque = solution.t, solution["M_w.motor_torque"]
    effective = np.sqrt(simpson(torque**2, x=t) / 3.0)
    for shown in (f"{np.abs(torque).max():.4g} N.m", f"{effective:.4g} N.m", "1500 W", "837.8 rad/s"):
        assert shown in result.stdout
    assert f"{100 * (1 - effective / 5):.0f} %" in result.stdout


REFUSALS = {
    ('"125 mm"', '"125 kg"'): "drives.toml: [F]: drum_radius is given in kg, but its unit is m",
    ('"4 kg cm^2"', '"4 N m"'): "drives.toml: [F]: motor_inertia is given in N m, but its unit is kg.m2",
    ('"3000 rpm"', '"3000 m/s"'): "drives.toml: [M_w]: torque_speed, a speed is given in m/s, but its unit is rad/s",
    ('"3000 rpm"', "-1"): "torque_speed, a speed = -1 rad/s is outside its range",
    ('"85 %"', "1.2"): "efficiency = 1.2 1 is outside its range",
    ("rope_falls", "falls"): "drives.toml: [M_w] has no falls; a drive has ratio, rope_falls",
    ("[F]", "[G]"): "has no input G that a drive could act on; it has F, M_w",
    ('drum_radius = "125 mm"', ""): "F is a force: its drive needs drum_radius",
    ("rope_falls = 2", "drum_radius = 1"): "M_w is a torque: its drive has no drum_radius",
    ('["0 rpm", "12 N m"], ', ""): "torque_speed needs two corners or more, at rising speeds from 0 on",
    (SHEET, "F = 3"): "drives.toml: F is no drive: write a table [F]",
}


@pytest.mark.usefixtures("empty_folder")
@pytest.mark.parametrize(("old", "new"), REFUSALS)
def test_wrong_data_are_refused_by_name(old: str, new: str) -> None:
    write("drives.toml", SHEET.replace(old, new, 1))
    line.assert_refused(line("drives", "overhead_crane", "--drives", "drives.toml"), REFUSALS[old, new])


def test_drives_and_effects_go_together_and_drives_can_be_taken_away() -> None:
    crane = driven_crane()
    assert sc.analyse(crane.with_effects("friction", "flexible rail")).index == 7
    assert crane.with_effects("hook").drives == DRIVES
    bare = crane.with_drives(F=None, M_w=None)
    assert not bare.drives
    assert bare.model() is sc.scenes.overhead_crane().model()
    line.assert_refused(line("drives", "overhead_crane"), "overhead_crane has no drives")
    assert "tension" in {each.name for each in compile_plant(crane.model("generalized")).channels}
