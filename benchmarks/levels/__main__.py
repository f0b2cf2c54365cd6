"""Measure what the models of scenes cost and how exact they are; print tables, write the page docs/model-levels.md.

``python -m benchmarks.levels rotary_crane`` measures one scene; without a name it takes all of them.
With ``--stored`` the page is written again from a file that ``--csv`` wrote.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import rich.box
import rich.table

from benchmarks.levels.costs import Level
from benchmarks.levels.measurement import measure_levels
from benchmarks.levels.tables import HEADINGS, csv_text, machine, markdown_page, read_levels, remarks, rows
from servocore.cli.console import table_console
from servocore.files import write_together
from servocore.scenes import REGISTRY

_REPEATS = 15


def main(arguments: list[str] | None = None) -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.levels", description=__doc__)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="all without a name")
    parser.add_argument("--instants", type=int, default=1000, help="steps of a run; the projected error depends on it")
    parser.add_argument("--csv", type=Path, metavar="FILE.csv", help="write the figures for machines")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="write the page of the documentation")
    parser.add_argument("--stored", type=Path, metavar="FILE.csv", help="measure nothing: read what --csv wrote")
    asked = parser.parse_args(arguments)
    names = asked.scenes or list(REGISTRY)
    if unknown := [name for name in names if name not in REGISTRY]:
        parser.error(f"no scene is called {unknown[0]}; there are {', '.join(REGISTRY)}")
    levels: list[Level] = []
    on = machine()
    if asked.stored is not None:
        levels, on = read_levels(asked.stored.read_text(encoding="utf-8"))
    for name in names if asked.stored is None else ():
        found = measure_levels(REGISTRY[name](), instants=asked.instants, repeats=_REPEATS)
        _show(name, found)
        levels += found
    texts = {}
    if asked.csv is not None:
        texts[asked.csv] = csv_text(levels, on)
    if asked.page is not None:
        texts[asked.page] = markdown_page(levels, instants=asked.instants, repeats=_REPEATS, on=on)
    write_together(texts)


def _show(name: str, levels: tuple[Level, ...]) -> None:
    table = rich.table.Table(box=rich.box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for heading in HEADINGS:
        table.add_column(heading, justify="left" if heading in ("model", "route") else "right")
    for level in levels:
        for row in rows(level):
            table.add_row(*row, style="bold" if level.needed else None)
    table_console().print(f"[bold]{name}[/bold]", table, *remarks(levels), "", sep="\n")


if __name__ == "__main__":
    main()
