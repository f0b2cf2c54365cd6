"""The command ``servocore`` does what its help says, and refuses with one sentence."""

from __future__ import annotations

import runpy
import shlex
import sys
from pathlib import Path

import pytest
from command_lines import PROGRAMS, write
from command_lines import servocore as run
from processes import python

import servocore as sc
from servocore.cli import commands
from servocore.cli.command import Command
from servocore.cli.commands import described
from servocore.cli.console import advised_here
from servocore.scenes import REGISTRY

pytestmark = pytest.mark.usefixtures("empty_folder")

ROOT = Path(__file__).resolve().parents[1]
assert_refused = run.assert_refused


class TestScenes:
    def test_every_scene_is_listed_with_models_inputs_and_outputs(self) -> None:
        result = run("scenes")
        assert result.exit_code == 0
        assert result.stderr == ""
        for name, factory in sc.scenes.REGISTRY.items():
            scene = factory()
            assert name in result.stdout
            for each in (*scene.model().inputs, *scene.model().outputs):
                assert f"{each.name} ({each.unit})" in result.stdout
            for model in scene.models:
                assert model in result.stdout

    def test_models_stand_smallest_first(self) -> None:
        text = run("scenes").stdout.split("overhead_crane")[0]
        assert text.index("points") < text.index("generalized") < text.index("bodies")

    @pytest.mark.parametrize("name", sc.scenes.REGISTRY)
    def test_a_scene_says_in_one_line_what_it_is_and_in_one_sentence_which_data_it_has(self, name: str) -> None:
        summary, data = described(sc.scenes.REGISTRY[name])
        assert summary.endswith(".")
        assert data.startswith("data: ")
        assert data.endswith(".")
        assert "``" not in data
        assert len(data) > 40

    def test_without_docstrings_the_table_is_still_there(self) -> None:
        code = "from servocore.cli.commands import app; app(['scenes'])"
        found = python("-OO", "-c", code, COLUMNS="120")
        assert found.returncode == 0, found.stderr
        assert "rotary_crane" in found.stdout


class TestAnalyse:
    @pytest.mark.parametrize(("scene", "model"), [("rotary_crane", "bodies"), ("cars", None), ("mass_on_car", None)])
    def test_it_prints_what_analyse_returns(self, scene: str, model: str | None) -> None:
        result = run("analyse", scene, *(("--model", model) if model else ()))
        assert result.exit_code == 0
        assert result.stderr == ""
        assert result.stdout == advised_here(f"{sc.analyse(sc.scenes.REGISTRY[scene](), model=model)}\n")
        assert "Reduced" not in result.stdout

    def test_parameters_from_a_file_change_the_answer(self) -> None:
        result = run("analyse", "mass_on_car", "--parameters", write("flat.toml", "inclination = 0\ndamping = 0.0\n"))
        assert result.exit_code == 0
        assert "  index               5\n" in result.stdout
        assert "classification      flat" in result.stdout

    def test_a_singular_problem_is_an_answer_with_reason_and_time(self) -> None:
        result = run("analyse", "overhead_crane", "--parameters", write("moon.toml", "gravity = 0.1"))
        assert result.exit_code == 0
        assert "classification      singular here" in result.stdout
        assert "reason              at t = " in result.stdout
        assert "the rope goes slack" in result.stdout

    def test_on_a_terminal_long_lines_are_broken_behind_their_label(self) -> None:
        report = str(sc.analyse(sc.scenes.rotary_crane()))
        lines = [part for line in report.splitlines() for part in commands.hanging(line, 80).splitlines()]
        assert max(map(len, lines)) <= 80
        assert " ".join(" ".join(lines).split()) == " ".join(report.split())
        assert all((line.startswith("  ") and line[2:22].strip()) or line.startswith(" " * 22) for line in lines[1:])


def test_a_help_is_as_wide_as_the_terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit):
        run.app(["export", "--help"])
    paragraph = next(line for line in capsys.readouterr().out.splitlines() if "needs no Python" in line)
    assert len(paragraph.strip()) > 120


@pytest.mark.skipif(sys.platform == "win32", reason="Windows keeps a folder that a process is in")
def test_a_present_folder_that_is_gone_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert_refused(run("analyse", "mine:scene"), "the current folder no longer exists: change into another")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("mine.py:scene", "mine.py:scene: there is no module mine; in the folder of mine.py it is mine:scene"),
        ("./mine.py:scene", "./mine.py:scene: there is no module ./mine.py; in the folder of mine.py it is mine:scene"),
        ("ends:scene", "ends:scene: the module cannot be imported: SystemExit: 3 (ends.py, line 1)"),
        ("leaves:scene", "leaves:scene returns no scene: SystemExit: 4 (leaves.py, line 2)"),
    ],
)
def test_a_module_that_is_none_or_ends_the_process_is_told(name: str, said: str) -> None:
    write("ends.py", "raise SystemExit(3)\n")
    write("leaves.py", "def scene():\n    raise SystemExit(4)\n")
    assert_refused(run("feedforward", name), said)


def examples() -> list[str]:
    """Return the command lines that stand in the help of both programs."""
    return [
        f"{program.name} {command.name} {example}"
        for program in PROGRAMS.values()
        for command in program.app.commands.values()
        if isinstance(command, Command)
        for example in command.examples
    ]


@pytest.mark.parametrize("line", examples())
def test_the_examples_of_the_help_have_options_and_names_that_there_are(line: str) -> None:
    program, name, *words = shlex.split(line)
    command = PROGRAMS[program].app.commands[name]
    values = command.make_context(name, words).params  # raises what a wrong option would be refused with
    scene = REGISTRY.get(values.get("scene") or "rotary_crane")
    if scene is not None:
        varied = {name for each in (*(values.get("vary") or ()), *(values.get("robust") or ())) for name in each}
        assert varied | set(values.get("wrt") or ()) <= {*scene().parameter_values(), "duration"}


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("servocore analyse train", "servocore: no scene is called train"),
        (
            "crane_fmu feedforward --step -1",
            "crane-fmu: --step: the step must be a positive time, not -1 s: write it as",
        ),
    ],
)
def test_a_module_runs_as_its_command(
    line: str, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module, *words = line.split()
    monkeypatch.setattr(sys, "argv", ["__main__.py", *words])
    with pytest.raises(SystemExit) as caught:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    printed = capsys.readouterr()
    assert caught.value.code == 2
    assert printed.err.startswith(said)
    assert printed.out == ""
