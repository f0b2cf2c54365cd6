"""Run the study and write its page: `python -m benchmarks.chart [--smoke] [--out FOLDER] [--only SCENE ...]`."""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from pathlib import Path

from benchmarks.chart.c_cost import measure_costs, shares_of_solve
from benchmarks.chart.figures import draw_all
from benchmarks.chart.page import write_page
from benchmarks.chart.rows import write_rows
from benchmarks.chart.study import PEERS, Effort, carry_out, problems, write_times

OUT = Path("docs") / "speed-accuracy"


def main(arguments: list[str]) -> None:
    """Measure, draw and write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.chart", description=__doc__)
    parser.add_argument("--out", type=Path, default=OUT, help="folder to write to")
    parser.add_argument("--smoke", action="store_true", help="one scene, two settings a solver: seconds")
    parser.add_argument("--only", nargs="*", default=(), help="scenes, for trying")
    parser.add_argument("--peers", nargs="*", default=PEERS, choices=PEERS, metavar="PEER", help="peers to measure")
    parser.add_argument("--quiet", action="store_true", help="say nothing")
    chosen = parser.parse_args(arguments)
    warnings.simplefilter("ignore")  # of peers; what fails has its row
    begin = time.perf_counter()

    def say(text: str) -> None:
        if not chosen.quiet:
            print(f"{time.perf_counter() - begin:7.1f} s  {text}", flush=True)

    effort = Effort(smoke=chosen.smoke, peers=tuple(chosen.peers), only=tuple(chosen.only),
                    budget=0.02 if chosen.smoke else 0.25)  # fmt: skip
    study = carry_out(effort, say)
    here = [each for each in problems() if each.name in study.scenes]
    models = list(here[0].scene.models)
    costs = measure_costs(here[0].scene, models[:1] if chosen.smoke else models, 2 if chosen.smoke else 15)
    shares = shares_of_solve(here[0].scene, 2 if chosen.smoke else 40)
    chosen.out.mkdir(parents=True, exist_ok=True)
    write_rows(chosen.out / "results.csv", study.rows)
    write_times(chosen.out / "times.csv", study.timed)
    draw_all(study, chosen.out)
    write_page(chosen.out / "index.md", study, here, costs, shares, (time.perf_counter() - begin) / 60)
    say(f"wrote {chosen.out}")


if __name__ == "__main__":
    main(sys.argv[1:])
