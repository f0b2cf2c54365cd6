"""Parameters from logs, exciting paths and synthetic logs; `make identification` runs the study."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_lines import CommandLine
from problems import as_scene

import servocore as sc
from benchmarks.identification import study
from benchmarks.identification.cranes import KINDS, changed
from benchmarks.identification.page import page
from servocore.cli.commands import app
from servocore.effects.closed_loop import run_loop
from servocore.identification.followed import followed
from servocore.identification.prediction import Prediction
from servocore.identification.splines import PathSpline
from servocore.model.system import reference_symbols
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem

NAMES = ("trolley_mass", "load_mass", "winch_inertia", "winch_friction")
TRUE = {"load_mass": 110.0, "trolley_mass": 12.0, "winch_friction": 35.0}
CRANE = sc.scenes.overhead_crane().with_effects("friction")
REAL = CRANE.with_parameters(**TRUE)
LIVELY = sc.through([[0.0, -4.0], [3.0, -2.5], [1.0, -5.0], [4.0, -3.0], [0.0, -4.0]], duration=12.0)
JOB = sc.rest_to_rest((0.0, -4.0), (5.0, -1.0), 8.0)
ESTIMATED = ("--effects", "friction", "--estimate", ",".join(NAMES))
Columns = dict[str, Array]
run = CommandLine(app, "servocore")


@cache
def log() -> dict[str, Array]:
    return sc.measured(CRANE.with_reference(JOB), plant=REAL, seed=3)


@cache
def found() -> sc.Identified:
    return sc.identify(CRANE, log(), NAMES, jobs=[JOB])


def z_scores(result: sc.Identified, scene: sc.Scene) -> Array:
    true = scene.parameter_values()
    return np.array([(result.values[name] - true[name]) / result.standard_errors[name] for name in result.names])


def test_estimates_lie_within_their_standard_errors_where_believed_values_do_not() -> None:
    result = found()
    assert np.abs(z_scores(result, REAL)).max() < 4.0
    assert all(0.0 < error < 0.05 * TRUE.get(name, 10.8) for name, error in result.standard_errors.items())
    assert not result.doubts
    assert not result.unidentifiable
    assert max(result.prior_share.values()) < 0.1
    assert "noise" in result.verdict
    assert result.effects["winch_friction"] > 2.8
    assert abs(result.delays["F"][0]) < 0.002
    assert set(result.biases) == {"F", "M_w"}
    stray = result.stray(JOB)
    assert 0.0 < stray.by_parameters <= stray.total < 20.0
    assert f"{stray.total:.2g} mm" in result.verdict


@pytest.mark.parametrize("gap", [False, True])
def test_logs_may_begin_in_motion_and_have_gaps(gap: bool) -> None:
    t = log()["time"]
    kept = {name: column[t > 3.0] for name, column in log().items()}
    missing = {name: np.where((name != "time") & (t > 3.0) & (t < 3.4), np.nan, each) for name, each in log().items()}
    assert np.abs(z_scores(sc.identify(CRANE, missing if gap else kept, NAMES), REAL)).max() < 5.0


@pytest.mark.parametrize(
    ("path", "step"), [(LIVELY, 0.005), (sc.through([[0.0, -4.0], [3.0, -2.5], [1.0, -5.0]], duration=6.0), 0.01)]
)
def test_several_coarse_logs_are_one_fit_with_delays_of_their_own(path: sc.Reference, step: float) -> None:
    coarse = [
        sc.measured(CRANE.with_reference(path), plant=REAL, seed=k, step=step, resolution=2e-4, delay=0.004 * k,
                    outliers=0.01, missing=0.03)
        for k in (1, 2)
    ]  # fmt: skip
    result = sc.identify(CRANE, coarse, NAMES)
    assert np.abs(z_scores(result, REAL)).max() < 5.0
    assert result.delays["F"][1] - result.delays["F"][0] == pytest.approx(0.004, abs=0.002)


def test_what_a_log_cannot_show_is_named_and_stays_as_believed() -> None:
    lift = sc.rest_to_rest((1.0, -4.0), (1.0, -3.0), 8.0)
    result = sc.identify(CRANE, sc.measured(CRANE.with_reference(lift), plant=REAL, seed=1), NAMES)
    assert any("trolley_mass" in sentence and "would show it" in sentence for sentence in result.unidentifiable)
    assert result.values["trolley_mass"] == pytest.approx(10.0, rel=0.01)
    assert result.prior_share["trolley_mass"] > 0.95


def test_quick_reversals_of_a_drive_do_not_pass_for_noise_of_its_input() -> None:
    row = study.attempted(study.Case("overhead_crane", "A", 1016))
    assert not row.doubts
    assert np.abs(row.z).max() < 4.0
    assert np.abs(np.divide(row.errors, row.bounds)).max() < 4.0


def test_a_wrong_model_and_a_log_without_noise_are_told_apart() -> None:
    coarse = {name: each[::10] for name, each in log().items()}
    with pytest.warns(sc.errors.ServocoreWarning, match="^the model does not explain F.*model does not explain M_w"):
        assert sc.identify(sc.scenes.overhead_crane(), coarse, NAMES[:3]).doubts
    run = sc.solve(REAL.with_reference(LIVELY), step=0.002)
    exact = {"time": run.t, **{name: run[name] for name in ("F", "M_w", "s", "l")}}
    with pytest.warns(sc.errors.ServocoreWarning, match="^F is logged without noise[^;]*; M_w is logged with[^;]*$"):
        assert sc.identify(CRANE, exact, NAMES).doubts


@pytest.mark.parametrize(("duration", "step"), [(8.0, 0.01), (12.0, 0.005)])
def test_splines_that_bend_no_better_than_an_exact_log_leave_the_fit_where_it_was(duration: float, step: float) -> None:
    """Finer ones led to a fifth of every inertia in the longer log, and the unit of F was blamed."""
    crane = sc.scenes.rotary_crane().with_reference(sc.rest_to_rest((5, 0, -5), (3, 3, -3), duration))
    run = sc.solve(crane.with_parameters(load_mass=107.0), step=step)
    exact = {"time": run.t, **{name: run[name] for name in ("M_b", "F", "M_w", "phi", "s", "l")}}
    with pytest.warns(sc.errors.ServocoreWarning, match="M_b is logged without noise"):
        found = sc.identify(crane, exact, ["bridge_inertia", "load_mass"])
    assert [*found.values.values()] == pytest.approx([480.0, 107.0], rel=1e-4)


def test_friction_of_another_kind_is_noticed_where_noise_hides_it_from_correlations() -> None:
    assert max(by_speed for *_, by_speed in found().whiteness.values()) < 20.0
    noisy = sc.measured(CRANE.with_reference(JOB), plant=changed(REAL, "Stribeck"), seed=3, noise=0.02, step=0.004)
    with pytest.warns(sc.errors.ServocoreWarning, match="depend on the speed of l .* friction is of another kind"):
        sc.identify(CRANE, noisy, [*NAMES, "trolley_friction"])


def test_an_axis_of_a_users_own_is_identified_from_a_file_with_its_offset(tmp_path: Path) -> None:
    real = axis().with_parameters(mass=23.0, dry=7.0, viscous=31.0, offset=3.1)
    columns = sc.measured(axis(), plant=real, drives=("x",), step=0.001, bias=0.0)
    rows = np.column_stack(list(columns.values()))
    rows[:, 2] *= 1e3
    rows[::997, 2] = 1e9  # dropouts of an encoder are no millimetres
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="time,F [N],x [mm]", comments="")
    result = sc.identify(axis(), tmp_path / "log.csv", "*", bias=0.0)
    assert np.abs(z_scores(result, real)).max() < 4.0
    assert result.standard_errors["offset"] < 0.1
    assert abs(result.biases["F"][0]) < 1e-6
    of_any_sensor = sc.identify(axis(), tmp_path / "log.csv", "*")  # its bias may be the offset
    assert any("offset" in sentence for sentence in of_any_sensor.unidentifiable)


def axis() -> sc.Scene:
    """A mass on a rail with viscous and dry friction and a constant force."""
    import casadi as ca

    values = (("mass", 20.0, "kg"), ("dry", 9.0, "N"), ("viscous", 25.0, "N.s/m"), ("offset", 2.5, "N"))
    p = sc.Parameters(*(sc.Parameter(*each, 0.0) for each in values))
    c = sc.Coordinates(sc.Quantity("x", "m"))
    gamma = reference_symbols(1)
    system = sc.MechanicalSystem(
        "axis", c, p, (sc.Quantity("F", "N"),), (sc.Quantity("x", "m"),), mass=p["mass"], output=c.q,
        input_matrix=ca.SX(-1), force=-p["dry"] * ca.tanh(c.v / 0.01) - p["viscous"] * c.v - p["offset"],
        guess=gamma[0, 0], gamma=gamma,
    )  # fmt: skip
    return as_scene(system, sc.through([[0.0], [0.6], [0.1], [0.9], [0.0]], [0, 5, 11, 16, 25]))


WITH_INTERNAL_DYNAMICS: dict[str, tuple[tuple[str, ...], dict[str, float]]] = {
    "mass_on_car": (("x", "s"), {"car_mass": 1.2, "mass": 2.3, "stiffness": 4.4, "damping": 1.2}),
    "passive_joint_arm": (("a", "b"), {"second_mass": 3.4, "joint_damping": 1.3, "first_inertia": 1.1}),
}


def identified(kind: str) -> tuple[sc.Identified, sc.Scene]:
    """Return what a log that begins in motion shows of a scene with internal dynamics, and its plant."""
    measured, true = WITH_INTERNAL_DYNAMICS[kind]
    scene = sc.scenes.REGISTRY[kind]()
    path = sc.through([[0.0], [1.0], [0.2], [1.5], [0.0], [0.7], [0.0]], duration=10.0)
    moved, real = (each.with_reference(path) for each in (scene, scene.with_parameters(**true)))
    run = sc.simulate(real, inputs=sc.solve(moved))
    t = np.arange(2.0, 10.0, 0.005)
    noise = np.random.default_rng(0).standard_normal(len(t))
    known = {name: np.round(np.interp(t, run.t, run[name]), 5) for name in measured}
    columns = {"time": t, "u": np.interp(t, run.t, run["u"]) + 0.01 * np.ptp(run["u"]) * noise + 0.3, **known}
    return sc.identify(scene, columns, list(true)), real


@pytest.mark.parametrize("kind", WITH_INTERNAL_DYNAMICS)
def test_internal_dynamics_are_channels_of_their_own(kind: str) -> None:
    result, real = identified(kind)
    assert not result.doubts
    assert np.abs(z_scores(result, real)).max() < 4.0
    assert max(result.standard_errors[name] / result.values[name] for name in result.names) < 0.1


@pytest.mark.parametrize("kind", WITH_INTERNAL_DYNAMICS)
def test_plants_with_parameters_drawn_from_the_estimates_stay_within_the_predicted_stray(kind: str) -> None:
    result, real = identified(kind)
    job, drive = sc.rest_to_rest((0.0,), (1.0,), 3.0), WITH_INTERNAL_DYNAMICS[kind][0][:1]
    motion, stray = followed(result.scene().with_reference(job), drive, 501), result.stray(job)

    def strayed(plant: sc.Scene) -> float:
        run = run_loop(followed(plant.with_reference(job), drive, 501), motion, motion.gains(result.loops))
        return 1e3 * run.error

    assert strayed(real) <= stray.total
    drawn = np.random.default_rng(5).multivariate_normal(list(result.values.values()), result.covariance, 40)
    named = (dict(zip(result.names, values.tolist(), strict=True)) for values in drawn)
    strays = np.array([strayed(real.with_parameters(**values)) for values in named])
    assert np.mean(strays <= stray.by_parameters) >= 0.87
    assert float(np.quantile(strays, 0.95)) == pytest.approx(stray.by_parameters, rel=0.4)


def test_a_plant_whose_internal_dynamics_are_unstable_is_driven_from_before_its_path() -> None:
    job = sc.rest_to_rest((0.0,), (1.0,), 3.0)
    arm = sc.scenes.passive_joint_arm().with_parameters(tracked_distance=1.0).with_reference(job)
    motion = followed(arm, ("a",), 201)
    assert motion.t[0] < -1.0
    assert run_loop(motion, motion, motion.gains(sc.PositionLoops())).error < 1e-6
    wrong = followed(arm.with_parameters(second_mass=3.3), ("a",), 201)
    assert 1e-4 < run_loop(wrong, motion, motion.gains(sc.PositionLoops())).error < 0.1


BAD: dict[str, tuple[str, Callable[[Columns], Columns | list[Columns]]]] = {
    "twice": ("^log 1 and log 2 hold the same samples", lambda c: [c, c]),
    "too short": ("is too short", lambda c: {k: v[:500] for k, v in c.items()}),
    "constant": ("is 0 throughout", lambda c: {**c, "F": 0 * c["F"]}),
    "saturated": ("is saturated", lambda c: {**c, "F": np.clip(c["F"], -5, 5)}),
    "nan": ("has no value", lambda c: {**c, "F": np.where(c["time"] < 5, np.nan, c["F"])}),
    "time": ("not later", lambda c: {**c, "time": c["time"][::-1]}),
    "milliseconds": ("every 2 s", lambda c: {**c, "time": 1e3 * c["time"]}),
    "millimetres": ("looks like mm", lambda c: {**c, "s": 1e3 * c["s"]}),
    "missing": ("no column of the input F", lambda c: {k: v for k, v in c.items() if k != "F"}),
    "few": ("as many positions as inputs", lambda c: {k: v for k, v in c.items() if k != "l"}),
    "still": ("nothing moves", lambda c: {**c, "s": 0 * c["s"], "l": 0 * c["l"] + 1}),
    "clocks": ("clocks", lambda c: {**c, "F": np.roll(c["F"], 150), "M_w": np.roll(c["M_w"], 150)}),
    "newtons": (r"F changes by 0\..* N, .* unit", lambda c: {**c, "F": 1e-3 * c["F"]}),
    "kilonewtons": ("unit", lambda c: {**c, "F": 1e3 * c["F"]}),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_log_is_refused_by_one_sentence(kind: str) -> None:
    words, spoil = BAD[kind]
    with pytest.raises(sc.errors.InvalidReference, match=words) as refusal:
        sc.identify(CRANE, spoil(dict(log())), NAMES)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("wrong", [{"jobs": JOB}, {"jobs": [3]}, {"loops": 6.0}, {"parameters": None}, {"believed": 2}])
def test_arguments_of_another_kind_are_refused(wrong: Any) -> None:
    with pytest.raises(sc.ServocoreError, match="must be"):
        sc.identify(CRANE, log(), **{"parameters": NAMES} | wrong)


@pytest.mark.usefixtures("empty_folder")
def test_the_command_writes_files_and_page_of_the_result() -> None:
    result = found()
    rows, head = np.column_stack([*log().values()]), ",".join(log())
    np.savetxt("log.csv", rows, "%.17g," * 5 + "ok", header=f"{head},note", comments="")
    Path("job.csv").write_text(sc.path_to_csv(JOB, ("x", "z")))
    files = ("--job", "job.csv", "-o", "found.toml", "--page", "found.html")
    assert run("identify", "overhead_crane", "log.csv", *files, *ESTIMATED).stdout == f"{result}\n"
    assert Path("found.toml").read_text() == result.parameter_file().replace("the log", "log.csv")
    assert result.scene().parameter_values()["load_mass"] == pytest.approx(result.values["load_mass"])
    assert Path("found.covariance.csv").read_text() == result.covariance_file()
    assert len(result.covariance_file().splitlines()) == 1 + len(NAMES)
    html = Path("found.html").read_text()
    assert html.count("<svg") == 1
    assert "load_mass" in html


def test_derivatives_of_channels_are_those_of_their_values() -> None:
    for effects in (["friction"], ["friction", "air drag"]):  # by expression, and by Newton's method
        problem = Problem.of(sc.scenes.overhead_crane().with_effects(*effects))
        prediction = Prediction(problem.resolved, ("s", "l"), (0, 1), 2)
        jets = problem.reference.jet(np.linspace(0.5, 2.5, 20), 4)
        random, h = np.random.default_rng(0), 1e-6
        d, dp = random.standard_normal(jets.shape) * h, problem.p * h * (np.arange(len(problem.p)) < 2)
        change = (prediction(jets + d, problem.p + dp).values - prediction(jets - d, problem.p - dp).values) / 2
        at = prediction(jets, problem.p)
        expected = np.einsum("ncko,nko->nc", at.by_path, d) + at.by_parameter @ dp[:2]
        assert np.abs(change - expected).max(axis=0) == pytest.approx(0.0, abs=1e-6 * np.abs(change).max())


def test_normal_equations_are_those_of_the_full_jacobian() -> None:
    spline, random = PathSpline(np.linspace(0.0, 1.0, 40), 5, 3, 2, 0.25), np.random.default_rng(1)
    by_path, residual, other = (random.standard_normal((40, 3, *more)) for more in ((3, 2), (), (2,)))
    band, right = spline.normal(by_path, residual, other)
    units = np.eye(spline.count * 2).reshape(-1, spline.count, 2)
    J = np.stack([np.einsum("ncko,nko->nc", by_path, spline.jets(each)).ravel() for each in units], axis=1)
    full = J.T @ J
    assert np.allclose([np.pad(np.diag(full, -k), (0, k)) for k in range(len(band))], band)
    assert np.allclose(right, J.T @ np.column_stack([residual.ravel(), other.reshape(-1, 2)]))


@pytest.mark.usefixtures("empty_folder")
def test_an_exciting_path_is_written_that_keeps_limits_and_shows_more(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_STARTS", "_TRIALS"):
        monkeypatch.setattr(f"servocore.identification.excitation.{name}", 5)
    limits = ("F=200", "swing=10deg", "x=-2..4", "z=-7..-2")
    options = [each for limit in limits for each in ("--limit", limit)]
    shown = run("excite", "overhead_crane", *options, "-o", "path.csv", *ESTIMATED).stdout
    assert float(shown.splitlines()[-1].partition(" times less; ")[0]) > 1.0
    path = sc.from_csv("path.csv", columns=("x", "z"))
    sc.solve(CRANE.with_reference(path).with_limits(F=200, swing="10 deg", x=(-2, 4), z=(-7, -2)))


@pytest.mark.parametrize(
    ("limits", "duration", "words"),
    [(None, 20.0, "needs limits"), ({"F": 9.0}, 5.0, "8 s or more"), ({"F": 9.0}, 1e5, "100000 s: .*, 300 s at most")],
)
def test_an_excitation_without_limits_or_time_is_refused(limits: Any, duration: float, words: str) -> None:
    with pytest.raises(sc.errors.InvalidSetting, match=words):
        sc.excitation(CRANE, NAMES, limits, duration=duration)


@pytest.mark.parametrize("kind", WITH_INTERNAL_DYNAMICS)
def test_an_exciting_path_predicts_the_standard_errors_of_its_log(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("servocore.identification.excitation._TRIALS", 5)
    measured, true = WITH_INTERNAL_DYNAMICS[kind]
    limits: dict[str, Any] = {"u": 8.0, measured[0]: (-2, 2)}
    scene = sc.scenes.REGISTRY[kind]()
    path, report = sc.excitation(scene, list(true), limits)
    assert report.gain > 1.5
    moved = scene.with_reference(path)
    run = sc.solve(moved.with_limits(**limits), step=0.005)  # which refuses a path that breaks a limit
    size = 0.01 * sc.solve(scene)["u"].std()
    noisy = run["u"] + size * np.random.default_rng(0).standard_normal(len(run.t))
    columns = {"time": run.t, "u": noisy, **{each: np.round(run[each], 5) for each in measured}}
    result = sc.identify(scene, columns, list(true))
    assert np.abs(z_scores(result, scene)).max() < 4.0
    for name, value in result.values.items():
        assert report.standard_errors[name] == pytest.approx(result.standard_errors[name] / value, rel=0.3)


def test_an_excitation_of_unstable_internal_dynamics_is_refused() -> None:
    arm = sc.scenes.passive_joint_arm().with_parameters(tracked_distance=1.0)
    with pytest.raises(sc.errors.PlanningFailed, match="unstable internal dynamics"):
        sc.excitation(arm, "joint_damping", {"u": 8.0})


def test_a_study_continues_where_it_was_interrupted_and_its_page_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = list[study.Case]()

    def attempted(case: study.Case) -> study.Row:
        run.append(case)
        ones = np.ones(len(KINDS[case.kind]))
        errors = 0.03 * ones if len(run) == 1 else 0.005 * ones  # one log lies outside its intervals
        predicted = 1.0 if case.wrong else 3.0
        spread, bound = (0.01 * ones).tolist(), (0.005 * ones).tolist()
        return study.Row(case, errors.tolist(), spread, bound, 2.0, [], True, 2.0, predicted, 9.0)

    monkeypatch.setattr(study, "attempted", attempted)
    file, wanted = tmp_path / "study.jsonl", list(study.cases(2, 1, 7))
    next(rows for rows in study.continued(file, iter(wanted)) if len(rows) == 5)
    with file.open("a") as stream:
        stream.write('{"case": {"kind": "cut off')
    *_, rows = study.continued(file, iter(wanted))
    assert run == wanted == [row.case for row in rows]
    text, good = page(rows, ""), [row for row in rows if row.case.family in "AB" and not row.case.wrong]
    covered = sum(len(row.errors) for row in good[1:]) / sum(len(row.errors) for row in good)
    assert f"{len(good)} logs of families A and B: coverage of 95 % intervals {covered:.1%}" in text
    assert f"| {len(good)} | 9 | 2 | 3 | 1.5 | 100% | 0 |" in text
    assert "| all | 15 | 0 | 15 (2) | 0 |" in text
