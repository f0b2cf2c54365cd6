"""One measured point of the study, and the table of all of them as CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Row:
    """One solver on one problem at one setting.

    Attributes
    ----------
    scene : str
        Name of the scene.
    solver : str
        ``servocore``, the name of a peer, or ``closed-form``.
    model, formulation, method, setting : str
        What it was given, and how it was set.
    seconds : float or None
        Median time of a warm solve; None if there was none.
    error : float or None
        Largest error of any input over the run, relative to that input's peak.
    violation : float or None
        Largest violation of servo and holonomic constraints, in m (rad for an angle).
    message : str
        Why there is no result, or what else there is to say.
    """

    scene: str
    solver: str
    model: str
    formulation: str
    method: str
    setting: str
    seconds: float | None = None
    error: float | None = None
    violation: float | None = None
    message: str = ""

    @property
    def solved(self) -> bool:
        """Whether there is an error and a time."""
        return self.error is not None and self.seconds is not None and math.isfinite(self.error)

    @property
    def point(self) -> tuple[float, float]:
        """Time in s and error of a row that is solved."""
        if self.seconds is None or self.error is None:
            raise ValueError(f"{self.solver} gave no answer: {self.message}")
        return self.seconds, self.error

    @property
    def series(self) -> tuple[str, str, str, str, str]:
        """What the points of one line have in common."""
        return self.scene, self.solver, self.model, self.formulation, self.method


COLUMNS = tuple(each.name for each in fields(Row))
_NUMBERS = ("seconds", "error", "violation")


def write_rows(path: Path, rows: Iterable[Row]) -> None:
    """Write the rows as CSV."""
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for row in rows:
            writer.writerow(["" if each is None else f"{each:.6e}" if isinstance(each, float) else each
                             for each in astuple(row)])  # fmt: skip


def read_rows(path: Path) -> list[Row]:
    """Undo `write_rows`."""
    with path.open(newline="") as stream:
        return [Row(**{key: _read(key, text) for key, text in line.items()}) for line in csv.DictReader(stream)]


def _read(key: str, text: str) -> Any:
    return (float(text) if text else None) if key in _NUMBERS else text
