"""One picture of all rows: which kind of route survives what, by shares of the observations."""

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
    "original\nequations", "undamped\nmethods", "projected,\ndamped", "reduced,\nexact", "what this\npage advises",
    "other\nways",
)  # fmt: skip
_FACES = {SURVIVES: (GOOD, "white"), REFUSED: ("#e4e4e4", "black"), FAILS: (BAD, "white")}


def kind(route: str) -> int:
    """Return the number of the kind in `KINDS` that a route of the table belongs to."""
    words = (("original",), _UNDAMPED, _DAMPED, _EXACT)
    if any(word in route for word in _SHORTCUTS):
        return 5
    if any(word in route for word in _ADVISED):
        return 4
    return next((k for k, group in enumerate(words) if any(word in route for word in group)), 5)


def draw_summary(rows: Sequence[Row], records: Sequence[Record]) -> Figure:
    """Draw a bar for every row and kind of route: shares that survive, are refused, fail, with their numbers."""
    counts = Counter((each.row, kind(each.route), each.verdict) for each in records)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(7.4, 0.32 * len(rows) + 1.1), layout="constrained")
        for line, row in enumerate(rows):
            for column in range(len(KINDS)):
                _bar(axes, column, line, {verdict: counts[row.name, column, verdict] for verdict in _FACES})
        axes.set(xlim=(-0.05, len(KINDS)), ylim=(len(rows) - 0.4, -0.6))
        axes.set_yticks(range(len(rows)), [f"{k}  {row.title}" for k, row in enumerate(rows, 1)])
        axes.set_xticks([k + 0.45 for k in range(len(KINDS))], KINDS)
        axes.tick_params(length=0, labeltop=True, labelbottom=False)
        axes.grid(visible=False)
        axes.spines[:].set_visible(False)
        handles = [Patch(facecolor=face, edgecolor="0.4", lw=0.5, label=word) for word, (face, _) in _FACES.items()]
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _bar(axes: Axes, column: int, line: int, seen: dict[str, int]) -> None:
    left, whole = float(column), sum(seen.values())
    for verdict, count in seen.items():
        if not count:
            continue
        face, ink = _FACES[verdict]
        width = 0.9 * count / whole
        axes.add_patch(Rectangle((left, line - 0.33), width, 0.66, facecolor=face, edgecolor="0.4", lw=0.5))
        if width > 0.08:  # a number fits
            axes.text(left + width / 2, line, str(count), color=ink, ha="center", va="center_baseline", fontsize=6)
        left += width
