"""Records of the atlas: predictions, observations and verdicts, one line each, and the numbers that the page quotes."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass, field, fields
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

SURVIVES, FAILS, REFUSED = "survives", "fails", "refused"
RECORDS, FACTS = "results.csv", "facts.json"
NO_PREDICTION = "no prediction"
"""Expected where neither theory nor a requirement says anything: the observation is reported, not judged."""


@dataclass(frozen=True)
class Record:
    """One prediction with what was observed.

    Attributes
    ----------
    row : str
        Name of the row.
    scene, route : str
        What was run, and how.
    parameter, value : str
        What was varied or measured, and where.
    expected : str
        As `about`, `at_most` or `at_least` write it, a word that the observation must begin with, or `NO_PREDICTION`.
    observed : str
        A number, or the name of an error.
    verdict : str
        `SURVIVES`, `FAILS` or `REFUSED`: what became of the route.
    """

    row: str
    scene: str
    route: str
    parameter: str
    value: str
    expected: str
    observed: str
    verdict: str

    @property
    def agrees(self) -> bool:
        """Whether the observation is what was expected."""
        return meets(self.expected, self.observed)


@dataclass(frozen=True, eq=False)
class Findings:
    """What a row measured.

    Attributes
    ----------
    records : list of Record
        Lines of the table.
    facts : dict
        Numbers that the page's sentences quote, by name.
    curves : dict
        What the figure draws, by name.
    gaps : dict
        Records that are known to miss what is required, with the reason: the page lists them, they are no surprise.
    """

    row: str
    records: list[Record] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)
    curves: dict[Any, Any] = field(default_factory=dict)
    gaps: dict[Record, str] = field(default_factory=dict)

    def add(
        self, scene: str, route: str, parameter: str, value: float | str, expected: str, observed: float | str,
        verdict: str,
    ) -> None:  # fmt: skip
        """Record one observation."""
        shown, seen = (each if isinstance(each, str) else number(each) for each in (value, observed))
        self.records.append(Record(self.row, scene, route, parameter, shown, expected, seen, verdict))

    def surprises(self) -> list[Record]:
        """Return the records whose observation is neither what was expected nor a known gap."""
        return [each for each in self.records if not each.agrees and each not in self.gaps]


@dataclass(frozen=True, eq=False)
class Row:
    """One way to fail: what the page says of it, how it is measured and drawn.

    Attributes
    ----------
    name, title : str
        File name of the figure, and heading.
    avoid, do : str
        For the table at the top of the page.
    theory, survivor, limit : str
        Cause and rate of the failure; accuracy of the routes that survive; their limits. `{name:.2g}` quotes a fact.
    caption : str
        Under the figure.
    measure : callable
        (quick) -> Findings; `quick` means seconds in place of minutes.
    draw : callable
        Findings -> Figure.
    """

    name: str
    title: str
    avoid: str
    do: str
    theory: str
    survivor: str
    limit: str
    caption: str
    measure: Callable[[bool], Findings]
    draw: Callable[[Findings], Figure]


def number(value: float) -> str:
    """Write a number as the table shows it."""
    return f"{float(value):.4g}"


def about(value: float, tolerance: float) -> str:
    """Expect a number within a tolerance."""
    return f"{value:.4g} +- {tolerance:.2g}"


def at_most(value: float) -> str:
    """Expect a number up to a bound."""
    return f"<= {value:.4g}"


def at_least(value: float) -> str:
    """Expect a number from a bound on; infinity counts."""
    return f">= {value:.4g}"


def meets(expected: str, observed: str) -> bool:
    """Whether an observation is what was expected."""
    if expected == NO_PREDICTION:
        return True
    head, _, rest = expected.partition(" ")
    if head == "<=":
        return _value(observed) <= float(rest)
    if head == ">=":
        return _value(observed) >= float(rest)
    if rest.startswith("+- "):
        return abs(_value(observed) - float(head)) <= float(rest[3:])
    return observed.startswith(expected)


def _value(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def write_csv(path: Path, records: Iterable[Record]) -> None:
    """Write the table."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([each.name for each in fields(Record)])
        writer.writerows(astuple(each) for each in records)


def write_facts(path: Path, findings: Iterable[Findings]) -> None:
    """Write the numbers that the page quotes, and the known gaps, as JSON by row."""
    text = {
        found.row: {
            "facts": found.facts,
            "gaps": [[*astuple(record), reason] for record, reason in found.gaps.items()],
        }
        for found in findings
    }  # fmt: skip
    path.write_text(json.dumps(text, indent=1, ensure_ascii=False, default=lambda each: each.item()) + "\n", "utf-8")


def read_findings(folder: Path, rows: Iterable[Row]) -> list[Findings]:
    """Read records, facts and gaps of rows as `write_csv` and `write_facts` wrote them; curves are not kept."""
    records = read_csv(folder / RECORDS)
    kept = json.loads((folder / FACTS).read_text(encoding="utf-8"))
    return [
        Findings(
            row.name,
            [each for each in records if each.row == row.name],
            kept[row.name]["facts"],
            gaps={Record(*fields_): reason for *fields_, reason in kept[row.name]["gaps"]},
        )
        for row in rows
    ]


def read_csv(path: Path) -> list[Record]:
    """Read the table."""
    with path.open(newline="", encoding="utf-8") as stream:
        return [Record(**line) for line in csv.DictReader(stream)]
