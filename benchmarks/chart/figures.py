"""The figures of the page. Lines differ in marker and dash as well as in colour: they read in grey too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.chart.candidate import OUTPUT_INTERVALS
from benchmarks.chart.own import CLOSED_FORM, COMPILED, INVERTED, LONG_STEPS, NAME, SOLVED
from benchmarks.chart.record import OrderLine, Record
from benchmarks.chart.rows import Row
from benchmarks.chart.selection import front
from benchmarks.route_styles import line_style

STYLE: Any = {
    "font.size": 9, "axes.titlesize": 9.5, "axes.labelsize": 9, "legend.fontsize": 8, "axes.grid": True,
    "grid.color": "0.88", "grid.linewidth": 0.6, "axes.axisbelow": True, "svg.hashsalt": "speed-accuracy",
    "figure.dpi": 100, "savefig.dpi": 160, "svg.fonttype": "path",
}  # fmt: skip
COLOURS = ("#0072b2", "#000000", "#d55e00", "#009e73", "#cc79a7", "#8c6d1f", "#56b4e9", "#7f7f7f", "#5b3794", "#e69f00")
MARKERS = "osD^vPXd<>hp8H*1234"
DASHES: tuple[object, ...] = (
    "-",
    "--",
    "-.",
    ":",
    (0, (5, 1, 1, 1, 1, 1)),
    (0, (1, 1)),
    (0, (7, 2)),
    (0, (3, 1, 1, 1)),
)
FAMILIES: dict[str, object] = {
    "backward-euler": "-", "bdf": "-", "radau": "--", "trapezoidal": "-.", "gauss": "-.", "generalized-alpha": ":",
}  # fmt: skip
OLDEST = 1e-16  # an error of zero is drawn here
FORM_TITLES = {"projected": "projected form (index {projected})", "reduced": "reduced form (index 1, or algebraic)"}
PROJECTED_INDEX = {"three_cars": 5, "mass_on_car": 2, "arm": 2}  # of others 3

SOLVERS = (NAME, "plain NumPy/SciPy", "casadi", "scikit-sundae", "scipy_dae", "gekko", "pyomo.dae", "exudyn")
"""One colour a solver on all pages."""

Spread = Callable[[Row], tuple[float, float]]


def draw_all(record: Record, folder: Path) -> list[str]:
    """Draw every figure as SVG and PNG into `folder`; returns their names."""
    names = []
    with plt.rc_context(STYLE):
        for scene in record.scenes:
            rows = record.of(scene)
            names.append(_save(_two_forms(rows, record.spread, scene, "error"), folder, f"work-precision-{scene}"))
            names.append(_save(_two_forms(rows, record.spread, scene, "violation"), folder, f"violation-{scene}"))
        main = record.scenes[0]
        names.append(_save(_overview(record, main), folder, "overview"))
        names.append(_save(_methods(record.of(main), main), folder, "methods"))
        names.append(_save(_orders(*record.order_study), folder, "orders"))
    return names


def _save(figure: Figure, folder: Path, name: str) -> str:
    figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
    figure.savefig(folder / f"{name}.png")
    plt.close(figure)
    return name


def _overview(record: Record, scene: str) -> Figure:
    """Draw error against time of all solvers in one panel, whatever their form; our default is marked."""
    rows = record.of(scene)
    figure, axis = plt.subplots(figsize=(9.0, 5.0), layout="constrained")
    others = dict.fromkeys(row.solver for row in rows if row.solver not in (NAME, CLOSED_FORM))
    for solver in (NAME, *others):
        own = [row for row in rows if row.solver == solver and row.error is not None]
        _line(axis, front(row for row in own if COMPILED not in row.method), record.spread, "error", solver,
              colour_of(solver))  # fmt: skip
    for solver, colour in ((NAME, len(COLOURS) - 1), ("casadi", len(SOLVERS))):
        compiled = front(row for row in rows if row.solver == solver and COMPILED in row.method)
        words = f"{solver}{COMPILED}" + (" (eight instants at a time)" if solver == NAME else "")
        _line(axis, compiled, record.spread, "error", words, colour)
    _closed_form(axis, rows, "error")
    alone = [each["compiled"] for each in record.facts.get("costs", ()) if each["compiled"]]
    if alone:
        axis.axvline(1e-6 * OUTPUT_INTERVALS * min(alone), color="black", linewidth=1.6,
                     label="exact inversion in C, one instant at a time")  # fmt: skip
    default = [row for row in rows if (row.solver, row.method, row.setting) == (NAME, SOLVED, "200 steps")]
    if default and default[0].solved:
        point = default[0].point[0], max(default[0].point[1], OLDEST)
        axis.plot([point[0]], [point[1]], marker="*", color=COLOURS[0], markersize=11)
        axis.annotate("default: sc.solve(scene)", point, (-59, 34), textcoords="offset points", fontsize=9,
                      arrowprops={"arrowstyle": "->", "linewidth": 1.6})  # fmt: skip
    axis.set(xscale="log", yscale="log", xlabel="time of the solve (s)",
             ylabel="largest error of any input / its peak",
             title=f"{scene.replace('_', ' ')}, 200 intervals: every solver at its best")  # fmt: skip
    figure.legend(loc="outside lower center", ncols=4)
    return figure


def _two_forms(rows: Sequence[Row], spread: Spread, scene: str, what: str) -> Figure:
    """Draw the fronts of all solvers, one panel a form; what they give beside it, for the same points."""
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 4.6), sharex=True, sharey=True, layout="constrained")
    solvers = list(dict.fromkeys([NAME, *(row.solver for row in rows if row.solver != CLOSED_FORM)]))
    for form, axis in zip(FORM_TITLES, axes, strict=True):
        for solver in solvers:
            own = [row for row in rows if (row.solver, row.formulation) == (solver, form)]
            own = [row for row in own if COMPILED not in row.method and getattr(row, what) is not None]
            _line(axis, front(own), spread, what, solver, colour_of(solver))
        _closed_form(axis, rows, what)
        axis.set(
            xscale="log",
            yscale="log",
            xlabel="time of the solve (s)",
            title=FORM_TITLES[form].format(projected=PROJECTED_INDEX.get(scene, 3)),
        )
    label = "largest error of any input / its peak" if what == "error" else "largest constraint violation (m, rad)"
    axes[0].set_ylabel(label)
    handles = {text: line for axis in axes for line, text in zip(*axis.get_legend_handles_labels(), strict=True)}
    handles = {text: handles[text] for text in sorted(handles, key=lambda text: text != NAME)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=min(5, len(handles)))
    figure.suptitle(f"{scene.replace('_', ' ')}: best settings of every solver", fontsize=10.5)
    return figure


def colour_of(solver: str) -> int:
    """Return the number of a solver's colour, marker and dash."""
    return SOLVERS.index(solver) if solver in SOLVERS else len(SOLVERS)


def _line(axis: Axes, points: Sequence[Row], spread: Spread, what: str, label: str, k: int) -> None:
    if not points:
        return
    points = [row for row in points if getattr(row, what) is not None]
    x = np.array([row.seconds for row in points])
    y = np.array([max(getattr(row, what) or 0.0, OLDEST) for row in points])
    bars = np.array([spread(row) for row in points]).T
    bars = np.abs(np.clip(bars, 1e-9, None) - x)
    axis.errorbar(
        x, y, xerr=bars, label=label, color=COLOURS[k % len(COLOURS)], marker=MARKERS[k % len(MARKERS)],
        linestyle=DASHES[k % len(DASHES)], markersize=6 if k == 0 else 4.5, linewidth=2.0 if k == 0 else 1.1,
        elinewidth=0.8, capsize=1.5, markerfacecolor=COLOURS[k % len(COLOURS)] if k % 2 == 0 else "white",
    )  # fmt: skip


def _closed_form(axis: Axes, rows: Sequence[Row], what: str) -> None:
    for row in rows:
        if row.solver == CLOSED_FORM and row.solved:
            if what == "error":
                axis.axvline(row.point[0], color="0.35", linewidth=1.0, linestyle=(0, (1, 2)),
                             label="closed form (exact)")  # fmt: skip
            else:
                axis.axvline(row.point[0], color="0.35", linewidth=1.0, linestyle=(0, (1, 2)), label="closed form")


SHADES = {"bdf": ("Greens", 2, 6), "radau": ("Purples", 2, 7)}
"""Colour map of a family of several members, and its lowest and highest member."""
MEMBER_DASHES: tuple[object, ...] = ("-", (0, (6, 2)), (0, (4, 1, 1, 1)), (0, (2, 1)), (0, (1, 1)), (0, (8, 2, 2, 2)))


def _family(method: str) -> dict[str, Any]:
    """Return the style of a method: colour by family, shade, dash and marker by member, which differ in grey too.

    Prepared runs have hollow markers, and bold lines where they are machine code.
    """
    adaptive, prepared = method.endswith("adaptive"), LONG_STEPS in method
    for k, (start, family_dash) in enumerate(FAMILIES.items()):
        if method.startswith(start):
            dash = family_dash
            member = int("".join(each for each in method.removesuffix(", adaptive") if each.isdigit()) or 0)
            own: Any = line_style(start)["color"]
            if start in SHADES:
                name, lowest, highest = SHADES[start]
                own = mpl.colormaps[name](0.45 + 0.5 * (member - lowest) / (highest - lowest))
                dash = MEMBER_DASHES[(member - lowest) % len(MEMBER_DASHES)]
            return {
                "color": own,
                "linestyle": (0, (1, 2)) if adaptive else dash,
                "marker": "*" if adaptive else MARKERS[member % len(MARKERS)],
                "markerfacecolor": "white" if k % 2 or adaptive or prepared else own,
                "markersize": 8 if adaptive else 5.5,
                "linewidth": 2.6 if method.endswith(COMPILED) else 1.4,
            }
    return {"color": "0.5"}


def _methods(rows: Sequence[Row], scene: str) -> Figure:
    """Draw our own methods, one line each, on the smallest model."""
    figure, axis = plt.subplots(figsize=(9.0, 6.2), layout="constrained")
    own = [row for row in rows if row.solver == NAME and row.solved]
    model = own[0].model if own else ""
    top = 1e1
    for method in dict.fromkeys(row.method for row in own if row.formulation == "projected" and row.model == model):
        points = [row for row in own if (row.model, row.formulation, row.method) == (model, "projected", method)]
        label = method if min(row.point[1] for row in points) < top else f"{method} (above the scale)"
        axis.plot([row.point[0] for row in points], [max(row.point[1], OLDEST) for row in points], label=label,
                  **_family(method))  # fmt: skip
    for method, marker, words in ((SOLVED, "*", "exact inversion by solve"), (INVERTED, "P", "ExactInversion"),
                                  (INVERTED + COMPILED, "X", "ExactInversion, machine code")):  # fmt: skip
        exact = [row for row in own if (row.model, row.method) == (model, method)]
        axis.plot([row.point[0] for row in exact], [row.point[1] for row in exact], marker + ":",
                  color=COLOURS[-1 if COMPILED in method else 0], markersize=9,
                  label=f"{words}\n(40, 100, 200 instants)")  # fmt: skip
    axis.set(xscale="log", yscale="log", xlabel="time of the solve (s)",
             ylabel="largest error of any input / its peak", ylim=(1e-15, top),
             title=f"{scene.replace('_', ' ')}, {model}: "
             "projected form, and exact inversion on the reduced form")  # fmt: skip
    figure.legend(loc="outside right center")
    return figure


def _orders(lines: Sequence[OrderLine], round_off: float) -> Figure:
    """Draw error against step, with the fitted orders and the round-off."""
    figure, axis = plt.subplots(figsize=(9.0, 6.6), layout="constrained")
    for line in lines:
        order = "no order" if line.fit.order is None else f"order {line.fit.order:.2f}"
        nominal = str(line.nominal) if line.nominal > 0 else "none"
        axis.plot(line.steps, line.errors, label=f"{line.method}: {order} (nominal {nominal})", **_family(line.method))
    steps = np.array(sorted({h for line in lines for h in line.steps}))
    if round_off and len(steps):
        axis.plot(steps, round_off / steps**2, color="0.3", linewidth=2.0, linestyle=(0, (1, 2)),
                  label=f"round-off, {round_off:.1e} s²/h²")  # fmt: skip
    axis.set(xscale="log", yscale="log", xlabel="step h (s)", ylabel="largest error of any input / its peak",
             ylim=(1e-10, 1e1), title="rotary crane, path of degree 13, projected form")  # fmt: skip
    figure.legend(loc="outside right center")
    return figure
