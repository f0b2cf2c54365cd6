"""The run of the connected FMUs: where the load should go, where it goes, and the distance between the two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from crane_fmu.report.page import Illustration, Section, Table, number
from crane_fmu.report.style import BLACK, BLUE, GREEN, GREY, TIME, VERMILLION, Array, Line, panels, styled

_LINES = (Line(BLUE, "--", 1.6), Line(BLACK, "-", 1.2), Line(VERMILLION, "-.", 1.6), Line(GREEN, ":", 1.8))


@dataclass(frozen=True, eq=False)
class LoopRun:
    """A run of trajectory, inverse model and plant.

    Attributes
    ----------
    label : str
        What was different in it.
    t : ndarray, shape (n,)
        Times in s.
    wanted, driven : ndarray, shape (n, 3)
        Where the load should be and where it is, in m.
    """

    label: str
    t: Array
    wanted: Array
    driven: Array

    @property
    def error(self) -> Array:
        """Distance of the load from where it should be, in m, shape (n,)."""
        distance: Array = np.linalg.norm(self.driven - self.wanted, axis=1)
        return distance

    @property
    def largest(self) -> float:
        """Largest distance, in m."""
        return float(self.error.max())


def figure(runs: Sequence[LoopRun]) -> Figure:
    """Return the path wanted, the path driven in the last run, and the errors of all runs.

    Parameters
    ----------
    runs : sequence of LoopRun
        At most four.
    """
    with styled():
        drawing, (above, below) = panels(2, height=2.5)
        last = runs[-1]
        for name, wanted, driven in zip("xyz", last.wanted.T, last.driven.T, strict=True):
            first = name == "x"
            above.plot(last.t, wanted, color=GREY, linewidth=4.0, label="wanted" if first else None)
            options = _LINES[len(runs) - 1].options()
            above.plot(last.t, driven, **options, label=f"driven, {last.label}" if first else None)
            above.annotate(
                f"${name}$", (last.t[0], wanted[0]), (-6, 0), textcoords="offset points", va="center", ha="right"
            )
        for run, line in zip(runs, _LINES, strict=False):
            shown = np.maximum(1e3 * run.error, 1e-6)  # a logarithm needs something
            below.semilogy(run.t, shown, label=run.label, **line.options())
        above.set_ylabel("position of the load (m)")
        below.set_ylabel("distance from the path (mm)")
        below.set_xlabel(TIME)
        below.margins(x=0.03)
        above.legend(loc="upper right")
        drawing.align_ylabels([above, below])
        drawing.legend(*below.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return drawing


def table(runs: Sequence[LoopRun]) -> Table:
    """Return how far the load strays in each run."""
    rows = tuple((run.label, f"{number(1e3 * run.largest)} mm") for run in runs)
    return Table("The connected FMUs", ("run", "load off its path by at most"), rows)


def section(runs: Sequence[LoopRun]) -> Section:
    """Return the part of the page about the connected FMUs."""
    step = runs[0].t[1] - runs[0].t[0]
    return Section(
        "The loop of FMUs",
        (
            "Three FMUs, a load trajectory, the inverse model and the crane as a plant, are connected (Crane.ssp) and"
            f" run by FMPy with a communication step of {step:g} s. Bridge angle, trolley position, rope length and"
            " load of the plant are fed back: a linear-quadratic regulator about the path, with an estimate of the"
            " force that disturbs the load, corrects the inputs.",
        ),
        (table(runs),),
        (
            Illustration(
                "closed_loop",
                "The load under trajectory, inverse model and plant",
                f"Above: the position wanted, in grey, and driven ({runs[-1].label}). Below: the distance of the load"
                " from where it should be; errors below a nanometre are drawn as one.",
                figure(runs),
            ),
        ),
    )
