"""Measured levels as text: CSV for machines, the page docs/model-levels.md, and cells that tables share."""

from __future__ import annotations

import csv
import io
import platform
import re
from collections.abc import Sequence
from contextlib import suppress
from itertools import groupby
from pathlib import Path

import casadi as ca

from benchmarks.levels.costs import Level

COLUMNS = (
    "scene", "model", "needed", "coordinates", "index", "internal_degrees_of_freedom", "route", "unknowns",
    "microseconds", "microseconds_lower_quartile", "microseconds_upper_quartile", "error", "refusal",
)  # fmt: skip

_EFFECTS = """# Which model is enough, and what it costs

## Which physical effects a model needs

![error of the load's path for every effect that is left out](pictures/effects.png)

*The figure shows the error of each effect by itself: the plant has the effect, and the model that computes the inputs
has not. Drives have position loops of 6 rad/s and damping 1. Left: the scene with a load of 100 kg; right: a crane with
a load of 2 t. For a tolerance of 1, 10 or 100 mm (dashed) a model needs every effect to the right of that line.*

* A faster motion needs more effects: the errors of hook and rigid load are below 2 mm at 20 s, but not at 5 s.
* Drives compensate for effects that act like a force (friction, winch inertia, the rope's weight); stiffer drives do
  it better. They cannot compensate for effects that act like a motion (rope exit, wind, flexible bridge, drag, hook):
  only a better model helps.
* A model with the rope's exit beside the trolley's centre costs no more: it has the same index and as many unknowns.

For a scene of your own, its path and your drives:

    servocore effects rotary_crane --deviation 5mm --bandwidth 6

```python
import servocore as sc

crane = sc.scenes.overhead_crane()
report = sc.effects(crane, drives=sc.Drives(bandwidth=6.0, damping=1.0), tolerance=0.02)
print(report)  # a table, worst first, and the verdict
better = crane.with_effects("friction").with_parameters(trolley_friction=20.0)
```

`report.smallest()` is the scene with all effects that are needed, for `solve`, `ExactInversion` and `export_fmu`;
`crane.effects.declared` lists every assumption with its source and its parameters. Errors are estimated, and simulated
where an estimate is not reliable: [effects/](effects/index.md) compares the two,
[decision 80](decisions/0080-effects.md) explains the method.

"""
"""Opens the page; its picture is from `make effects`."""

_PAGE = """## What the models of a scene cost

A scene offers models of different size of the same system. All give the same inputs, so a user needs only the first,
which is the default of every command. The others serve for comparison, and for quantities that only they have.

For every model these tables compare two routes:

* *exact*: the derivative array, solved instant by instant ([theory, section 5](theory.md),
  [decision 6](decisions/0006-exact-inversion.md)). A scene with internal dynamics has no such inversion; there the row
  is one step of `RadauIIA(3)` on the `Reduced` form, which integrates them.
* *projected*: one step of backward Euler on the projected equations, the method of the paper.

*Unknowns* are those of one instant. Times are processor times, the median and the quartiles of {repeats} warm runs
over {instants} instants; *of projected* is the ratio to the projected step of the same model. *Error* is the largest
error of any input over the whole path, as a fraction of that input's largest value.

This page is written by

    make levels

and comes from one run on {machine}.
Other processes may have used the machine at the same time: the ratios are more reliable than the times.

{tables}
## Reading it

* The error of exact inversion is round-off, whatever the model and the number of instants. That of the projected step
  is of first order in the step, and the figures hold for {instants} instants.
* With internal dynamics the exact row has the error of its integration, and of the independent solution that it is
  compared with.
* Fewer coordinates do not mean less work: generalized coordinates fill the mass matrix with sines, and their equations
  do not fall apart into blocks ([decision 3](decisions/0003-block-triangular-newton.md)).
* A route that a model does not offer says why below its table.
* `python -m benchmarks.levels SCENE --csv FILE.csv` writes the figures for machines.
"""


def csv_text(levels: Sequence[Level]) -> str:
    """Return one line a model and route, times in microseconds an instant; what is unknown is empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for level in levels:
        size = level.scene, level.model, int(level.needed), level.coordinates, level.index
        states = level.internal_degrees_of_freedom
        for route, cost in level.costs.items():
            spread = cost.microseconds
            times = (spread.median, spread.lower, spread.upper) if spread else (None,) * 3
            writer.writerow((*size, states, route, cost.unknowns, *times, cost.error, cost.refusal))
    return text.getvalue()


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


def markdown_page(levels: Sequence[Level], *, instants: int, repeats: int) -> str:
    """Return the page docs/model-levels.md for the models of any number of scenes."""
    tables = []
    for name, group in groupby(levels, key=lambda level: level.scene):
        listed = list(group)
        table = [HEADINGS, ("---",) * len(HEADINGS), *(row for level in listed for row in rows(level))]
        lines = [f"## `{name}`", "", *("| " + " | ".join(row) + " |" for row in table), "", *remarks(listed), ""]
        tables.append("\n".join(lines))
    figures = _PAGE.format(repeats=repeats, instants=instants, machine=machine(), tables="\n".join(tables))
    return _EFFECTS + figures


def machine() -> str:
    """Processor, Python and CasADi, for whoever reads measured figures."""
    return f"{_processor()}, Python {platform.python_version()}, CasADi {ca.__version__}"


def _processor() -> str:
    with suppress(OSError):
        models = re.findall(r"^model name.*?:(.*)", Path("/proc/cpuinfo").read_text(encoding="utf-8"), re.MULTILINE)
        if models:
            return f"{models[0].strip()} ({len(models)} processors)"
    return platform.processor() or platform.machine()
