"""The table of the page as Markdown, and the lines of the files beside it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from benchmarks.chart.record import Record, key
from benchmarks.chart.rows import Row
from benchmarks.chart.selection import ACCURACIES, ALIKE, TIE, Comparison, checked, compare, fastest, gain


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]], right: int = 1) -> str:
    """Return a table; columns from number `right` on are aligned right."""
    rule = ["---" if k < right else "---:" for k in range(len(head))]
    lines = [head, rule, *rows]
    return "\n".join("| " + " | ".join(each) + " |" for each in lines) + "\n"


def milliseconds(row: Row | None) -> str:
    """Return the time of a row in ms, or a dash."""
    return "-" if row is None or row.seconds is None else f"{1e3 * row.seconds:.3g}"


def comparison(record: Record) -> str:
    """Show times of the library and of the fastest peer, form by form, and the gain by the default route."""
    lines = []
    for scene in record.scenes:
        alike = [compare(record.rows, scene, form, compiled) for form, compiled in ALIKE]
        for k, accuracy in enumerate(ACCURACIES):
            pairs = [*(each[k] for each in alike), gain(record.rows, scene, accuracy)]
            solved = milliseconds(checked(record.rows, scene, accuracy))
            lines.append((scene, f"{accuracy:g}", *(_pair(each) for each in pairs), solved))
    names = [f"{form}, {'machine code' if compiled else 'interpreted'}" for form, compiled in ALIKE]
    head = ("scene", "error", *names, "default `solve` : peer, projected", "`solve`, projected")
    return markdown(head, lines, 2)


def _pair(pair: Comparison) -> str:
    shown = f"{milliseconds(pair.own)} : {milliseconds(pair.peer)}"
    if pair.ratio is None:
        return shown
    return f"{shown} ({'tie' if 1 / TIE < pair.ratio < TIE else times(pair.ratio)})"


def times(ratio: float | None) -> str:
    """Return a ratio with two digits at least; nothing for None."""
    return "" if ratio is None else f"{ratio:.0f}" if ratio >= 10.0 else f"{ratio:.2g}"


def comparison_rows(record: Record) -> Iterator[tuple[str, ...]]:
    """Yield every comparison with the routes that were compared, as lines of a file, the head first."""
    yield "scene", "form", "evaluation", "error", "own route", "own ms", "peer", "peer ms", "ratio"
    for scene in record.scenes:
        pairs = [each for form, compiled in ALIKE for each in compare(record.rows, scene, form, compiled)]
        for each in [*pairs, *(gain(record.rows, scene, accuracy) for accuracy in ACCURACIES)]:
            form = "default route, peer on projected" if each.form == "default" else each.form
            evaluation = "machine code" if each.compiled else "interpreted"
            sides = (cell for row in (each.own, each.peer) for cell in (route(row), milliseconds(row)))
            yield scene, form, evaluation, f"{each.accuracy:g}", *sides, times(each.ratio) or "-"


def route(row: Row | None) -> str:
    """Return solver, method, model and setting of a row in words."""
    return "none" if row is None else f"{row.solver}: {row.method}, {row.model}, {row.setting}"


def solver_rows(record: Record) -> Iterator[tuple[str, ...]]:
    """Yield the fastest time of every solver on every form at every accuracy, and its preparation, the head first."""
    yield "scene", "solver", "form", *(f"{a:g}, ms" for a in ACCURACIES), "smallest error", "median preparation, s"
    for scene in record.scenes:
        here = record.of(scene)
        for solver, form in dict.fromkeys((row.solver, row.formulation) for row in here):
            mine = [row for row in here if (row.solver, row.formulation) == (solver, form)]
            best = min((row.error for row in mine if row.solved and row.error is not None), default=None)
            spent = [record.spent[key(row)].preparation for row in mine if row.solved]
            yield (scene, solver, form or "-", *(milliseconds(fastest(mine, accuracy)) for accuracy in ACCURACIES),
                   "no answer" if best is None else f"{best:.1e}",
                   f"{np.median(spent):.3f}" if spent else "-")  # fmt: skip


def order_rows(record: Record) -> Iterator[tuple[str, ...]]:
    """Yield nominal and fitted orders as lines of a file, the head first."""
    yield "method", "nominal order of the inputs", "fitted", "steps used, s", "smallest error", "at step, s"
    for line in record.order_study[0]:
        best = int(np.argmin(line.errors))
        fitted = "-" if line.fit.order is None else f"{line.fit.order:.2f}"
        span = "-"
        if line.fit.used:
            span = f"{line.steps[line.fit.used[0]]:g} to {line.steps[line.fit.used[-1]]:g}"
        yield (line.method, str(line.nominal) if line.nominal > 0 else "none", fitted, span,
               f"{line.errors[best]:.1e}", f"{line.steps[best]:g}")  # fmt: skip
