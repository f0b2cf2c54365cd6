"""Measure the rows of the atlas and write docs/stability: results.csv, facts.json, figures, page.

--row measures single rows and keeps the stored results of all others. --page measures nothing: it writes the page and
the figure of all rows again from the stored results.
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from benchmarks.atlas.page import page
from benchmarks.atlas.record import FACTS, RECORDS, Findings, read_findings, write_csv, write_facts
from benchmarks.atlas.rows import ROWS, measured
from benchmarks.atlas.style import drawn, save
from benchmarks.atlas.summary import NAME, draw_summary

TARGET = Path(__file__).parents[2] / "docs" / "stability"
PROCESSES = 2


def main(arguments: list[str] | None = None) -> int:
    """Run the atlas; returns 1 if something was not as predicted."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.atlas", description=__doc__)
    parser.add_argument("--out", type=Path, default=TARGET, help="folder to write to")
    parser.add_argument("--processes", type=int, default=PROCESSES, help="rows measured at the same time")
    parser.add_argument("--row", action="append", choices=[row.name for row in ROWS], help="measure this row only")
    parser.add_argument("--page", action="store_true", help="measure nothing: the page from the stored results")
    chosen = parser.parse_args(arguments)
    names = [] if chosen.page else chosen.row or [row.name for row in ROWS]
    begun = time.perf_counter()
    new: dict[str, Findings] = {}
    # A process of its own for every row: memory that one row measures is not another's.
    with ProcessPoolExecutor(chosen.processes, max_tasks_per_child=1) as pool:
        waiting = [pool.submit(measured, name, False) for name in names]
        for name, each in zip(names, waiting, strict=True):
            new[name] = each.result()
            print(f"{time.perf_counter() - begun:6.0f} s  {name}: {len(new[name].records)} observations")
    chosen.out.mkdir(parents=True, exist_ok=True)
    stored = {} if len(new) == len(ROWS) else {each.row: each for each in read_findings(chosen.out, ROWS)}
    findings = [new.get(row.name) or stored[row.name] for row in ROWS]
    write_csv(chosen.out / RECORDS, [record for found in findings for record in found.records])
    write_facts(chosen.out / FACTS, findings)
    for row in ROWS:
        if row.name in new:
            save(drawn(row, new[row.name]), chosen.out, row.name)
    save(draw_summary(ROWS, [record for found in findings for record in found.records]), chosen.out, NAME)
    (chosen.out / "index.md").write_text(page(ROWS, findings), encoding="utf-8")
    surprises = [record for found in findings for record in found.surprises()]
    for record in surprises:
        print(f"not as predicted: {record}")
    print(f"wrote {chosen.out} in {time.perf_counter() - begun:.0f} s")
    return 1 if surprises else 0


if __name__ == "__main__":
    sys.exit(main())
