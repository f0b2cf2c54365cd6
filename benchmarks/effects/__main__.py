"""Compare estimates with simulations and write docs/effects, and the picture of docs/model-levels.md."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.effects.cases import DURATIONS, STUDY, STUDY_OPEN, cases
from benchmarks.effects.figures import draw_comparison, draw_levels
from benchmarks.effects.fresh import fresh_cases
from benchmarks.effects.measure import Verdict, all_pairs, own_errors, pairs, shown_estimates
from benchmarks.effects.page import page, pairs_of, table_of

DOCS = Path(__file__).parents[2] / "docs"
_OWN_DURATION = 5.0  # s


def main(arguments: list[str] | None = None) -> int:
    """Measure and write; returns 1 if of either set fewer than 95 % are within 10 %, or an estimate crosses a line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.effects", description=__doc__)
    parser.add_argument("--out", type=Path, default=DOCS, help="folder with the pages")
    parser.add_argument("--draw", action="store_true", help="measure nothing: figures from the tables that are there")
    chosen = parser.parse_args(arguments)
    target = chosen.out
    if chosen.draw:
        for name in ("comparison", "fresh"):
            known_pairs = pairs_of((target / "effects" / f"{name}.csv").read_text(encoding="utf-8"))
            draw_comparison(known_pairs, target / "effects" / f"{name}.png")
            if name == "comparison":
                draw_levels(known_pairs, target / "pictures" / "effects.png")
        return 0
    known = cases()
    found = all_pairs((each, DURATIONS) for each in known)
    fresh = all_pairs((each, (duration,)) for each, duration in fresh_cases())
    without_drives = [each for case in known if case.name in STUDY_OPEN for each in pairs(case, None)]
    own = [each for case in known for each in own_errors(case, _OWN_DURATION)]
    folder, pictures = target / "effects", target / "pictures"
    for each in (folder, pictures):
        each.mkdir(parents=True, exist_ok=True)
    draw_levels(found, pictures / "effects.png")
    for name, pairs_ in (("comparison", found), ("fresh", fresh)):
        draw_comparison(pairs_, folder / f"{name}.png")
        (folder / f"{name}.csv").write_text(table_of(pairs_), encoding="utf-8")
    text = page(found, fresh, without_drives, own, _OWN_DURATION, STUDY, STUDY_OPEN)
    (folder / "index.md").write_text(text, encoding="utf-8")
    verdicts = [Verdict.of(shown_estimates(each)) for each in (found, fresh)]
    print("\n".join(map(str, verdicts)))
    return 0 if all(each.kept for each in verdicts) else 1


if __name__ == "__main__":
    raise SystemExit(main())
