"""Measure every row of the atlas and write docs/stability: results.csv, figures, page."""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from benchmarks.atlas.page import page
from benchmarks.atlas.record import write_csv
from benchmarks.atlas.rows import ROWS, measured
from benchmarks.atlas.style import drawn, save

TARGET = Path(__file__).parents[2] / "docs" / "stability"
PROCESSES = 2


def main(arguments: list[str] | None = None) -> int:
    """Run the atlas; returns 1 if something was not as predicted."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.atlas", description=__doc__)
    parser.add_argument("--out", type=Path, default=TARGET, help="folder to write to")
    parser.add_argument("--processes", type=int, default=PROCESSES, help="rows measured at the same time")
    chosen = parser.parse_args(arguments)
    begun = time.perf_counter()
    # A process of its own for every row: memory that one row measures is not another's.
    with ProcessPoolExecutor(chosen.processes, max_tasks_per_child=1) as pool:
        waiting = [pool.submit(measured, row.name, False) for row in ROWS]
        findings = []
        for row, each in zip(ROWS, waiting, strict=True):
            findings.append(each.result())
            print(f"{time.perf_counter() - begun:6.0f} s  {row.title}: {len(findings[-1].records)} observations")
    chosen.out.mkdir(parents=True, exist_ok=True)
    write_csv(chosen.out / "results.csv", [record for found in findings for record in found.records])
    for row, found in zip(ROWS, findings, strict=True):
        save(drawn(row, found), chosen.out, row.name)
    (chosen.out / "index.md").write_text(page(ROWS, findings), encoding="utf-8")
    surprises = [record for found in findings for record in found.surprises()]
    for record in surprises:
        print(f"not as predicted: {record}")
    print(f"wrote {chosen.out} in {time.perf_counter() - begun:.0f} s")
    return 1 if surprises else 0


if __name__ == "__main__":
    sys.exit(main())
