"""Colour, dash and marker of each route in all figures: exact inversion is blue, the scheme of the paper orange.

The report and the live page use the same blue and orange. Reds belong to what the atlas shows to fail:
original equations, and methods that damp nothing.
"""

from __future__ import annotations

from typing import Any

EXACT, PAPER = "#0072b2", "#d55e00"
FAILING = "#a50f2b"
"""Of what fails."""

_STYLES: dict[str, tuple[str, Any, str]] = {
    "reduced": (EXACT, "-", "s"),
    "exact": (EXACT, "-", "s"),
    "original": (FAILING, "-", "x"),
    "trapezoidal": ("#6d0a1f", (0, (4, 1)), "P"),
    "gauss": ("#df5b83", (0, (3, 1, 1, 1)), "*"),
    "backward-euler": (PAPER, "--", "o"),
    "bdf": ("#009e73", "-.", "^"),
    "radau": ("#7b4fa3", ":", "D"),
    "generalized-alpha": ("#b08a00", (0, (5, 1, 1, 1, 1, 1)), "v"),
    "energy-momentum": ("#000000", "-", "h"),
    "midpoint": ("#3c8fa8", "-.", "<"),
    "RK4": ("#7f7f7f", (0, (1, 1)), ">"),
}
"""By the first of these words that the name of a route contains: a form that decides alone, else the method."""


def line_style(route: str, **more: Any) -> dict[str, Any]:
    """Return how `Axes.plot` draws a route; keywords replace a part of it.

    Raises
    ------
    KeyError
        If the route contains no known word.
    """
    for word, (colour, dash, mark) in _STYLES.items():
        if word in route:
            return {"color": colour, "ls": dash, "marker": mark} | more
    raise KeyError(route)
