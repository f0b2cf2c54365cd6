"""The tables of the page, as Markdown."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np

import servocore as sc
from benchmarks.chart.candidate import OUTPUT_INTERVALS
from benchmarks.chart.own import NAME
from benchmarks.chart.rows import Row
from benchmarks.chart.selection import ACCURACIES, compare, fastest, is_own
from benchmarks.chart.study import Study
from benchmarks.chart.timing import Timed

WANTED_PROJECTED, WANTED_REDUCED = 10.0, 5.0


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]], right: int = 1) -> str:
    """Return a table; columns from number `right` on are aligned right."""
    rule = ["---" if k < right else "---:" for k in range(len(head))]
    lines = [head, rule, *rows]
    return "\n".join("| " + " | ".join(each) + " |" for each in lines) + "\n"


def milliseconds(row: Row | None) -> str:
    """Return the time of a row in ms, or a dash."""
    return "-" if row is None else f"{1e3 * row.seconds:.3g}"


def route(row: Row | None) -> str:
    """Return what a row is, short."""
    return "none gets there" if row is None else f"{row.solver}: {row.method}, {row.model}, {row.setting}"


def ratios(study: Study, scene: str) -> str:
    """Our fastest route beside the fastest peers on both forms."""
    lines = []
    for each in compare(study.rows, scene):
        for form, peer, wanted in (
            ("projected", each.projected, WANTED_PROJECTED),
            ("reduced", each.reduced, WANTED_REDUCED),
        ):
            ratio = each.ratio(peer)
            verdict = "-" if ratio is None else f"{ratio:.1f}"
            met = "no peer" if peer is None else "-" if ratio is None else "yes" if ratio >= wanted else "no"
            lines.append((f"{each.accuracy:g}", route(each.own), milliseconds(each.own), form, route(peer),
                          milliseconds(peer), verdict, f"{wanted:g}", met))  # fmt: skip
    head = ("error", "our fastest route", "ms", "peer's form", "fastest peer", "ms", "ratio", "wanted", "met")
    return markdown(head, lines, 9)


def by_solver(study: Study, scene: str) -> str:
    """Fastest time of every solver on every form, at every accuracy."""
    here = [row for row in study.rows if row.scene == scene and row.solver]
    keys = dict.fromkeys((row.solver, row.formulation) for row in here if row.formulation)
    lines = []
    for solver, form in keys:
        mine = [row for row in here if (row.solver, row.formulation) == (solver, form)]
        best = min((row.error for row in mine if row.solved), default=None)
        cells = [milliseconds(fastest(mine, accuracy)) for accuracy in ACCURACIES]
        lines.append((solver, form, *cells, "-" if best is None else f"{best:.1e}"))
    return markdown(("solver", "form", *(f"{a:g}, ms" for a in ACCURACIES), "smallest error"), lines, 2)


def paper_step(scene: sc.Scene) -> str:
    """Errors of every input at the paper's own step, of our routes."""
    step = scene.reference.duration / OUTPUT_INTERVALS
    routes: list[tuple[str, sc.Formulation, sc.Method]] = [
        ("reduced, exact inversion", sc.Reduced(), sc.BackwardEuler()),
        *((f"projected, {method.name}", sc.Projected(), method)
          for method in (sc.BackwardEuler(), *(sc.BDF(k) for k in range(2, 7)), *(sc.RadauIIA(k) for k in range(2, 8)),
                         sc.GeneralizedAlpha())),
    ]  # fmt: skip
    names = [each.name for each in scene.model().inputs]
    lines = []
    for text, formulation, method in routes:
        solution = sc.solve(scene, formulation, method, step=step)
        exact = scene.exact(solution.t)
        late = solution.t > solution.t[0] + 6.5 * step
        errors = [np.abs(solution[name] - exact[name]) / np.abs(exact[name]).max() for name in names]
        cells = [f"{each.max():.1e}" for each in errors]
        lines.append((text, *cells, f"{max(each[late].max() for each in errors):.1e}"))
    return markdown(("route", *(f"error of {name}" for name in names), "largest after six steps"), lines)


def orders(study: Study) -> str:
    """Nominal and fitted orders."""
    lines = []
    for line in study.order_lines:
        best = int(np.argmin(line.errors))
        fitted = "-" if line.fit.order is None else f"{line.fit.order:.2f}"
        span = "-"
        if line.fit.used:
            span = f"{line.steps[line.fit.used[0]]:g} to {line.steps[line.fit.used[-1]]:g}"
        lines.append((line.method, str(line.nominal) if line.nominal > 0 else "none", fitted, span,
                      f"{line.errors[best]:.1e}", f"{line.steps[best]:g}"))  # fmt: skip
    head = ("method", "nominal order of the inputs", "fitted", "steps used, s", "smallest error", "at step, s")
    return markdown(head, lines)


def failures(study: Study) -> str:
    """List what gave no answer, with the message, settings of the same message together."""
    found: dict[tuple[str, str, str, str], list[Row]] = defaultdict(list)
    for row in study.rows:
        if row.error is None:
            found[row.solver, row.formulation or "-", row.method or "-", row.message].append(row)
    lines = []
    for (solver, form, method, message), rows in found.items():
        scenes = ", ".join(dict.fromkeys(row.scene for row in rows))
        lines.append((solver, form, method, str(len(rows)), scenes, message.replace("|", "/")))
    return markdown(("solver", "form", "method", "settings", "scenes", "message"), sorted(lines), 9)


def preparation(timed: Sequence[Timed]) -> str:
    """Seconds that are spent once, by solver."""
    found: dict[str, list[float]] = defaultdict(list)
    for each in timed:
        if each.seconds:
            found[each.row.solver].append(each.preparation)
    lines = [(solver, f"{np.median(each):.3f}", f"{max(each):.3f}") for solver, each in found.items()]
    return markdown(("solver", "median, s", "longest, s"), lines)


def picks(study: Study) -> list[str]:
    """Sentences on what to pick, from the rows."""
    sentences = []
    for scene in study.scenes:
        mine = [row for row in study.rows if row.scene == scene and is_own(row)]
        words = []
        for accuracy in ACCURACIES:
            row = fastest(mine, accuracy)
            what = "none" if row is None else f"{row.formulation}, {row.method}, {row.model}, {row.setting}"
            words.append(f"{accuracy:g}: {what} ({milliseconds(row)} ms)")
        sentences.append(f"{scene}: " + "; ".join(words) + ".")
    return sentences


__all__ = ["NAME", "by_solver", "failures", "markdown", "orders", "paper_step", "picks", "preparation", "ratios"]
