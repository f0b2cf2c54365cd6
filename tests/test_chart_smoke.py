"""The study of speed and accuracy in seconds: own routes and closed form, and the page that is committed."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from present import of_kind, present

import servocore as sc
from benchmarks.chart import calls, own, scale, selection
from benchmarks.chart.__main__ import main
from benchmarks.chart.candidate import Answer, Candidate, Prepared, Problem
from benchmarks.chart.facts import gather
from benchmarks.chart.forms import DERIVATIVE_ARRAY, make_form
from benchmarks.chart.orders import fit_order, round_off_constant
from benchmarks.chart.page import PAGE, render, write_tables
from benchmarks.chart.record import ORDER_SCENE, read_record, write_record
from benchmarks.chart.requirements import NO_REASON, REASONS, requirements
from benchmarks.chart.rows import Row, read_rows
from benchmarks.chart.study import PEERS, Effort, carry_out, peer_candidates, problems
from benchmarks.chart.timing import Timed, measure
from servocore.numerics.compiled_calls import Array

DOCS = Path(__file__).resolve().parents[1] / "docs" / "speed-accuracy"
SECTIONS = ("Definitions", "Comparison", "Figures", "Peers", "Which route to choose")
SCENES = ["rotary_crane", "overhead_crane", "three_cars", "mass_on_car", "arm"]


@pytest.fixture(scope="module")
def smoke(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a study of two settings a route, without peers."""
    folder = tmp_path_factory.mktemp("chart")
    main(["--smoke", "--quiet", "--out", str(folder), "--peers"])
    return folder


def headings(text: str) -> list[str]:
    return [line.removeprefix("## ") for line in text.splitlines() if line.startswith("## ")]


# A run ---------------------------------------------------------------------------------------------------------------


def test_what_is_measured_of_a_scene_is_written_and_read_for_the_page(tmp_path: Path) -> None:
    scene = next(each for each in problems() if each.name == "three_cars")
    timed = carry_out(Effort(smoke=True, peers=(), only=(scene.name,), budget=0.0), lambda _: None)
    write_record(tmp_path, timed, {**gather([scene], True), "minutes": 0.0})
    record = read_record(tmp_path)
    write_tables(record, tmp_path)
    head, *_ = (tmp_path / "results.csv").read_text(encoding="utf-8").splitlines()
    assert head == "scene,solver,model,formulation,method,setting,seconds,error,violation,message"
    errors = {row.method: present(row.error) for row in read_rows(tmp_path / "results.csv")}
    assert errors["vectorized NumPy"] == 0.0
    assert errors["exact inversion"] < 1e-10
    assert 1e-3 < errors["backward-euler"] < 1.0
    assert tuple(headings(render(record))) == SECTIONS


def test_a_run_writes_the_fixed_sections_and_every_figure_it_shows(smoke: Path) -> None:
    text = (smoke / PAGE).read_text(encoding="utf-8")
    assert tuple(headings(text)) == SECTIONS
    assert "<<" not in text
    for name in ("work-precision-rotary_crane", "violation-rotary_crane", "methods", "orders"):
        assert f"({name}.svg)" in text
        assert (smoke / f"{name}.png").stat().st_size > 10_000


def test_a_run_writes_what_size_costs(smoke: Path) -> None:
    assert (smoke / "scale.csv").read_text(encoding="utf-8").splitlines()[0] == "what,size,quantity,value,unit"
    points = scale.read_points(smoke)
    assert {each.what for each in points} == {scale.CRANE, scale.CHAIN, scale.BAR, calls.name_of("mass on car")}
    assert all(each.value > 0.0 for each in points)
    assert (smoke / scale.PAGE).read_text(encoding="utf-8") == scale.scale_page(points)


def test_a_row_that_misses_is_listed_with_its_reason_and_no_other_is() -> None:
    steps = [("its step in C", 2.0), ("solve without checks, machine code", 3.9), ("solve, machine code", 9.0)]
    points = [scale.Point(scale.STEPPED, 1, name, value, "us a step") for name, value in steps]
    points += [scale.Point(scale.CRANE, 160, "analyse", 9.0, "s"), scale.Point(scale.COLD, 1, "analyse", 0.4, "s")]
    checked = f"{scale.STEPPED}: solve, machine code"
    (first, reason), (second, why) = scale.missed(points)
    assert first == f"{scale.CRANE}, 160: analyse"
    assert reason == NO_REASON  # nothing in the library explains it
    assert second == f"{checked}, beside its step in C"
    assert why == scale.REASONS[checked]
    text = scale.scale_page(points)
    assert f"* {second}: {why}." in text
    assert text.count("\n* ") == 2


def test_exponents_are_slopes_and_limits_are_judged() -> None:
    points = [scale.Point(scale.CRANE, size, "analyse", 0.01 * size**1.5, "s") for size in (1, 4, 16, 40, 160)]
    assert scale.exponent(points) == pytest.approx(1.5)
    assert scale.exponent(points[:2]) is None
    assert [line[-1] for line in scale.wanted(points)] == ["**no**", "**no**"]
    points = [scale.Point(scale.CRANE, size, "analyse", 0.01 * size, "s") for size in (1, 4, 16, 40, 160)]
    assert [line[-1] for line in scale.wanted(points)] == ["yes", "yes"]


@pytest.mark.parametrize(("most", "verdict"), [(49.0, "yes"), (51.0, "**no**")])
def test_calls_are_judged_by_what_the_dearest_takes_beside_its_steps(most: float, verdict: str) -> None:
    ((what, quantity), *_) = calls.judged()
    points = [scale.Point(what, steps, quantity, value, "us") for steps, value in ((6, 20.0), (15, most), (38, 30.0))]
    points.append(scale.Point(what, 6, "a call, interpreted", 900.0, "us"))
    assert scale.wanted(points) == [
        (f"{what}: {quantity}", "at most 50 us, whatever the steps", f"{most:.3g}", verdict)
    ]


def test_a_call_is_what_it_calls_and_what_is_beside() -> None:
    found = {quantity: value for _, _, quantity, value, _ in calls.measure_calls(smoke=True)}
    assert {quantity for what, quantity in calls.judged() if "car" in what and "interpreted" in quantity} <= {*found}
    for table in calls.TABLES:
        whole, alone = (found[f"{part}, interpreted{table}"] for part in ("a call", "its steps and inputs alone"))
        assert found[calls.beside("interpreted", table)] == pytest.approx(whole - alone)
        assert alone > 0.0


def test_what_is_read_back_is_what_was_measured(smoke: Path) -> None:
    record = read_record(smoke)
    assert record.scenes == ["rotary_crane"]
    lines, _ = record.order_study
    assert [line.method for line in lines] == ["backward-euler", "bdf2"]
    for row in record.rows:
        lower, upper = record.spread(row)
        assert 0.0 < present(lower) <= present(row.seconds) <= present(upper)


def test_what_must_hold_is_judged_by_what_was_measured(smoke: Path) -> None:
    verdicts = {each.what: each.met for each in requirements(read_record(smoke))}
    assert verdicts["error of M_b at a step of 0.1 s, reduced"] is True
    assert verdicts["error of M_b at a step of 0.1 s, projected"] is False  # backward Euler and BDF2 alone
    assert (
        verdicts["error 1e-09: reduced form here, faster than any peer on the projected form"] is True
    )  # there is none


# The page that is committed ------------------------------------------------------------------------------------------


def test_the_page_belongs_to_the_results_beside_it() -> None:
    text = (DOCS / PAGE).read_text(encoding="utf-8")
    assert render(read_record(DOCS)) == text, "python -m benchmarks.chart --draw"
    assert tuple(headings(text)) == SECTIONS


def test_the_committed_results_cover_scenes_models_and_peers() -> None:
    record = read_record(DOCS)
    assert record.scenes == SCENES
    names = {importlib.import_module(f"benchmarks.peers.{peer}").NAME for peer in PEERS}
    for problem in problems():
        rows = record.of(problem.name)
        assert {row.solver for row in rows} >= names | {"servocore"}
        assert {row.model for row in rows if selection.is_own(row)} == set(problem.scene.models)
        for row in rows:
            assert row.solved or row.message, f"{row} has neither result nor message"
    methods = {row.method for row in record.of(ORDER_SCENE)}
    assert methods == {method.name for method in own.METHODS}


def test_what_is_missed_in_the_committed_study_is_a_matter_of_time_and_told_with_a_reason() -> None:
    text = (DOCS / PAGE).read_text(encoding="utf-8")
    missed = {each.what for each in requirements(read_record(DOCS)) if each.met is False}
    assert not [what for what in missed if what.startswith(("error of", "projected methods"))]  # accuracy holds
    for what in missed:
        assert f"* {what}: {REASONS.get(what, NO_REASON)}." in text


def test_what_is_missed_of_sizes_is_told_with_a_reason() -> None:
    text = (DOCS / scale.PAGE).read_text(encoding="utf-8")
    for what, reason in scale.missed(scale.read_points(DOCS)):
        assert f"* {what}: {reason}." in text


def test_the_files_beside_the_page_belong_to_the_results(tmp_path: Path) -> None:
    write_tables(read_record(DOCS), tmp_path)
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (DOCS / path.name).read_bytes(), "python -m benchmarks.chart --draw"
        assert f"({path.name})" in (DOCS / PAGE).read_text(encoding="utf-8")


# Parts ---------------------------------------------------------------------------------------------------------------


def row(error: float, seconds: float, solver: str = "servocore", form: str = "reduced") -> Row:
    return Row("scene", solver, "model", form, "method", f"{error:g}", seconds, error, 0.0)


def test_the_fastest_is_looked_for_among_those_accurate_enough() -> None:
    rows = [row(1e-4, 1.0), row(1e-7, 3.0), row(1e-7, 2.0), row(1e-2, 0.1)]
    assert present(selection.fastest(rows, 1e-3)).seconds == 1.0
    assert present(selection.fastest(rows, 1e-6)).seconds == 2.0
    assert selection.fastest(rows, 1e-9) is None
    assert [each.seconds for each in selection.front(rows)] == [0.1, 1.0, 2.0]


def test_solvers_are_compared_on_the_same_form_and_evaluation_and_never_with_the_closed_form() -> None:
    rows = [row(1e-10, 1.0), row(1e-10, 0.1, "closed-form"), row(1e-10, 7.0, "peer"), row(1e-10, 9.0, "other"),
            row(1e-4, 20.0, "peer", "projected"), row(1e-4, 5.0, form="projected"),
            replace(row(1e-10, 0.2), method=f"method{own.COMPILED}")]  # fmt: skip
    assert [each.ratio for each in selection.compare(rows, "scene", "reduced")] == [7.0, 7.0, 7.0]
    first, _, last = selection.compare(rows, "scene", "projected")
    assert first.ratio == 4.0
    assert (last.own, last.peer, last.ratio) == (None, None, None)
    compiled = selection.compare(rows, "scene", "reduced", compiled=True)[0]
    assert (present(compiled.own).seconds, compiled.peer) == (0.2, None)


def test_the_gain_is_that_of_the_default_route_over_a_peer_on_the_projected_form() -> None:
    default = Row("scene", "servocore", "model", "reduced", own.SOLVED, "200 steps", 2.0, 1e-12, 0.0)
    rows = [default, row(1e-10, 1.0), row(1e-4, 20.0, "peer", "projected"), row(1e-4, 3.0, "peer")]
    found = selection.gain(rows, "scene", 1e-3)
    assert (found.own, found.ratio) == (default, 10.0)
    assert selection.gain(rows, "scene", 1e-6).ratio is None


def test_an_order_is_fitted_above_the_round_off_only() -> None:
    steps = [0.8 / 2**k for k in range(10)]
    errors = [0.01 * h**4 + 1e-12 / h**2 for h in steps]
    constant = round_off_constant(steps, errors)
    assert constant == pytest.approx(1e-12, rel=0.1)
    fit = fit_order(steps, errors, constant)
    assert fit.order == pytest.approx(4.0, abs=0.1)
    assert fit_order(steps, [1.0] * 10, 0.0).order is None


def test_a_solver_that_fails_dies_or_hangs_has_a_row_with_its_message() -> None:
    problem = problems()[0]

    def candidate(run: Callable[[], None] | Callable[[], dict[str, Array]]) -> Candidate:
        prepared = Prepared(run, lambda found: Answer(found, 0.0))
        return Candidate(
            problem,
            "peer",
            "model",
            "reduced",
            "method",
            "setting",
            lambda: prepared,
            limit=1.0 if run is hang else 60.0,
        )

    def die() -> None:
        import os

        os._exit(3)

    def fail() -> None:
        raise ArithmeticError("no root in /some/where/file.py")

    def hang() -> None:
        import time

        time.sleep(60)

    def lose() -> dict[str, np.ndarray]:
        return {name: np.full(201, np.nan) for name in problem.inputs}

    timed = measure([candidate(each) for each in (die, fail, hang, lose)], lambda _: None)
    assert [each.row.message for each in timed] == [
        "the process of the solver died",
        "ArithmeticError: no root in file.py",
        "gave up after 1 s",
        "ArithmeticError: M_b is not finite",
    ]
    assert not any(each.row.solved for each in timed)


def test_a_peer_that_does_not_load_is_listed_with_its_message(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gekko", None)
    found = of_kind(Timed, peer_candidates("gekko_dynamic", problems()[0], Effort(smoke=True)))
    assert found.row.solver == "gekko"
    assert "gekko" in found.row.message


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize(("formulation", "variant"), [("projected", ""), ("reduced", DERIVATIVE_ARRAY)])
def test_the_exact_run_satisfies_the_equations_that_peers_get(scene: str, formulation: str, variant: str) -> None:
    problem = Problem(scene, {each.name: each.scene for each in problems()}[scene])
    form = make_form(problem, problem.scene.default_model, formulation, variant)
    import casadi as ca

    start = problem.scene.reference.start_time
    residual = ca.Function("F", [form.t, form.y, form.yp], [form.residual, form.outputs])(start, form.y0, form.yp0)
    assert float(ca.norm_inf(residual[0])) < 1e-9
    exact = [problem.exact(200)[name][0] for name in problem.inputs]
    assert np.asarray(residual[1]).ravel() == pytest.approx(np.array(exact), abs=1e-8)


@pytest.mark.usefixtures("compiler")
def test_a_peer_s_machine_code_is_compiled_once_for_all_tolerances_and_answers_as_it_does_interpreted() -> None:
    casadi = importlib.import_module("benchmarks.peers.casadi_integrators")
    found = [each for each in casadi.candidates(problems()[1], Effort()) if each.formulation == "reduced"]
    chosen = [
        each
        for each in found
        if each.method.startswith("idas") and each.setting in ("reltol = 0.001", "reltol = 1e-06")
    ]
    answers = {}
    for each in chosen:
        prepared = each.prepare()
        answers["machine code" in each.method, each.setting] = prepared.read(prepared.run()).inputs
    assert len(answers) == 4
    for (_, setting), inputs in answers.items():
        for name in problems()[1].inputs:
            np.testing.assert_allclose(inputs[name], answers[False, setting][name], rtol=1e-6, atol=1e-6)
    folder = Path(casadi.workshop().name)
    assert len(list(folder.glob("once-*.o"))) == 1
    assert len(list(folder.glob("*.so"))) == 2


def test_a_plain_run_of_the_library_is_what_a_row_times() -> None:
    problem = problems()[1]
    (candidate,) = (
        each
        for each in own.candidates(problem, smoke=True)
        if (each.setting, each.formulation, each.method) == ("200 steps", "reduced", own.SOLVED)
    )
    solution, _ = of_kind(tuple, candidate.prepare().run())
    assert isinstance(solution, sc.Solution)
    assert len(solution.t) == 201
