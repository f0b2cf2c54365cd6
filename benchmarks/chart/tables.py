"""The tables of the page, as Markdown."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks.chart.record import Record
from benchmarks.chart.rows import Row
from benchmarks.chart.selection import ACCURACIES, fastest, is_own


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]], right: int = 1) -> str:
    """Return a table; columns from number `right` on are aligned right."""
    rule = ["---" if k < right else "---:" for k in range(len(head))]
    lines = [head, rule, *rows]
    return "\n".join("| " + " | ".join(each) + " |" for each in lines) + "\n"


def milliseconds(row: Row | None) -> str:
    """Return the time of a row in ms, or a dash."""
    return "-" if row is None or row.seconds is None else f"{1e3 * row.seconds:.3g}"


def by_solver(record: Record, scene: str) -> str:
    """Show the fastest time of every solver on every form, at every accuracy."""
    here = record.of(scene)
    keys = dict.fromkeys((row.solver, row.formulation) for row in here)
    lines = []
    for solver, form in keys:
        mine = [row for row in here if (row.solver, row.formulation) == (solver, form)]
        best = min((row.error for row in mine if row.solved and row.error is not None), default=None)
        cells = [milliseconds(fastest(mine, accuracy)) for accuracy in ACCURACIES]
        lines.append((solver, form or "-", *cells, "no answer" if best is None else f"{best:.1e}"))
    return markdown(("solver", "form", *(f"{a:g}, ms" for a in ACCURACIES), "smallest error"), lines, 2)


def paper_step(found: Sequence[dict[str, Any]]) -> str:
    """Show errors of every input at the paper's own step, of our routes."""
    lines = [
        (f"{each['formulation']}, {each['method']}", *(f"{error:.1e}" for error in each["errors"].values()),
         f"{each['late']:.1e}")
        for each in found
    ]  # fmt: skip
    head = ("route", *(f"error of `{name}`" for name in found[0]["errors"]), "largest after six steps")
    return markdown(head, lines)


def orders(record: Record) -> str:
    """Show nominal and fitted orders."""
    lines = []
    for line in record.order_study[0]:
        best = int(np.argmin(line.errors))
        fitted = "-" if line.fit.order is None else f"{line.fit.order:.2f}"
        span = "-"
        if line.fit.used:
            span = f"{line.steps[line.fit.used[0]]:g} to {line.steps[line.fit.used[-1]]:g}"
        lines.append((line.method, str(line.nominal) if line.nominal > 0 else "none", fitted, span,
                      f"{line.errors[best]:.1e}", f"{line.steps[best]:g}"))  # fmt: skip
    head = ("method", "nominal order of the inputs", "fitted", "steps used, s", "smallest error", "at step, s")
    return markdown(head, lines)


def failures(record: Record) -> str:
    """List what gave no answer, with the message, settings of the same message together."""
    found: dict[tuple[str, str, str, str], list[Row]] = defaultdict(list)
    for row in record.rows:
        if row.error is None:
            found[row.solver, row.formulation or "-", row.method or "-", row.message].append(row)
    lines = []
    for (solver, form, method, message), rows in found.items():
        scenes = ", ".join(dict.fromkeys(row.scene for row in rows))
        lines.append((solver, form, method, str(len(rows)), scenes, message.replace("|", "/")))
    return markdown(("solver", "form", "method", "settings", "scenes", "message"), sorted(lines), 9)


def preparation(record: Record) -> str:
    """List seconds that are spent once, by solver."""
    found: dict[str, list[float]] = defaultdict(list)
    for (_, solver, *_), spent in record.spent.items():
        if spent.repeats:
            found[solver].append(spent.preparation)
    lines = [(solver, f"{np.median(each):.3f}", f"{max(each):.3f}") for solver, each in found.items()]
    return markdown(("solver", "median, s", "longest, s"), lines)


def costs(found: Sequence[dict[str, Any]]) -> str:
    """Show what an instant of the exact inversion costs beside C."""
    rows = []
    for each in found:
        cells = ("no gcc", "-", "-", "-") if each["compiled"] is None else (
            f"{each['compiled']:.2f}", f"{each['inversion'] / each['compiled']:.1f}",
            f"{each['solve'] / each['compiled']:.1f}", f"{each['seconds_to_compile']:.1f}")  # fmt: skip
        rows.append((each["model"], f"{each['solve']:.1f}", f"{each['inversion']:.2f}", *cells))
    head = ("model", "`solve`, µs", "`ExactInversion`, µs", "bare C function, µs", "`ExactInversion` / C",
            "`solve` / C", "C compiles in, s")  # fmt: skip
    return markdown(head, rows)


def scenes(found: Sequence[dict[str, Any]]) -> str:
    """Show what kind of problems the scenes are."""
    rows = [
        (each["name"], ", ".join(f"{name} (n = {n})" for name, n in each["models"].items()), str(each["index"]),
         str(each["internal_states"]), f"{each['duration']:g} s", f"degree {2 * each['smoothness'] + 1}")
        for each in found
    ]  # fmt: skip
    return markdown(("scene", "models", "index", "internal states", "duration", "path"), rows, 2)


def picks(record: Record) -> str:
    """Say what the fastest own route is, by scene and error."""
    lines = []
    for scene in record.scenes:
        mine = [row for row in record.of(scene) if is_own(row)]
        for accuracy in ACCURACIES:
            row = fastest(mine, accuracy)
            route = ("none",) * 4 if row is None else (row.formulation, row.method, row.model, row.setting)
            lines.append((scene, f"{accuracy:g}", *route, milliseconds(row)))
    head = ("scene", "error", "form", "method", "model", "setting", "ms")
    return markdown(head, lines, 9)
