"""Measured levels as text: CSV for machines, the page docs/model-levels.md, and cells that tables share."""

from __future__ import annotations

import csv
import io
import platform
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import casadi as ca

from benchmarks.levels.costs import Cost, Level, Spread

COLUMNS = (
    "scene", "model", "needed", "coordinates", "index", "internal_degrees_of_freedom", "route", "unknowns",
    "microseconds", "microseconds_lower_quartile", "microseconds_upper_quartile", "error", "refusal", "machine",
)  # fmt: skip

_EFFECTS = """# Which model is enough, and what it costs

## Which physical effects a model needs

![tracking error of the load for every neglected effect](pictures/effects.png)

*The error of each effect alone: the plant has it, the model that computes the inputs has not. Position loops of 6
rad/s, damping 1. Left: the scene with a load of 100 kg; right: a crane with a load of 2 t. For a tolerance of 1, 10
or 100 mm (dashed) a model needs every effect to the right of that line.*

* A faster motion needs more effects: the errors of hook and load inertia are below 2 mm at 20 s, but not at 5 s.
* Position loops compensate for effects that act like a force (friction, winch inertia, the rope's weight), not for
  those that act like a motion (sheave offset, wind, flexible bridge, drag, hook).
* A model with the sheave offset costs no more: it has the same index and as many unknowns.

For a scene, path and drives of your own:

    servocore effects rotary_crane --deviation 5mm --bandwidth 6

```python
import servocore as sc

crane = sc.scenes.overhead_crane()
report = sc.effects(crane, loops=sc.PositionLoops(bandwidth=6.0, damping=1.0), tolerance=0.02)
print(report)  # a table, worst first, and the verdict
better = crane.with_effects("friction").with_parameters(trolley_friction=20.0)
```

`report.smallest()` is the scene with all effects that are needed; `crane.effects.declared` lists every assumption
with its source and parameters. Errors are estimated, and simulated where an estimate is unreliable
([comparison](effects/index.md), [decision 80](decisions/0080-effects.md)).

"""
"""Opens the page; its picture is from `make effects`."""

_PAGE = """## What the models of a scene cost

The models of a scene describe the same system and give the same inputs: the first one, the default, is enough. Others
serve for comparison, and for quantities that only they have.

* *exact*: the derivative array, solved instant by instant ([decision 6](decisions/0006-exact-inversion.md)). With
  internal dynamics: one step of `RadauIIA(3)` on the `Reduced` form.
* *projected*: one step of backward Euler on the projected equations, the method of the paper.

Times are processor times, the median of {repeats} warm runs over {instants} instants; *error* is the largest error of
any input, relative to its peak. Written by

    make levels

from one run on {machine}; ratios are more reliable than times. [model-levels.csv](model-levels.csv) has unknowns,
quartiles and refusals as well, and [scenes.md](scenes.md) coordinates and indices.

{table}

{refusals}The error of exact inversion is round-off for every model; that of the projected step is of first order in
the step. Fewer coordinates do not mean less work: equations in generalized coordinates do not decompose into blocks
([decision 3](decisions/0003-block-triangular-newton.md)).
"""


def csv_text(levels: Sequence[Level], on: str) -> str:
    """Return one line a model and route, times in microseconds an instant; unknown values are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for level in levels:
        size = level.scene, level.model, int(level.needed), level.coordinates, level.index
        states = level.internal_degrees_of_freedom
        for route, cost in level.costs.items():
            spread = cost.microseconds
            times = (spread.median, spread.lower, spread.upper) if spread else (None,) * 3
            writer.writerow((*size, states, route, cost.unknowns, *times, cost.error, cost.refusal, on))
    return text.getvalue()


def read_levels(text: str) -> tuple[list[Level], str]:
    """Undo `csv_text`; returns the levels, without the names of their methods, and the machine."""
    found: dict[tuple[str, str], Level] = {}
    lines = list(csv.DictReader(io.StringIO(text)))
    for line in lines:
        values = [float(line[name]) for name in COLUMNS[8:11] if line[name]]
        cost = Cost(
            int(line["unknowns"]) if line["unknowns"] else None,
            Spread(*values) if values else None,
            float(line["error"]) if line["error"] else None,
            refusal=line["refusal"],
        )
        coordinates, index, states = (int(line[name]) for name in COLUMNS[3:6])
        level = Level(line["scene"], line["model"], line["needed"] == "1", coordinates, index, states, {})
        found.setdefault((level.scene, level.model), level).costs[line["route"]] = cost
    return list(found.values()), lines[0]["machine"]


HEADINGS = (
    "model", "coordinates", "index", "internal states",
    "route", "unknowns", "µs an instant", "quartiles", "of projected", "error",
)  # fmt: skip
"""Headings of the columns that `rows` fills."""


def rows(level: Level) -> list[tuple[str, ...]]:
    """Rows of a table for humans, one a route; what belongs to the model stands in the first."""
    own = (level.model, *map(str, (level.coordinates, level.index, level.internal_degrees_of_freedom)))
    projected = level.costs["projected"].microseconds
    found = []
    for route, cost in level.costs.items():
        spread, times = cost.microseconds, ("-", "-", "-")
        if spread is not None:
            ratio = f"{spread.median / projected.median:.2g}" if projected is not None else "-"
            times = f"{spread.median:.3g}", f"{spread.lower:.3g} to {spread.upper:.3g}", ratio
        error = "-" if cost.error is None else f"{cost.error:.1e}"
        found.append((*own, route, str(cost.unknowns or "-"), *times, error))
        own = ("",) * len(own)
    return found


def remarks(levels: Sequence[Level]) -> list[str]:
    """Sentences to go below the table of one scene: what it needs, what was refused, what is integrated."""
    name = levels[0].scene
    needed = next(level for level in levels if level.needed)
    found = [f"{name} needs no more than the model {needed.model}, its first; the others give the same inputs."]
    if len(levels) == 1:
        found = [f"{name} has one model, {needed.model}."]
    if states := needed.internal_degrees_of_freedom:
        found.append(
            f"It has internal dynamics of {states} states, which no inversion gives pointwise:"
            f" exact stands for one step of {needed.costs['exact'].method} on the reduced form."
        )
    found += [
        f"{level.model}, {route}: {cost.refusal}."
        for level in levels
        for route, cost in level.costs.items()
        if cost.refusal
    ]
    return found


PAGE_HEADINGS = (
    "scene", "model", "exact, µs", "error", "projected, µs", "error", "exact : projected",
)  # fmt: skip


def markdown_page(levels: Sequence[Level], *, instants: int, repeats: int, on: str) -> str:
    """Return the page docs/model-levels.md for the models of any number of scenes, measured on a machine."""
    lines = [PAGE_HEADINGS, ("---",) * len(PAGE_HEADINGS), *map(_page_row, levels)]
    table = "\n".join("| " + " | ".join(row) + " |" for row in lines)
    refused = [
        f"{level.scene}, {level.model}, {route}: {cost.refusal}.\n\n"
        for level in levels
        for route, cost in level.costs.items()
        if cost.refusal
    ]
    return _EFFECTS + _PAGE.format(
        repeats=repeats, instants=instants, machine=on, table=table, refusals="".join(refused)
    )


def _page_row(level: Level) -> tuple[str, ...]:
    exact, projected = (level.costs[route] for route in ("exact", "projected"))
    cells = []
    for cost in (exact, projected):
        cells.append("-" if cost.microseconds is None else f"{cost.microseconds.median:.3g}")
        cells.append("-" if cost.error is None else f"{cost.error:.1e}")
    ratio = "-"
    if exact.microseconds is not None and projected.microseconds is not None:
        ratio = f"{exact.microseconds.median / projected.microseconds.median:.2g}"
    return level.scene, level.model, *cells, ratio


def machine() -> str:
    """Return processor, Python and CasADi as text."""
    return f"{_processor()}, Python {platform.python_version()}, CasADi {ca.__version__}"


def _processor() -> str:
    with suppress(OSError):
        models = re.findall(r"^model name.*?:(.*)", Path("/proc/cpuinfo").read_text(encoding="utf-8"), re.MULTILINE)
        if models:
            return f"{models[0].strip()} ({len(models)} processors)"
    return platform.processor() or platform.machine()
