"""Command lines in README, pages, stories and Makefile are taken by the commands; their tables name all options."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import click
import pytest
from test_command_lines import COMMANDS, ROOT, argument_of

from servocore.cli.choices import FORMULATIONS, METHODS
from servocore.cli.command import Command
from servocore.cli.kinds import Kind
from servocore.cli.options import Computation, GivenPath
from servocore.cli.plan import Freedom
from servocore.cli.studies import Question
from servocore.cli.sweep import Cases
from servocore.references.profiles import TIME_LAWS

pytestmark = pytest.mark.usefixtures("empty_folder")

PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "Makefile", "examples/README.md")]
PAGES += sorted([*(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").glob("*.py")])

NAMED = r"((?:crane-fmu|servocore) [a-z]"
LINE = re.compile(rf"^(?:!|\$ |    |\t@?)(?:\$\(BIN\)/)?{NAMED}.*)$", re.MULTILINE)  # of a console, a notebook, a rule
SPAN = re.compile(rf"`{NAMED}[^`]*)`")
PLACEHOLDER = re.compile(r"[A-Z]+(\.[a-z]+)?")


class Line(NamedTuple):
    """A command line in a page."""

    page: str
    words: list[str]

    @property
    def name(self) -> str:
        return " ".join(self.words[:2])


def lines() -> Iterator[Line]:
    for page in PAGES:
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        for pattern in (LINE, SPAN):
            for found in pattern.finditer(text):
                words = shlex.split(found[1].partition(" | ")[0], comments=True)
                yield Line(str(page.relative_to(ROOT)), words)


LINES = list(lines())
WHOLE = [each for each in LINES if len(each.words) > 2 and "..." not in each.words]


def filled(command: Command, words: list[str]) -> list[str]:
    """Return the words of a line with examples where a page says what belongs there: SCENE, METRES."""
    known = {flag: each for each in command.params for flag in each.opts}
    examples = {flag: each.type.example for flag, each in known.items() if isinstance(each.type, Kind)}
    pairs = zip(["", *words], [*words, ""], strict=True)
    result = [examples.get(before, "rotary_crane") if PLACEHOLDER.fullmatch(word) else word for before, word in pairs]
    return [*result[:-1], *([examples[words[-1]]] if words[-1] in examples else [])]


CHECKS: dict[type, Callable[[Any], object]] = {
    GivenPath: lambda path: path.options(),
    Computation: lambda how: (how.require(20.0), how.accuracy()),
    Freedom: lambda freedom: freedom.space(3),
    Cases: lambda cases: cases.varied(),
    Question: lambda question: (question.allowed("m"), question.loops()),
}
"""What looks at values that a command reads once it has begun."""


def test_every_command_is_in_a_page() -> None:
    assert {each.name for each in LINES} == set(COMMANDS)
    assert len(WHOLE) >= 50


@pytest.mark.parametrize("line", WHOLE, ids=[f"{each.page}: {' '.join(each.words)}" for each in WHOLE])
def test_a_command_line_of_a_page_is_taken(line: Line) -> None:
    command = COMMANDS[line.name]
    words = filled(command, line.words[2:])
    if words[0].startswith("-"):  # a page may leave out what the command is about
        words = [*argument_of(command), *words]
    names = Path("names.toml")  # read with the words that name it
    names.write_text('M_b = "slew.torque"', encoding="utf-8")
    values = command.make_context(line.name, words).params
    for group in command.given(values).values():
        CHECKS.get(type(group), lambda _: None)(group)
    assert list(Path().iterdir()) == [names]


# The tables of docs/command-line.md.


def section(title: str) -> str:
    text = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    return text.split(f"\n## {title}\n")[1].split("\n## ")[0]


def rows(text: str, heading: str) -> list[list[str]]:
    """Return the cells of the table that begins with a heading."""
    table = text.split(f"\n| {heading} |")[1].partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in table]


def options_of(name: str) -> dict[str, click.Parameter]:
    return {max(each.opts, key=len): each for each in COMMANDS[name].params if isinstance(each, click.Option)}


def test_the_table_of_feedforward_has_its_options_as_its_help_has_them() -> None:
    command = options_of("crane-fmu feedforward")
    cells = [cell for cell, *_ in rows(section("crane-fmu feedforward"), "option")]
    written = dict(re.findall(r"`(--[a-z-]+)(?: ([^`]+))?`", " ".join(cells)))
    metavars = {name: (each.metavar or "").replace("...", "Z") for name, each in command.items()}
    assert written == metavars


def test_the_tables_name_all_profiles_formulations_and_methods() -> None:
    text = section("crane-fmu feedforward")
    cells = {row[0]: row[1] for row in rows(text, "option")}
    assert all(f"`{name}`" in cells["`--profile NAME`"] for name in TIME_LAWS)
    assert all(f"`{name}`" in cells["`--formulation NAME`"] for name in FORMULATIONS)
    methods = re.findall(r"`([a-z0-9-]+)`", " ".join(row[0] for row in rows(text, "method")))
    assert sorted(methods) == sorted(METHODS)


SHARED = set(options_of("servocore feedforward")) - {"--columns", "--verbose"}


@pytest.mark.parametrize("name", [each for each in COMMANDS if each.startswith("servocore")])
def test_the_table_of_servocore_has_what_is_of_a_command_alone(name: str) -> None:
    command, written = "", dict[str, set[str]]()
    for first, second, *_ in rows(section("servocore"), "command"):
        command = f"servocore {first.strip('`').split()[0]}" if first else command
        written.setdefault(command, set()).update(re.findall(r"--[a-z-]+", second.replace("`-o", "`--output")))
    own = set(options_of(name)) - SHARED if name != "servocore feedforward" else set[str]()
    assert written.get(name, set()) - SHARED == own


@pytest.mark.parametrize("name", ["build", "ssp", "drive", "demo", "plan", "view"])
def test_the_section_of_a_crane_command_names_its_options(name: str) -> None:
    text = section(f"crane-fmu {name}")
    short = text.replace("`-o", "`--output")
    shared = set(options_of("crane-fmu feedforward"))
    assert [each for each in options_of(f"crane-fmu {name}") if each not in short and each not in shared] == []
