"""Compare estimates with simulations and write docs/effects, and the picture of docs/model-levels.md."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.effects.cases import STUDY, STUDY_OPEN, cases
from benchmarks.effects.figures import draw_comparison, draw_levels
from benchmarks.effects.measure import all_pairs, own_errors, pairs
from benchmarks.effects.page import page, table_of

DOCS = Path(__file__).parents[2] / "docs"
_OWN_DURATION = 5.0  # s


def main(arguments: list[str] | None = None) -> int:
    """Measure and write; returns 1 if fewer than 95 % of the estimates are within 10 %, or one crosses a line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.effects", description=__doc__)
    parser.add_argument("--out", type=Path, default=DOCS, help="folder with the pages")
    target = parser.parse_args(arguments).out
    found, known = all_pairs(), cases()
    without_drives = [each for case in known if case.name in STUDY_OPEN for each in pairs(case, None)]
    own = [each for case in known for each in own_errors(case, _OWN_DURATION)]
    folder, pictures = target / "effects", target / "pictures"
    for each in (folder, pictures):
        each.mkdir(parents=True, exist_ok=True)
    draw_levels(found, pictures / "effects.png")
    draw_comparison(found, folder / "comparison.png")
    (folder / "comparison.csv").write_text(table_of(found), encoding="utf-8")
    text = page(found, without_drives, own, _OWN_DURATION, STUDY, STUDY_OPEN)
    (folder / "index.md").write_text(text, encoding="utf-8")
    near = sum(abs(each.ratio - 1) <= 0.1 for each in found)
    print(f"{near} of {len(found)} within 10 %, {sum(each.same_side for each in found)} on the same side of all lines")
    return 0 if near >= 0.95 * len(found) and all(each.same_side for each in found) else 1


if __name__ == "__main__":
    raise SystemExit(main())
