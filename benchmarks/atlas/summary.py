"""One picture of all rows: the observations of each kind of route, by verdict."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from benchmarks.atlas.record import FAILS, REFUSED, SURVIVES, Record, Row
from benchmarks.atlas.style import BAD, GOOD, STYLE

NAME = "summary"
_ADVISED = (
    "energy-momentum", "solve", "analyse", "boundary-value", "with tolerance", "no tolerance", "marched",
    "follow_branch", "left out", "without_constraints", "constraint_rank", "loop closed", "consistent start",
)  # fmt: skip
_SHORTCUTS = ("without feedback", "pointwise")
_UNDAMPED = ("trapezoidal", "gauss", "generalized-alpha-1", "midpoint")
_DAMPED = ("projected", "generalized-alpha")
_EXACT = ("reduced", "exact inversion")
KINDS = (
    "original\nequations", "undamped\nmethods", "projected,\ndamped", "reduced,\nexact", "advised\nhere",
    "other\nroutes",
)  # fmt: skip
_FACES = {SURVIVES: GOOD, REFUSED: "#e4e4e4", FAILS: BAD}


def kind(route: str) -> int:
    """Return the number of the kind in `KINDS` that a route of the table belongs to."""
    words = (("original",), _UNDAMPED, _DAMPED, _EXACT)
    if any(word in route for word in _SHORTCUTS):
        return 5
    if any(word in route for word in _ADVISED):
        return 4
    return next((k for k, group in enumerate(words) if any(word in route for word in group)), 5)


ROW_HEIGHT, HIGH = 0.66, 4
"""Of a cell: its height, and the number of squares on top of one another."""


def draw_summary(rows: Sequence[Row], records: Sequence[Record]) -> Figure:
    """Draw a square for every observation: by row, kind of route and verdict."""
    counts = Counter((each.row, kind(each.route), each.verdict) for each in records)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(7.4, 0.32 * len(rows) + 1.1), layout="constrained")
        for line, row in enumerate(rows):
            for column in range(len(KINDS)):
                seen = [verdict for verdict in _FACES for _ in range(counts[row.name, column, verdict])]
                _squares(axes, column, line, seen)
        axes.set(xlim=(-0.05, len(KINDS)), ylim=(len(rows) - 0.4, -0.6))
        axes.set_yticks(range(len(rows)), [f"{k}  {row.title}" for k, row in enumerate(rows, 1)])
        axes.set_xticks([k + 0.45 for k in range(len(KINDS))], KINDS)
        axes.tick_params(length=0, labeltop=True, labelbottom=False)
        axes.grid(visible=False)
        axes.spines[:].set_visible(False)
        handles = [Patch(facecolor=face, edgecolor="0.4", lw=0.5, label=word) for word, face in _FACES.items()]
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _squares(axes: Axes, column: int, line: int, seen: Sequence[str]) -> None:
    """Draw one square an observation, in columns of `HIGH`, as wide in every cell."""
    high, wide = ROW_HEIGHT / HIGH, 0.1
    for k, verdict in enumerate(seen):
        corner = column + wide * (k // HIGH), line - ROW_HEIGHT / 2 + high * (k % HIGH)
        axes.add_patch(Rectangle(corner, 0.85 * wide, 0.85 * high, facecolor=_FACES[verdict], edgecolor="0.4", lw=0.4))
