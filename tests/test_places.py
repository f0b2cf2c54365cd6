"""Every command refuses, before its work, a place that cannot be written, and packages that are not there.

A command that is new needs a row in `CASES`, and an option for a result of its own must be in one of the rows.
"""

from __future__ import annotations

import errno
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from command_lines import PROGRAMS
from test_extras import CRANE, LIBRARY, without_extras
from thinned import thinned

from servocore.cli.kinds import FOLDER

CODE = {"crane-fmu": CRANE, "servocore": LIBRARY}
LINE = "--from 5 0 -5 --to -2 2 -2 --duration 20"
WAY = "--from 5 0 -5 --to -2 2 -2 --limit F=60"
SHIFT = "--from 0 -4 --to 5 -4 --limit F=200"


class Case(NamedTuple):
    """A command line with @ for its result, what that ends with (/: a folder), and the extra that it needs if any."""

    line: str
    ending: str = ""
    extra: str = ""


CASES = [
    Case(f"crane-fmu feedforward {LINE} --output @", ".csv"),
    Case(f"crane-fmu feedforward {LINE} --plot @", ".png", "report"),
    Case(f"crane-fmu plan {WAY} --output @", ".csv"),
    Case(f"crane-fmu plan {WAY} --write-path @", ".csv"),
    Case(f"crane-fmu plan {WAY} --plot @", ".svg", "report"),
    Case("crane-fmu view --output @", ".html", "report"),
    Case("crane-fmu build --output @", "/", "fmu"),
    Case("crane-fmu build --page @", ".md", "fmu"),
    Case("crane-fmu ssp --output @", "/", "fmu"),
    Case(f"crane-fmu drive plant.fmu {LINE} --output @", ".csv", "fmu"),
    Case("crane-fmu demo --output @", "/", "fmu"),
    Case("servocore scenes"),
    Case("servocore analyse cars"),
    Case("servocore import arm.urdf"),
    Case("servocore drives rotary_crane"),
    Case("servocore identify overhead_crane file --estimate load_mass --output @", ".toml"),
    Case("servocore identify overhead_crane file --estimate load_mass --page @", ".html", "report"),
    Case("servocore excite overhead_crane --estimate load_mass --limit F=200 --output @", ".csv"),
    Case("servocore feedforward cars --output @", ".csv"),
    Case("servocore feedforward cars --plot @", ".png", "report"),
    Case(f"servocore plan overhead_crane {SHIFT} --output @", ".csv"),
    Case(f"servocore plan overhead_crane {SHIFT} --write-path @", ".csv"),
    Case(f"servocore plan overhead_crane {SHIFT} --plot @", ".pdf", "report"),
    Case("servocore sensitivities cars --output @", ".csv"),
    Case("servocore sensitivities cars --plot @", ".png", "report"),
    Case("servocore sweep cars --vary duration=5..9:3 --output @", "/", "sweep"),
    Case("servocore effects overhead_crane --markdown @", ".md"),
    Case("servocore view cars --output @", ".html", "report"),
    Case("servocore export cars --targets host --output @", ".fmu", "fmu"),
    Case("servocore export cars --c @", "/", "fmu"),
    Case("servocore export cars --wasm @", ".wasm", "fmu"),
    Case("servocore ssp cars --targets host --output @", ".ssp", "fmu"),
    Case("servocore cache"),
]
WITH_RESULTS = [case for case in CASES if case.ending]
EXTRAS = {"fmu": ("fmpy", "jinja2"), "report": ("jinja2", "matplotlib"), "sweep": ("zarr",)}


def results() -> Iterator[tuple[str, list[list[str]]]]:
    """Every command of both command lines, by the names that one types, and what its options for results are called."""
    for name, line in PROGRAMS.items():
        for command, found in line.app.commands.items():
            yield (
                f"{name} {command}",
                [
                    each.opts
                    for each in found.params
                    if getattr(each.type, "role", "") == "written" or each.type is FOLDER
                ],
            )


def refused(case: Case, place: str, *words: str) -> None:
    name, *arguments = shlex.split(case.line.replace("@", place))
    PROGRAMS[name].assert_refused(PROGRAMS[name](*arguments), *words)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("held")
    Path("folder").mkdir()
    Path("plant.fmu").write_text("no FMU")
    return tmp_path


def untouched(folder: Path) -> bool:
    """Whether nothing is in the folder of the fixture but what it put there."""
    held = sorted(str(each.relative_to(folder)) for each in folder.rglob("*"))
    return held == ["file", "folder", "plant.fmu"] and Path("file").read_text() == "held"


def test_every_command_and_every_result_has_a_case() -> None:
    found = dict(results())
    assert sum(map(len, found.values())) == len(WITH_RESULTS)
    for name, options in found.items():
        lines = [case.line for case in CASES if case.line.startswith(f"{name} ") or case.line == name]
        assert lines, f"{name} is in no case"
        for names in options:
            assert any(f" {each} @" in line for line in lines for each in names), f"{name} {names} is in no case"


@pytest.mark.parametrize("case", WITH_RESULTS, ids=lambda case: case.line)
def test_what_cannot_be_a_place_is_refused_with_the_culprit(case: Case, folder: Path) -> None:
    for package in EXTRAS.get(case.extra, ()):
        pytest.importorskip(package)
    ending = case.ending.rstrip("/")
    refused(case, f"file/new{ending}", f"cannot write file/new{ending}", f"{folder}/file is a file, not a folder")
    refused(case, f"{'x' * 300}{ending}", "cannot write xxx", "; name another place")
    if case.ending == "/":
        refused(case, "file", "cannot write file: it is a file, not a folder; name another place")
    else:
        (folder / f"folder{ending}").mkdir()
        refused(case, f"folder{ending}", f"cannot write folder{ending}: it is a folder; name a file")
        (folder / f"folder{ending}").rmdir()
        refused(case, f"no/new{ending}", f"cannot write no/new{ending}: there is no folder no; make it first")
    assert untouched(folder)


@pytest.mark.parametrize(
    ("number", "remedy"),
    [(errno.EROFS, "name another place"), (errno.ENOSPC, "free some space, or name another place")],
)
@pytest.mark.parametrize("case", WITH_RESULTS, ids=lambda case: case.line)
def test_folders_and_disks_that_take_nothing_are_refused_before_the_work(
    case: Case, number: int, remedy: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for package in EXTRAS.get(case.extra, ()):
        pytest.importorskip(package)

    def fails(**_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(tempfile, "TemporaryFile", fails)
    place = f"new{case.ending.rstrip('/')}"
    refused(case, place, f"cannot write {place}: {os.strerror(number)}; {remedy}")
    assert untouched(folder)


ONE_OF_EACH = {*{(case.line.partition(" ")[0], case.extra): case for case in CASES}.values()}
"""A case of each command line and extra."""


@pytest.mark.parametrize("case", thinned(CASES, ONE_OF_EACH.__contains__), ids=lambda case: case.line)
def test_a_command_works_without_extras_or_names_the_one_that_it_needs(case: Case, folder: Path) -> None:
    place = f"new{case.ending.rstrip('/')}"
    name, *arguments = shlex.split(case.line.replace("@", place))
    run = without_extras(f"{CODE[name]}; main()", *arguments, folder=folder)
    assert "Traceback" not in run.stderr
    if case.extra:
        assert run.returncode == 2
        assert run.stderr.count("\n") == 1
        assert f"run pip install '.[{case.extra}]' in a clone of the project" in run.stderr
        assert untouched(folder)
    else:
        assert run.returncode == 0, run.stderr


def test_a_package_is_asked_for_before_the_work_that_ends_with_it(folder: Path) -> None:
    """No smooth law moves a crane with so little force, which planning finds out."""
    way = WAY.replace("F=60", "F=1e-9")
    run = without_extras(f"{CRANE}; main()", "plan", *shlex.split(way), "--plot", "new.png", folder=folder)
    assert run.stderr == (
        "crane-fmu: the package matplotlib is missing: run pip install '.[report]' in a clone of the project\n"
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a stream that takes nothing is a device of Linux")
@pytest.mark.parametrize("line", ["servocore scenes", "servocore feedforward cars", "servocore --version"])
def test_a_stream_that_takes_nothing_is_refused_with_a_sentence(line: str) -> None:
    name, *arguments = line.split()
    with open("/dev/full", "w") as full:
        run = subprocess.run(
            [sys.executable, "-c", f"{CODE[name]}; main()", *arguments],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert run.returncode == 2
    assert run.stderr.splitlines()[-1].startswith("servocore: ")
    assert os.strerror(errno.ENOSPC) in run.stderr
    assert "Traceback" not in run.stderr


@pytest.mark.skipif(os.name != "posix", reason="how a shell closes streams")
@pytest.mark.parametrize(
    ("line", "code", "told"),
    [
        ("feedforward cars -o new.csv >&-", 0, "at rest at start and end"),
        ("feedforward cars >&-", 2, "servocore: cannot write to the standard output stream: it is closed"),
        ("--version >&-", 0, ""),
        ("feedforward cars 2>&-", 0, ""),
    ],
)
def test_streams_that_are_closed_are_left_alone(line: str, code: int, told: str, tmp_path: Path) -> None:
    command = shlex.join([sys.executable, "-c", f"{CODE['servocore']}; main()"])
    run = subprocess.run(["sh", "-c", f"{command} {line}"], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert run.returncode == code
    assert told in run.stderr
    assert "Traceback" not in run.stderr
    rows = run.stdout.splitlines()
    assert all(re.fullmatch(r"[-+.e,\d]+", row) for row in rows[1:])  # a table and nothing that is told
    assert len(rows) == (202 if "2>&-" in line else 0)


@pytest.mark.skipif(os.name != "posix", reason="Windows has no such pipes")
@pytest.mark.parametrize("line", ["feedforward cars --step 0.0001", "--version"])
def test_a_reader_that_goes_ends_a_command_quietly_with_a_code_of_its_own(line: str) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", f"{CODE['servocore']}; main()", *line.split()],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as run:  # fmt: skip
        assert run.stdout is not None
        run.stdout.close()
        assert run.stderr is not None
        assert "Traceback" not in run.stderr.read()
    assert run.returncode == 141


def test_without_a_folder_for_temporary_files_the_variable_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("jinja2")

    def fails(*_: object, **__: object) -> None:
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr(tempfile, "mkdtemp", fails)
    refused(
        Case("servocore export cars --targets host -o @"), "new.fmu", "let TMPDIR name a folder that can be written"
    )
