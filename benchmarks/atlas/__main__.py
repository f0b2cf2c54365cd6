"""Measure every row of the atlas and write docs/stability: results.csv, figures, page.

What was measured stays in build/atlas: with --draw the figures are drawn from there again.
"""

from __future__ import annotations

import argparse
import pickle
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from benchmarks.atlas.page import page
from benchmarks.atlas.record import Findings, read_csv, write_csv
from benchmarks.atlas.rows import ROWS, measured
from benchmarks.atlas.style import drawn, save
from benchmarks.atlas.summary import NAME, draw_summary

TARGET = Path(__file__).parents[2] / "docs" / "stability"
KEPT = Path(__file__).parents[2] / "build" / "atlas"
PROCESSES = 2


def main(arguments: list[str] | None = None) -> int:
    """Run the atlas; returns 1 if something was not as predicted."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.atlas", description=__doc__)
    parser.add_argument("--out", type=Path, default=TARGET, help="folder to write to")
    parser.add_argument("--processes", type=int, default=PROCESSES, help="rows measured at the same time")
    parser.add_argument("--draw", action="store_true", help="measure nothing: figures from what the last run kept")
    chosen = parser.parse_args(arguments)
    if chosen.draw:
        _draw(chosen.out, [pickle.loads((KEPT / f"{row.name}.pickle").read_bytes()) for row in ROWS])
        return 0
    begun = time.perf_counter()
    # A process of its own for every row: memory that one row measures is not another's.
    with ProcessPoolExecutor(chosen.processes, max_tasks_per_child=1) as pool:
        waiting = [pool.submit(measured, row.name, False) for row in ROWS]
        findings = []
        for row, each in zip(ROWS, waiting, strict=True):
            findings.append(each.result())
            KEPT.mkdir(parents=True, exist_ok=True)
            (KEPT / f"{row.name}.pickle").write_bytes(pickle.dumps(findings[-1]))
            print(f"{time.perf_counter() - begun:6.0f} s  {row.title}: {len(findings[-1].records)} observations")
    chosen.out.mkdir(parents=True, exist_ok=True)
    write_csv(chosen.out / "results.csv", [record for found in findings for record in found.records])
    _draw(chosen.out, findings)
    (chosen.out / "index.md").write_text(page(ROWS, findings), encoding="utf-8")
    surprises = [record for found in findings for record in found.surprises()]
    for record in surprises:
        print(f"not as predicted: {record}")
    print(f"wrote {chosen.out} in {time.perf_counter() - begun:.0f} s")
    return 1 if surprises else 0


def _draw(folder: Path, findings: list[Findings]) -> None:
    """Draw the figure of every row, and one of all rows from the table."""
    for row, found in zip(ROWS, findings, strict=True):
        save(drawn(row, found), folder, row.name)
    save(draw_summary(ROWS, read_csv(folder / "results.csv")), folder, NAME)


if __name__ == "__main__":
    sys.exit(main())
