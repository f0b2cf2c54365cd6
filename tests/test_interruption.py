"""Ctrl-C ends every long command with one sentence and exit code 130, and leaves nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from processes import python
from thinned import thinned

from crane_fmu.run import nothing_left
from servocore.cli import interruption
from servocore.cli.command import Command
from servocore.cli.console import CommandLine, PatientProgress
from servocore.errors import IntegrationFailed


@pytest.fixture(autouse=True)
def heeds_ctrl_c() -> Iterator[None]:
    """Heed Ctrl-C even where these tests run in the background, whose processes ignore it and hand that down."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


LINE = ["--from", "5", "0", "-5", "--to", "-2", "2", "-2"]
BEGUN = """
import sys
from servocore.cli import console
began = console.PatientProgress.__init__
def begin(self, label):
    began(self, label)
    print("begun", flush=True)
console.PatientProgress.__init__ = begin
sys.argv[0] = "crane-fmu"
from crane_fmu.cli import main
main()
"""
COMMANDS = {
    "demo": ["demo"],
    "build": ["build", "-o", "deep/folder"],
    "plan": ["plan", *LINE, "--limit", "F=60", "-o", "plan.csv"],
    "feedforward": ["feedforward", *LINE, "--duration", "20", "--step", "0.0001", "-o", "inputs.csv"],
}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no SIGINT to a process alone")
@pytest.mark.parametrize("name", thinned(COMMANDS, lambda name: name == "plan"))
def test_ctrl_c_ends_a_command_with_130_and_leaves_nothing(name: str, tmp_path: Path) -> None:
    work, scratch = tmp_path / "work", tmp_path / "scratch"
    for each in (work, scratch):
        each.mkdir()
    with subprocess.Popen(
        [sys.executable, "-c", BEGUN, *COMMANDS[name]], cwd=work, env={**os.environ, "TMPDIR": str(scratch)},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as running:  # fmt: skip
        assert running.stdout is not None
        assert running.stdout.readline() == "begun\n"
        time.sleep(0.2)  # into the work
        running.send_signal(signal.SIGINT)
        out, sentence = running.communicate()
    assert running.returncode == interruption.INTERRUPTED
    assert (out, sentence) == ("", "crane-fmu: stopped\n")
    assert [*work.iterdir(), *scratch.iterdir()] == []


WHILE_IMPORTING = """
import signal, sys, weakref
class Importing:
    def find_spec(self, name, *_):
        if name == "casadi":
            {stopped}
sys.meta_path.insert(0, Importing())
from {package}.cli import main
main()
"""
RAISED = "signal.raise_signal(signal.SIGINT)"
SWALLOWED = "weakref.finalize(Importing(), signal.raise_signal, signal.SIGINT)"  # as whatever a callback raises


@pytest.mark.parametrize("stopped", [RAISED, SWALLOWED])
@pytest.mark.parametrize(("package", "name"), [("servocore", "servocore"), ("crane_fmu", "crane-fmu")])
def test_ctrl_c_during_imports_ends_a_command_as_later(package: str, name: str, stopped: str) -> None:
    code = WHILE_IMPORTING.format(package=package, stopped=stopped)
    done = python("-c", code, "--version")
    assert (done.returncode, done.stdout, done.stderr) == (interruption.INTERRUPTED, "", f"{name}: stopped\n")


def test_what_an_fmu_unpacked_is_gone_after_a_run_that_breaks_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def break_off() -> None:
        with nothing_left():
            Path(tempfile.mkdtemp(), "library.so").touch()
            raise IntegrationFailed("no")

    with pytest.raises(IntegrationFailed):
        break_off()
    assert list(tmp_path.iterdir()) == []
    assert tempfile.tempdir == str(tmp_path)


def _command(run: Callable[[], None]) -> Result:
    return CliRunner().invoke(CommandLine("tool", "", [Command("run", run)]), ["run"])


def test_an_error_that_a_library_makes_of_ctrl_c_is_told_as_ctrl_c() -> None:
    def run() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise IntegrationFailed("fmi2GetReal failed") from None

    done = _command(run)
    assert (done.exit_code, done.stderr) == (130, "tool: stopped\n")


@pytest.mark.parametrize("reports", [True, False])
def test_ctrl_c_that_a_library_swallows_is_heeded_at_the_next_report_of_progress(reports: bool) -> None:
    def run() -> None:
        with PatientProgress("working") as progress:
            with suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
            if reports:
                progress(1, 2)
                raise AssertionError("the command went on")

    done = _command(run)
    assert (done.exit_code, done.stderr) == (130, "tool: stopped\n")


def test_the_next_command_knows_nothing_of_an_earlier_ctrl_c() -> None:
    assert _command(lambda: signal.raise_signal(signal.SIGINT)).exit_code == 130
    assert _command(lambda: None).exit_code == 0


def test_without_a_terminal_a_line_tells_every_tenth_after_the_first_second(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    progress = PatientProgress("counting")
    progress(1, 20)
    monkeypatch.setattr(PatientProgress, "_slow", lambda _: True)
    for done in range(2, 21):
        progress(done, 20)
    told = [line.partition(",") for line in capsys.readouterr().err.splitlines()]
    assert [line[0] for line in told] == [f"counting: {each} %" for each in range(10, 100, 10)]
    assert all(line[2].endswith(" s left") for line in told)


def test_without_a_terminal_a_stage_is_told_five_seconds_after_the_line_before(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    progress = PatientProgress("working")
    for seconds, stage in ((0.5, "at once"), (6.0, "first"), (10.0, "soon after"), (11.5, "second")):
        monkeypatch.setattr(PatientProgress, "_elapsed", seconds)
        progress.describe(stage)
    assert capsys.readouterr().err.splitlines() == ["first", "second"]


def test_a_folder_that_a_failed_build_made_is_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import crane_fmu.build.fmu as building

    def fails(*_: object, **__: object) -> None:
        raise IntegrationFailed("no")

    monkeypatch.setattr(building, "native_model", fails)
    (tmp_path / "kept").mkdir()
    for folder in (tmp_path / "deep" / "folder", tmp_path / "kept"):
        with pytest.raises(IntegrationFailed):
            building.build_fmu(Path(folder))
    assert [each.name for each in tmp_path.iterdir()] == ["kept"]
