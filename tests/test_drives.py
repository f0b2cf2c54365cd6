"""Drives from data sheets: closed forms, balance of power, limits between instants, and where motors are reported."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import fmpy
import numpy as np
import pytest
from browser import Page, require_browser
from command_lines import crane_fmu, write
from command_lines import servocore as line
from fmpy.ssp.simulation import simulate_ssp
from problems import DRIVES, along_its_line, driven_crane
from scipy.integrate import simpson
from thinned import thinned

import servocore as sc
from crane_fmu.build.native import feedback_of
from crane_fmu.run import nothing_left
from servocore.checks.motion_limits import limited_values
from servocore.export.variables import ORDERS
from servocore.model.drives import largest_torque
from servocore.model.limits import Bounds
from servocore.model.parameter_files import read_drives
from servocore.problem import Problem
from servocore.solvers.exact_inversion import prepared_motion

pytestmark = pytest.mark.usefixtures("empty_folder")
ARM = Path(__file__).parent / "mechanisms" / "arm.urdf"
SHEET = """
F = {ratio = 25, drum_radius = "125 mm", motor_inertia = "4 kg cm^2", viscous = 2e-4, coulomb = 0.02}
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
OF_WINCH = {"M_w.motor_torque": "N.m", "M_w.motor_speed": "rad/s", "M_w.power": "W", "M_w.current": "A"}
OF_WINCH |= {"M_w.torque_reserve": "N.m"}
OF_RUN = {"M_w.energy": "J", "M_w.rms_torque": "N.m"}
REFLECTED = {"M_w": ("winch_inertia", 40**2 * 5e-4), "M_b": ("bridge_inertia", 90**2 * 0.012)}
REFLECTED |= {"F": ("trolley_mass", (30 / 0.2) ** 2 * 1e-3)}
LIKE = {  # drives whose inertia acts as that of a part, by crane; a trolley that moves with its bridge is no such part
    "rotary_crane": {"M_w": sc.Drive(20, 2, motor_inertia=5e-4), "M_b": sc.Drive(90, motor_inertia="120 kg cm^2")},
    "overhead_crane": {"M_w": sc.Drive(20, 2, motor_inertia=5e-4), "F": sc.Drive(30, 1, 0.2, motor_inertia=1e-3)},
    "gantry_crane": {"M_w": sc.Drive(40, motor_inertia=5e-4)},
}


@pytest.mark.parametrize("name", LIKE)
def test_a_crane_with_drives_is_the_crane_with_their_reflected_inertia(name: str) -> None:
    """To 1e-12 of the peaks, by every model."""
    bare = sc.scenes.REGISTRY[name]()
    parts = dict(REFLECTED[each] for each in LIKE[name])
    same = bare.with_parameters(**{part: bare.parameter_values()[part] + more for part, more in parts.items()})
    for model in bare.models:
        found = sc.solve(bare.with_drives(**LIKE[name]), step=bare.reference.duration / 40, model=model)
        for each, expected in same.exact(found.t).items():
            np.testing.assert_allclose(found[each], expected, rtol=0.0, atol=1e-12 * max(1.0, np.abs(expected).max()))


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
    for state in prepared_motion(problem).at(np.linspace(0.2, 2.8, 21)).T:
        motion = [[state[array.position(f"q.{name}", k)] for name in system.coordinates.names] for k in range(3)]
        u = [state[array.position(f"u.{each.name}", 0)] for each in system.inputs]
        power, change, lost = np.asarray(balance(*motion, u, problem.p)).ravel()
        assert lost > 0.0
        assert power == pytest.approx(change + lost, abs=1e-12 * 5e3)  # of the peak


def test_energies_are_the_integrals_of_powers_and_losses_of_the_gear_count_by_the_direction_of_power() -> None:
    hoist = sc.Drive(ratio=24, motor_inertia=3e-4)
    scene = sc.scenes.overhead_crane().with_drives(M_w=hoist, F=sc.Drive(drum_radius=0.1))
    for solution in (found := sc.solve(scene, step=0.005), sc.simulate(scene, found)):
        energy = solution["M_w.energy"][-1] + solution["F.energy"][-1]
        assert energy == pytest.approx(100.0 * 9.81 * 3.0, rel=1e-6)  # the load is lifted by 3 m
    lossy = sc.solve(scene.with_drives(M_w=replace(hoist, efficiency=0.8)), step=0.005)
    np.testing.assert_array_equal(lossy["M_w"], found["M_w"])
    fast = np.abs(found["M_w.motor_speed"]) > 5.0
    expected = np.where(found["M_w.power"] > 0.0, 1 / 0.8, 0.8) * found["M_w.motor_torque"]
    np.testing.assert_allclose(lossy["M_w.motor_torque"][fast], expected[fast], rtol=1e-6)


STEPS = [((0, 120), (150, 120), (155, 60), (250, 60)), ((0, 20), (300, 20), (300.1, 0))]


@pytest.mark.parametrize(
    "curve", [((0, 30), (314, 30)), ((0, 20), (100, 50), (150, 30), (300, 12), (301, 0)), *STEPS], ids=str
)
def test_smooth_torque_speed_curves_are_near_those_of_the_sheet_and_never_above(curve: Sequence[Any]) -> None:
    speed, most = ca.SX.sym("speed"), float(curve[-1][0])
    smooth = ca.Function("smooth", [speed], [largest_torque(sc.Drive(torque_speed=curve), speed)])
    at = np.linspace(-most, most, 4001)
    sheet, found = np.interp(np.abs(at), *np.array(curve).T), np.asarray(smooth(at)).ravel()
    across, down = np.diff(np.array([*curve, (1.05 * most, 0.0)]), axis=0).T
    assert (found < sheet).all()
    assert (found > sheet - min(1.1e-3 * most * np.abs(np.diff(down / across)).max(), 0.03 * sheet.max())).all()
    assert float(smooth(1.05 * most)) < 0.0


@pytest.mark.parametrize("seed", thinned(range(12), lambda seed: seed == 1))
def test_plans_keep_torque_speed_curves_of_random_drives_between_all_instants(seed: int) -> None:
    draw, bare = np.random.default_rng(seed), sc.scenes.REGISTRY[list(LIKE)[seed % 3]]()
    slow = sc.solve(along_its_line(bare, 30.0))
    drives = {}
    for each in bare.model().inputs:
        n = draw.uniform(10.0, 60.0)
        torque = draw.uniform(1.5, 3.0) * np.abs(slow[each.name]).max() / n
        speeds, torques = np.cumsum(draw.uniform(0.3, 1.0, 3)) * n, torque * np.sort(draw.uniform(0.5, 1.2, 3))[::-1]
        curve = [(0.0, torque), *zip(speeds, torques, strict=True)]
        drives[each.name] = sc.Drive(
            n, 1, 1.0 if each.unit == "N" else None, draw.uniform(0.0, 20.0) / n**2, draw.uniform(0.8, 1.0),
            draw.uniform(0.0, 1.0) / n**2, 0.02 * torque, torque_speed=curve,
        )  # fmt: skip
    crane = bare.with_drives(**drives).with_limits(**{f"{name}.torque_reserve": (0.0, None) for name in drives})
    plan, report = sc.fastest(crane, bare.reference.jet([0.0, bare.reference.end_time], 0)[:, 0], intervals=40)
    assert report.limits.evidence == "proved to be kept at all times"
    problem = Problem.of(crane.with_reference(plan))
    t = np.linspace(plan.start_time, plan.end_time, 50_001)
    reserves = limited_values(prepared_motion(problem), t)
    peaks = np.array([[max(torque for _, torque in drive.torque_speed)] for drive in drives.values()])
    assert -1e-9 < (reserves / peaks).min() < 0.02  # one of them is used up
    with pytest.raises(sc.LimitBroken, match="torque_reserve goes beyond its lower limit of 0 N"):
        sc.solve(along_its_line(crane, report.duration))


RUN_LIMITS: dict[str, Bounds] = {"F.rms_torque": "0.9 N m", "M_w.energy": "4 kJ"}


def test_limits_of_energy_and_effective_torque_hold_for_the_run_as_a_whole(tmp_path: Path) -> None:
    crane, fmu = driven_crane(), tmp_path / "crane.fmu"
    for use in (sc.solve, sc.ExactInversion, partial(sc.export_fmu, path=fmu), partial(sc.export_trajectory, path=fmu)):
        with pytest.raises(sc.LimitBroken, match=r"F.rms_torque goes .* upper limit of 0.9 N m;.*over the whole run"):
            use(crane.with_limits(**RUN_LIMITS))
    assert not fmu.exists()
    with pytest.raises(sc.LimitBroken, match=r"M_w.energy goes beyond its lower limit"):
        sc.solve(crane.with_limits(**{"M_w.energy": ("5 kJ", None)}))
    margin = sc.solve(crane.with_limits(**{"M_w.energy": "5 kJ"})).margins["M_w.energy"]
    assert (margin.time, margin.bound) == (3.0, 5e3)


def test_the_shortest_duration_keeps_limits_of_the_run_as_a_whole() -> None:
    crane = driven_crane().with_limits(**{"F.rms_torque": "0.9 N m"})
    shortest = sc.shortest_duration(crane)
    sc.solve(along_its_line(crane, shortest))
    with pytest.raises(sc.LimitBroken, match="over the whole run"):
        sc.solve(along_its_line(crane, 0.999 * shortest))
    with pytest.raises(sc.PlanningFailed, match="no duration was found"):  # less than what the weight of the load takes
        sc.shortest_duration(crane.with_limits(**{"M_w.energy": "0.1 kJ"}))


@pytest.mark.nightly
def test_plans_keep_limits_of_the_run_as_a_whole() -> None:
    crane = driven_crane()
    plan, report = sc.fastest(
        crane, crane.reference.jet([0.0, 3.0], 0)[:, 0], {**RUN_LIMITS, "F": 1000.0}, intervals=40
    )
    assert report.limits.evidence == "proved to be kept at all times"
    assert "F.rms_torque" in {each.quantity for each in report.active}
    assert report.duration < 0.85 * report.degree9  # which needs much torque in its middle
    found = sc.solve(crane.with_reference(plan).with_limits(**RUN_LIMITS), step=plan.duration / 2000)
    assert 0.89 < found["F.rms_torque"][-1] <= 0.9


@pytest.mark.parametrize("name", ["M_w.energy", "F.rms_torque", "M_w.rms_torque"])
def test_a_certificate_encloses_energies_and_effective_torques(name: str) -> None:
    value = float(sc.solve(driven_crane(), step=0.001)[name][-1])
    bounds: Bounds
    for bounds, verdict in ((1.01 * value, "proved"), (0.99 * value, "refuted"), ((1.01 * value, None), "refuted")):
        statements = {each.what: each for each in sc.certify(driven_crane(), {name: bounds}).statements}
        assert statements[f"limit of {name}"].verdict == verdict
    assert sc.certify(driven_crane(), {name: 1.1 * value}, {"load_mass": (99.0, 101.0)}).verdict == "proved"


def test_a_certificate_proves_the_limits_of_the_motors() -> None:
    limits: dict[str, Bounds] = {"M_w.torque_reserve": (0.0, None), "M_w.motor_speed": "8000 rpm"}
    limits |= {"M_w.power": "5 kW", "M_w.current": 12.0, "M_w.motor_torque": "9 N m"}
    found = {each.what: each.verdict for each in sc.certify(driven_crane(), limits).statements}
    assert {found[f"limit of {name}"] for name in limits} == {"proved"}
    assert sc.certify(driven_crane(), {"M_w.current": 5.0}).verdict == "refuted"


def test_tables_sweeps_and_pages_have_the_quantities_of_the_motors_with_units(tmp_path: Path) -> None:
    limits: dict[str, Bounds] = {"M_w.current": 12.0, "M_w.energy": "5 kJ", "F.energy": 500.0}  # 800 J on the way
    scene = driven_crane().with_limits(**limits)
    solution = sc.solve(scene)
    assert {name: solution.unit(name) for name in OF_WINCH | OF_RUN} == OF_WINCH | OF_RUN
    solution.to_csv(tmp_path / "run.csv")
    assert (tmp_path / "run.csv").read_text().startswith(",".join(("time", *solution.names)))
    swept = sc.sweep(scene, {"load_mass": [80.0, 100.0], "M_w.ratio": [12.0, 14.0]}, instants=201)
    for name, unit in OF_WINCH.items():
        assert swept[f"peak_{name}"].attrs["units"] == unit
        assert float(swept[f"peak_{name}"][1, 0]) == pytest.approx(np.abs(solution[name]).max(), rel=1e-9)
    for name, unit in OF_RUN.items():
        assert swept[name].attrs["units"] == unit
        assert float(swept[name][1, 0]) == pytest.approx(solution[name][-1], rel=1e-3)
    assert float(swept["margin_M_w.energy"][1, 0]) == pytest.approx(5e3 - float(swept["M_w.energy"][1, 0]))
    assert float(swept["margin_M_w.current"][1, 0]) == pytest.approx(12.0 - np.abs(solution["M_w.current"]).max())
    page = (file := sc.view(solution, tmp_path / "page.html")).read_text()
    assert '"low":-5000.0,"high":5000.0,"rate":false}' in page
    for name, unit in (OF_WINCH | OF_RUN).items():
        assert json.dumps({"name": name, "unit": unit}, separators=(",", ":"))[1:-1] in page
    require_browser()
    with Page(file, tmp_path / "profile") as opened:
        assert opened.run('document.querySelector(".status").textContent') == "All limits are kept."


both_kinds = pytest.mark.parametrize("export", [sc.export_fmu, sc.export_plant])


@both_kinds
@pytest.mark.parametrize("fmi", [2, 3])
def test_both_kinds_of_fmus_have_them_as_outputs(tmp_path: Path, export: Callable[..., Path], fmi: int) -> None:
    units_of = OF_WINCH | OF_RUN
    file = export(driven_crane(), tmp_path / "a.fmu", fmi=fmi, targets="none")
    known = {each.name: each for each in fmpy.read_model_description(file).modelVariables}
    assert units_of == {name: known[name].unit or known[name].declaredType.unit for name in units_of}
    assert {known[name].causality for name in units_of} == {"output"}
    assert known["M_w.motor_inertia"].causality == "parameter"
    jets = 10 if fmi == 2 else 5  # arrays of two
    assert [each.causality for each in known.values()].count("input") == (jets if export is sc.export_fmu else 2)


@both_kinds
def test_outputs_of_both_kinds_of_fmus_are_those_of_solve(tmp_path: Path, export: Callable[..., Path]) -> None:
    units_of, inverse = OF_WINCH | OF_RUN, export is sc.export_fmu
    scene = driven_crane().with_limits(**{"M_w.energy": "5 kJ"})
    file = export(scene, tmp_path / "2.fmu", fmi=2, targets="host")
    found = sc.solve(driven_crane(), step=0.005)
    jet = scene.reference.jet(found.t, 4).reshape(len(found.t), -1).T
    names = [f"load.{order}[{k}]" for order in ORDERS[:5] for k in (1, 2)] if inverse else ["F", "M_w"]
    columns = jet if inverse else [found["F"], found["M_w"]]
    table = np.rec.fromarrays([found.t, *columns], dtype=[(name, float) for name in ("time", *names)])
    said = list[str]()
    simulated = partial(
        fmpy.simulate_fmu, str(file), stop_time=3.0, output_interval=0.005, input=table,
        output=[*units_of], logger=lambda *each: said.append(each[-1].decode()), debug_logging=True,
    )  # fmt: skip
    run = simulated(start_values={"input_time": 2})
    assert said == []
    simulated(start_values={"input_time": 2, "load_mass": 150.0})
    assert said == ["at t = 3 s M_w.energy is 5772 J, it must stay below 5000 J"] * inverse
    for name in units_of:
        within = 1e-3 if inverse else 2e-3  # tanh turns within a step or two
        assert run[name][-1] == pytest.approx(found[name][-1], rel=within, abs=within * np.abs(found[name]).max()), name


M_B = 'M_b = {ratio = 120, motor_inertia = "0.012 kg m^2", coulomb = "0.15 N m", viscous = 1e-3, efficiency = "90 %"}'
SHEET_OF_CRANE, CRANE = M_B + SHEET, sc.scenes.rotary_crane()


def test_the_feedback_of_a_crane_with_drives_returns_exact_inputs_where_the_load_is_on_its_path() -> None:
    write("drives.toml", SHEET_OF_CRANE)
    crane = CRANE.with_drives(**read_drives("drives.toml", CRANE))
    laws, h, times = feedback_of(crane).laws, 0.01, np.array([8.0, 8.01])
    motion, p = sc.solve(crane, step=h), Problem.of(crane).p
    jets = crane.reference.jet(times, 4).reshape(2, -1)
    at = round(8.0 / h)
    rates = [(motion[name][at + 1] - motion[name][at - 1]) / (2 * h) for name in ("phi", "s", "l")]
    measured = [*(motion[name][at] for name in ("phi", "s", "l")), *rates, *jets[0, :6]]
    now, then = (np.array([motion[name][k] for name in ("M_b", "F", "M_w")]) for k in (at, at + 1))
    limits = np.full(3, 1e9)
    memory = laws["begin_end"](jets[0], measured, p, h)
    _, inputs = laws["feedback_end"](memory, jets[1], jets[0], measured, now, then, p, h, 1.0, limits)
    np.testing.assert_allclose(np.asarray(inputs).ravel(), then, rtol=0, atol=1e-3 * np.abs(then).max())


@pytest.mark.nightly
@pytest.mark.parametrize("native", [False, True], ids=["Python", "native"])
def test_feedback_keeps_the_load_of_a_crane_with_drives_on_its_path(native: bool) -> None:
    write("drives.toml", SHEET_OF_CRANE)
    words = ("--drives", "drives.toml", "--targets", "host", "-o", "system")
    result = crane_fmu("ssp", *words, *["--native"] * native)
    assert result.exit_code == 0, result.stderr
    with nothing_left():
        rows = simulate_ssp("system/Crane.ssp", stop_time=20.0, step_size=0.01)
    wanted, found = (np.array([rows[f"{of}.load.position[{k}]"] for k in (1, 2, 3)]) for of in ("trajectory", "plant"))
    assert np.linalg.norm(wanted - found, axis=0).max() < 1e-6
    solution = sc.solve(CRANE.with_drives(**read_drives("drives.toml", CRANE)), step=0.01)
    for name in ("M_b.energy", "F.energy", *OF_RUN):
        for part in ("crane", "plant"):
            assert rows[f"{part}.{name}"][-1] == pytest.approx(solution[name][-1], rel=2e-4), name


def test_the_file_of_a_data_sheet_gives_the_drives_and_the_command_their_duty() -> None:
    write("drives.toml", SHEET)
    result = line("drives", "overhead_crane", "--drives", "drives.toml")
    assert result.exit_code == 0, result.stderr
    solution = sc.solve(sc.scenes.overhead_crane().with_drives(**DRIVES))
    torque = solution["M_w.motor_torque"]
    effective = np.sqrt(simpson(torque**2, x=solution.t) / 3.0)
    for shown in (f"{np.abs(torque).max():.4g} N.m", f"{effective:.4g} N.m", "1500 W", "837.8 rad/s"):
        assert shown in result.stdout
    assert f"{100 * (1 - effective / 5):.0f} %" in result.stdout


def test_paths_that_excite_data_of_drives_keep_limits_of_motors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("servocore.identification.excitation._TRIALS", 0)
    crane = sc.scenes.overhead_crane().with_drives(**DRIVES)
    _, report = sc.excitation(crane, "F.motor_inertia", {"F": 1000.0, "M_w.energy": "9 kJ"}, duration=8.0)
    assert report.limits.violation == 0.0


def test_data_of_drives_are_identified_and_read_as_other_parameters() -> None:
    crane = sc.scenes.overhead_crane().with_drives(**DRIVES)
    log = sc.measured(crane, plant=crane.with_parameters(**{"F.motor_inertia": 5e-4}), seed=1)
    found = sc.identify(crane, log, "F.motor_inertia")
    assert found.values["F.motor_inertia"] == pytest.approx(5e-4, rel=0.02)
    write("drives.toml", SHEET)
    write("identified.toml", found.parameter_file())
    assert not line("drives", "overhead_crane", "--drives", "drives.toml", "--parameters", "identified.toml").exit_code


@pytest.mark.parametrize("command", ["import", "drives"])
def test_drives_of_a_robot_file_have_the_names_of_its_inputs(command: str) -> None:
    write("drives.toml", "[elbow.torque]\nratio = 100")
    write("parameters.toml", "elbow.torque.ratio = 90")
    result = line(command, ARM, "--drives", "drives.toml", "--parameters", "parameters.toml")
    assert result.exit_code == 0, result.stderr
    assert "elbow.torque" in result.stdout


REFUSALS = {
    ('"125 mm"', '"125 kg"'): "drives.toml: [F]: drum_radius is given in kg, but its unit is m",
    ('"4 kg cm^2"', '"4 N m"'): "drives.toml: [F]: motor_inertia is given in N m, but its unit is kg.m2",
    ('"3000 rpm"', '"3000 m/s"'): "drives.toml: [M_w]: torque_speed, a speed is given in m/s, but its unit is rad/s",
    ('"3000 rpm"', "-1"): "torque_speed, a speed = -1 rad/s is outside its range",
    ('"85 %"', "1.2"): "efficiency = 1.2 is outside its range [0.001, 1]",
    ("rope_falls", "falls"): "drives.toml: [M_w] has no falls; a drive has ratio, rope_falls",
    ("F =", "G ="): "has no input G that a drive could act on; it has F, M_w",
    ('drum_radius = "125 mm", ', ""): "F is a force: its drive needs drum_radius",
    ("rope_falls = 2", "drum_radius = 1"): "M_w is a torque: its drive has no drum_radius",
    ('["0 rpm", "12 N m"], ', ""): "torque_speed needs two corners or more, at rising speeds from 0 on",
    ("12 N m", "12,5 N m"): "drives.toml: [M_w]: torque_speed, a torque is given as '12,5 N m', which is no number",
    ('[["0 rpm", "12 N m"], ["3000 rpm", 11], ["8000 rpm", 9]]', "[[0, 0], [9, 0]]"): "not all with torque 0",
    (SHEET, ""): "drives.toml has no drive: write a table for each input",
    (SHEET, "F = 3"): "drives.toml: F is no drive: write a table [F]",
    (SHEET, "ratio = 3"): "drives.toml: ratio is no drive: write ratio in the table of its input, as in [M_b]",
    (SHEET, "[F]"): "drives.toml: F is no drive: write a table [F] with lines such as",
    (SHEET, "[M_w.motor]\ninertia = 1"): "has no input M_w.motor that a drive could act on; it has F, M_w",
}


@pytest.mark.parametrize(("old", "new"), REFUSALS)
def test_wrong_data_are_refused_by_name(old: str, new: str) -> None:
    write("drives.toml", SHEET.replace(old, new, 1))
    line.assert_refused(line("drives", "overhead_crane", "--drives", "drives.toml"), REFUSALS[old, new])


@pytest.mark.parametrize("data", [{"ratio": None}, {"ratio": 0}, {"torque_speed": 5}, {"torque_speed": [(0, 1, 2)]}])
def test_values_that_are_none_are_refused_by_name(data: dict[str, Any]) -> None:
    with pytest.raises(sc.InvalidModel, match=next(iter(data))):
        sc.Drive(**data)


def test_drives_and_effects_go_together_and_drives_can_be_taken_away() -> None:
    crane = driven_crane()
    assert sc.analyse(crane.with_effects("friction", "flexible rail")).index == 7
    assert crane.with_effects("hook").drives == DRIVES
    assert crane.with_drives(F=None, M_w=None).model() is sc.scenes.overhead_crane().model()
    with pytest.raises(sc.InvalidModel, match="has no input M_q that a drive could act on; it has F, M_w"):
        crane.with_drives(M_q=None)
    line.assert_refused(line("drives", "overhead_crane"), "overhead_crane has no drives")
