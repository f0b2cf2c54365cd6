"""Run the study and write its page: `python -m benchmarks.chart [--smoke] [--draw] [--out FOLDER] [--only SCENE]`."""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from pathlib import Path

from benchmarks.chart.facts import gather
from benchmarks.chart.figures import draw_all
from benchmarks.chart.page import PAGE, render, write_tables
from benchmarks.chart.record import read_record, write_record
from benchmarks.chart.scale import FILE, measure_scale, read_points, scale_page, write_points
from benchmarks.chart.scale import PAGE as SCALE_PAGE
from benchmarks.chart.study import PEERS, Effort, carry_out, problems

OUT = Path("docs") / "speed-accuracy"


def main(arguments: list[str]) -> None:
    """Measure, draw and write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.chart", description=__doc__)
    parser.add_argument("--out", type=Path, default=OUT, help="folder to write to")
    parser.add_argument("--smoke", action="store_true", help="one scene, two settings a solver: seconds")
    parser.add_argument("--draw", action="store_true", help="measure nothing: page and figures from the files there")
    parser.add_argument("--only", nargs="*", default=(), help="scenes, for trying")
    parser.add_argument("--peers", nargs="*", default=PEERS, metavar="PEER",
                        help="peers to measure")  # fmt: skip
    parser.add_argument("--quiet", action="store_true", help="say nothing")
    chosen = parser.parse_args(arguments)
    warnings.simplefilter("ignore")  # of peers; what fails has its row
    begin = time.perf_counter()

    def minutes() -> float:
        return round((time.perf_counter() - begin) / 60, 1)

    def say(text: str) -> None:
        if not chosen.quiet:
            print(f"{time.perf_counter() - begin:7.1f} s  {text}", flush=True)

    if not chosen.draw:
        effort = Effort(smoke=chosen.smoke, peers=tuple(chosen.peers), only=tuple(chosen.only),
                        budget=0.02 if chosen.smoke else 0.05)  # fmt: skip
        timed = carry_out(effort, say)
        measured = {each.row.scene for each in timed}
        facts = gather([each for each in problems() if each.name in measured], chosen.smoke)
        write_record(chosen.out, timed, {**facts, "minutes": minutes()})  # should sizes fail, this is not lost
        say("cost against size")
        write_points(chosen.out, measure_scale(chosen.smoke))
        write_record(chosen.out, timed, {**facts, "minutes": minutes()})
    record = read_record(chosen.out)
    draw_all(record, chosen.out)
    write_tables(record, chosen.out)
    (chosen.out / PAGE).write_text(render(record), encoding="utf-8")
    if (chosen.out / FILE).exists():
        (chosen.out / SCALE_PAGE).write_text(scale_page(read_points(chosen.out)), encoding="utf-8")
    say(f"wrote {chosen.out}")


if __name__ == "__main__":
    main(sys.argv[1:])
