"""The demo leaves a complete folder or none, and the FMU that it runs does what the library does."""

import re
import shutil
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from browser import Page, require_browser
from command_lines import crane_fmu as run
from command_lines import table
from fmu_host import fmu_file, system

import crane_fmu.demo
import servocore as sc
from crane_fmu.catalogue import KINDS
from crane_fmu.demo import Demo, demo, example_cycle
from crane_fmu.files import filled_folder
from crane_fmu.report.study import LoadRun, Study, study
from crane_fmu.run import run_fmu

STEPS = (0.2, 0.1)
FIGURES = ("crane", "reference_function", "inputs_paper", "error_against_step", "tracking", "closed_loop", "cycle_path")


@cache
def kept_study() -> Study:
    return study(sc.scenes.rotary_crane(), lambda _: None, STEPS[:1])


@pytest.fixture(scope="module", params=["light", "whole"])
def done(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Demo:
    said: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "light":
            make_light(patch)
        result = demo(tmp_path_factory.mktemp("demo") / "deep" / "out", said.append, STEPS)
    assert said
    return result


def make_light(patch: pytest.MonkeyPatch) -> None:
    """Take FMUs and study that are there, simulate no loop and draw nothing."""

    def copied(folder: Path, _: object) -> Path:
        shutil.copytree(system().parent, folder / "system")
        shutil.copy(system().parent / "RotaryCrane.fmu", folder)
        return folder / "system" / "Crane.ssp"

    loops = [LoadRun("none", np.arange(2.0), *np.ones((2, 2, 3)))]
    patch.setattr("crane_fmu.demo.build_system", copied)
    patch.setattr("crane_fmu.report.study.track", lambda *_: 4 * loops)
    patch.setattr("crane_fmu.demo.study", lambda *_: kept_study())
    patch.setattr("crane_fmu.demo.closed_loops", lambda *_: loops)
    patch.setattr("crane_fmu.report.page.picture", lambda *_: b"<svg/>")


@pytest.mark.parametrize("done", ["whole"], indirect=True)
class TestDemoInABrowser:
    def test_the_report_computes_in_a_browser_what_it_says(self, done: Demo, tmp_path: Path) -> None:
        require_browser()
        file = done.folder / "report.html"
        assert file.stat().st_size <= 6_000_000
        with Page(file, tmp_path) as page:
            assert 0.0 <= float(page.run('document.getElementById("live-check").textContent')) < 1e-12
            assert page.run("servocore.run.t.length") == 2001
            assert page.errors == []

    def test_the_report_is_printed_without_empty_halves_of_pages(self, done: Demo, tmp_path: Path) -> None:
        """With one figure a page it took 17 pages."""
        require_browser()
        with Page(done.folder / "report.html", tmp_path) as page:
            assert 5 <= len(re.findall(rb"/Type */Page\b", page.pdf())) <= 10


class TestDemo:
    def test_the_folder_holds_fmu_table_report_and_every_figure_twice(self, done: Demo) -> None:
        expected = {"RotaryCrane.fmu", "inputs.csv", "report.html", "system/Crane.ssp", "system/CranePlant_in.csv"}
        expected |= {f"system/{name}{end}" for name in KINDS for end in (".fmu", "_ref.csv", "_ref.opt")}
        expected |= {"system/RotaryCrane_in.csv"}
        expected |= {f"figures/{name}{suffix}" for name in FIGURES for suffix in (".png", ".svg")}
        present = {each.relative_to(done.folder).as_posix() for each in done.folder.rglob("*") if each.is_file()}
        assert present == expected == set(done.files)
        assert [each.name for each in done.folder.parent.iterdir()] == ["out"]

    def test_the_table_of_inputs_is_the_closed_form_to_1e_9_of_the_peaks(self, done: Demo) -> None:
        names, values = table((done.folder / "inputs.csv").read_text())
        assert names == ["time", "M_b", "F", "M_w", "phi", "s", "l", "x", "y", "z", "tension"]
        exact = sc.scenes.rotary_crane().exact(values[:, 0])
        for k, name in enumerate(names[1:], start=1):
            off = np.abs(values[:, k] - exact[name]).max()
            assert off <= 1e-9 * np.abs(exact[name]).max(), name

    def test_the_default_is_told_first_and_the_scheme_of_the_paper_by_that_name_after_it(self, done: Demo) -> None:
        default, paper, certificate = done.summary
        assert certificate.startswith("Certificate: proved: one regular motion at all times")
        assert "exact inversion" in default
        assert "paper" not in default
        assert re.search(r"the scheme of the paper .*step of 0\.2 s its M_b is off by 4\d\.\d %", paper)
        text = (done.folder / "report.html").read_text(encoding="utf-8")
        said = ("numerical residual of the inputs", "scheme of the paper, step", "By default the inputs are computed",
                "For comparison, the scheme of the paper", certificate[:40])  # fmt: skip
        assert sorted(text.index(each) for each in said) == [text.index(each) for each in said]
        assert text.index(said[0]) < text.index("scheme of the paper")

    def test_the_fmu_is_shown_with_its_default_formulation(self, done: Demo) -> None:
        fmu = next(each for each in done.tables if "FMU's outputs" in each.title)
        assert "form reduced" in fmu.by
        (torque,) = (row for row in fmu.rows if row[0] == "M_b")
        assert 0.0 < float(torque[1].removesuffix(" N m")) < 5.0  # with the projected form it is 66 N m at this step

    def test_the_report_says_that_the_fmu_ran_to_its_end(self, done: Demo) -> None:
        assert "101 rows up to <i>t</i> = 20 s" in (done.folder / "report.html").read_text(encoding="utf-8")

    def test_a_second_run_replaces_what_is_there_and_keeps_the_rest(
        self, done: Demo, monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder
    ) -> None:
        make_light(monkeypatch)
        (done.folder / "notes.txt").write_text("mine")
        (done.folder / "report.html").write_text("old")
        assert demo(done.folder, steps=STEPS).files == done.files
        assert recwarn.list == []  # of the scheme of the paper the tables tell
        assert (done.folder / "notes.txt").read_text() == "mine"
        assert (done.folder / "report.html").stat().st_size > 1000
        (done.folder / "notes.txt").unlink()


@pytest.mark.usefixtures("empty_folder")
def test_the_command_prints_tables_and_where_the_report_is(done: Demo, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(crane_fmu.demo, "demo", lambda *_, certify: done if certify else None)
    result = run("demo")
    assert result.exit_code == 0
    assert "Largest errors against the closed form" in result.stdout
    assert "largest differences between the models' inputs" in result.stdout
    assert result.stdout.index("By default the inputs") < result.stdout.index("scheme of the paper")
    assert "report.html" in result.stdout
    assert result.stderr == ""


class TestRunFmu:
    def test_a_run_that_ends_early_is_an_error_with_what_the_fmu_said(self) -> None:
        over_the_axis = sc.rest_to_rest((5.0, 0.0, -5.0), (-5.0, 0.0, -5.0), 10.0)
        with pytest.raises(sc.IntegrationFailed, match=r"stopped at t = .* of 10 s .*slewing axis"):
            run_fmu(fmu_file(), over_the_axis, 0.1)

    def test_a_run_leaves_no_module_of_the_fmu_behind(self) -> None:
        before = set(sys.modules), list(sys.path)
        run_fmu(fmu_file(), sc.scenes.rotary_crane().reference, 0.5)
        stayed = [name for name in set(sys.modules) - before[0] if name.startswith("rotary_crane")]
        assert stayed == []
        assert sys.path == before[1]

    def test_a_parameter_out_of_bounds_is_an_error_with_what_the_fmu_said(self) -> None:
        with pytest.raises(sc.IntegrationFailed, match="load_mass"):
            run_fmu(fmu_file(), sc.scenes.rotary_crane().reference, 0.1, load_mass=-1.0)


class TestExamples:
    def test_waypoints_and_samples_are_one_path(self) -> None:
        cycle = example_cycle(sc.scenes.rotary_crane())
        assert cycle.apart < 1e-9
        assert max(cycle.errors[name] for name in ("M_b", "F", "M_w")) < 1e-12
        assert 1e-3 < cycle.paper["M_b"] < 0.05


def _half_done(folder: Path, failure: type[BaseException]) -> None:
    with filled_folder(folder) as draft:
        (draft / "report.html").write_text("new")
        raise failure


class TestWriting:
    @pytest.mark.parametrize("failure", [KeyboardInterrupt, RuntimeError])
    @pytest.mark.parametrize("there", [False, True])
    def test_a_folder_that_is_not_finished_is_as_it_was(
        self, there: bool, failure: type[BaseException], tmp_path: Path
    ) -> None:
        if there:
            (tmp_path / "out").mkdir()
            (tmp_path / "out" / "report.html").write_text("old")
        with pytest.raises(failure):
            _half_done(tmp_path / "out", failure)
        assert [each.read_text() for each in tmp_path.rglob("*.*")] == ["old"] * there
        assert [each.name for each in tmp_path.iterdir()] == ["out"] * there
