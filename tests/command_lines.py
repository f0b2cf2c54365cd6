"""What the tests of both command lines share."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click import Group
from click.testing import CliRunner

from crane_fmu.cli.commands import app as crane_app
from servocore.cli.commands import app
from servocore.cli.console import PatientProgress
from servocore.numerics.compiled_calls import Array


class CommandLine:
    """A command line as a caller in an empty folder sees it."""

    def __init__(self, app: Group, name: str) -> None:
        self.app, self.name = app, name

    def __call__(self, *arguments: object) -> Any:
        """Run a command; none takes so long that it reports progress, however busy the machine is."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(PatientProgress, "_slow", lambda _: False)
            return CliRunner().invoke(self.app, list(map(str, arguments)))

    def assert_refused(self, result: Any, *words: str) -> None:
        """One sentence with these words on the error stream, nothing else, and exit code 2."""
        assert result.exit_code == 2, result.output
        assert result.stdout == ""
        assert result.stderr.startswith(f"{self.name}: ")
        assert len(result.stderr.splitlines()) == 1
        assert "Traceback" not in result.stderr
        for word in words:
            assert word in result.stderr


servocore, crane_fmu = CommandLine(app, "servocore"), CommandLine(crane_app, "crane-fmu")
PROGRAMS = {each.name: each for each in (servocore, crane_fmu)}


def write(name: str, text: str) -> str:
    Path(name).write_text(text, encoding="utf-8")
    return name


def table(text: str) -> tuple[list[str], Array]:
    """Return the header and the rows (N, columns) of a table in CSV."""
    header, *rows = csv.reader(text.splitlines())
    return header, np.array(rows, dtype=float)


def columns(file: str) -> dict[str, Array]:
    """Return the columns (N,) of a file by their names."""
    header, rows = table(Path(file).read_text(encoding="utf-8"))
    return dict(zip(header, rows.T, strict=True))
