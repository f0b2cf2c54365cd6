"""Run or continue the study and write its page."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.identification.page import page
from benchmarks.identification.peers import table
from benchmarks.identification.study import cases, continued

FOLDER = Path(__file__).parents[2] / "docs" / "identification"


def main() -> None:
    """Run the cases that the file of results lacks, writing the page after each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cranes", type=int, default=25, help="of each kind, for good and for coarse logs")
    parser.add_argument(
        "--special", type=int, default=3, help="of each kind in motion, with two logs, and wrong plants"
    )
    parser.add_argument("--first", type=int, default=1000, help="first seed")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="of page and results")
    parser.add_argument("--fresh", action="store_true", help="begin anew")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    file = options.folder / "study.jsonl"
    if options.fresh:
        for each in (file, options.folder / "peers.json"):
            each.unlink(missing_ok=True)
    peers = table(options.folder)
    for rows in continued(file, cases(options.cranes, options.special, options.first)):
        (options.folder / "index.md").write_text(page(rows, peers), encoding="utf-8")
        if rows:
            row = rows[-1]
            print(*vars(row.case).values(), f"{row.seconds:.1f} s", row.doubts or row.refused, row.stray, row.predicted)


if __name__ == "__main__":
    main()
