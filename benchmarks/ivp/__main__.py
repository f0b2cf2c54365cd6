"""Measure work and precision on problems of the test set of Bari, and write docs/ivp-test-set.md.

.venv/peers/bin/python -m benchmarks.ivp [problem ...]        (some ten minutes)
"""

from __future__ import annotations

import importlib.util
import json
import platform
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass
from functools import partial
from pathlib import Path

import servocore as sc
from benchmarks.ivp import peer
from benchmarks.ivp.long import LongProblem, long_problems
from benchmarks.ivp.problems import IvpProblem, at_the_end, digits, problems

PAGE = Path(__file__).resolve().parents[2] / "docs" / "ivp-test-set.md"
TEMPLATE, ROWS = (Path(__file__).parent / name for name in ("page.md", "rows.json"))
LONGEST, LONG = 20, 4  # s of CPU time that a run may take, and that it may take to be run twice
LONGEST_OF_LONG = 60  # s, of the problems of long duration


@dataclass(frozen=True)
class Row:
    """One run: what it found at the end, empty if it failed, and CPU time in s."""

    route: str
    setting: str
    found: dict[str, float]
    seconds: float
    remark: str = ""


def measured(route: str, setting: str, solve: Callable[[], dict[str, float]], longest: int = LONGEST) -> Row:
    """Run once to compile, and once more unless that took long."""
    seconds, found = 0.0, dict[str, float]()
    try:
        for _ in range(2):
            signal.setitimer(signal.ITIMER_PROF, longest)
            begun = time.process_time()
            found = solve()
            seconds = time.process_time() - begun
            if seconds > LONG:
                break
    except (RuntimeError, ValueError, TimeoutError, sc.ServocoreError) as error:
        return Row(route, setting, {}, 0.0, str(error) or type(error).__name__)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return Row(route, setting, found, seconds)


def own_rows(problem: IvpProblem) -> Iterator[Row]:
    """Run the routes of servocore."""
    for route, solve in problem.own.items():
        name, what = route.rsplit(", ", 1)
        for setting in problem.settings[route]:
            run = partial(_last, solve, setting)
            yield measured(name, f"{what} = {setting:g}", run)


def _last(solve: Callable[[float], sc.Solution], setting: float) -> dict[str, float]:
    return at_the_end(solve(setting))


def peer_rows(problem: IvpProblem) -> Iterator[Row]:
    """Run scipy_dae, where it is installed."""
    if importlib.util.find_spec("scipy_dae") is None:
        return
    for name, method in peer.METHODS.items():
        for tolerance in peer.TOLERANCES:
            solve = partial(peer.run, problem, method, tolerance)
            yield measured(f"scipy_dae, {name}", f"rtol = {tolerance:g}", solve)


def long_rows(problem: LongProblem) -> Iterator[Row]:
    """Run a problem of long duration by all routes and solvers."""
    runs = [*((*key, run) for key, run in problem.own.items()), *problem.peers()]
    for route, setting, run in runs:
        yield measured(route, setting, run, LONGEST_OF_LONG)


def long_table(rows: list[Row]) -> str:
    """Return the rows of a problem of long duration as a table of Markdown."""
    lines = ["| route | setting | error at the end | constraints | CPU time, s |", "|---|---|---|---|---|"]
    for row in rows:
        if row.found:
            found = f"{row.found['error']:.1e} | {row.found['constraints']:.1e} | {row.seconds:.1f}"
        else:
            found = f"- | - | fails: {row.remark.rstrip('.')}"
        lines.append(f"| {row.route} | {row.setting} | {found} |")
    return "\n".join(lines)


def table(problem: IvpProblem, rows: list[Row]) -> str:
    """Return the rows as a table of Markdown."""
    exact, lines = (
        problem.reference(),
        ["| route | setting | coordinates | all | CPU time, s |", "|---|---|---|---|---|"],
    )
    for row in rows:
        correct = digits(row.found, exact)
        worst = min((v for k, v in correct.items() if k in problem.system.coordinates.names), default=None)
        if worst is None:
            lines.append(f"| {row.route} | {row.setting} | - | - | fails: {row.remark.rstrip('.')} |")
        else:
            least = min(correct.values())
            lines.append(f"| {row.route} | {row.setting} | {worst:.1f} | {least:.1f} | {row.seconds:.2f} |")
    return "\n".join(lines)


def published_digits(problem: IvpProblem) -> str:
    """Say how many digits the published values have, by kind."""
    correct = digits(problem.published, problem.reference())
    kinds: dict[str, Callable[[str], bool]] = {
             "coordinates": lambda name: name in problem.system.coordinates.names,
             "rates": lambda name: name.endswith("_dot"),
             "multipliers": lambda name: name.startswith("lam") or name == "T"}  # fmt: skip
    parts = [f"{kind} {min(v for k, v in correct.items() if chosen(k)):.1f}" for kind, chosen in kinds.items()]
    return "Digits that the published values have, at least: " + ", ".join(parts) + "."


def render(rows: dict[str, list[Row]], machine: str) -> str:
    """Put the tables into the page."""
    text = TEMPLATE.read_text().replace("{machine}", machine)
    for problem in problems():
        text = text.replace(
            f"{{{problem.name}}}", f"{published_digits(problem)}\n\n{table(problem, rows[problem.name])}"
        )
    for long in long_problems():
        text = text.replace(f"{{{long.name}}}", long_table(rows[long.name]))
    return text


def record() -> dict[str, list[Row]]:
    """Return what was measured last."""
    found = json.loads(ROWS.read_text()) if ROWS.exists() else {}
    return {name: [Row(*each) for each in rows] for name, rows in found.items()}


def main(names: Sequence[str]) -> None:
    """Measure the problems called `names`, or all, keep the rows, and write the page."""
    for problem in problems():
        if names and problem.name not in names:
            continue
        measured_now = [*own_rows(problem), *peer_rows(problem)]
        rows = record() | {problem.name: measured_now}
        _keep(problem.title, rows, measured_now)
    for long in long_problems():
        if not names or long.name in names:
            measured_now = list(long_rows(long))
            _keep(long.title, record() | {long.name: measured_now}, measured_now)
    PAGE.write_text(render(record(), f"{platform.machine()}, Python {platform.python_version()}"))


def _keep(title: str, rows: dict[str, list[Row]], new: list[Row]) -> None:
    print(title, *new, sep="\n", flush=True)
    ROWS.write_text(json.dumps({name: [astuple(row) for row in kept] for name, kept in rows.items()}, indent=0))


def _too_long(*_: object) -> None:
    raise TimeoutError("too much processor time")


if __name__ == "__main__":
    signal.signal(signal.SIGPROF, _too_long)
    warnings.simplefilter("ignore")
    main(sys.argv[1:])
