"""The page docs/speed-accuracy/index.md: fixed sections, filled with what was measured."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path

import servocore as sc
from benchmarks.chart import tables
from benchmarks.chart.c_cost import FLAGS, Cost
from benchmarks.chart.candidate import OUTPUT_INTERVALS, Problem
from benchmarks.chart.machine import facts
from benchmarks.chart.study import PEERS, Study

_TEXTS = Path(__file__).with_name("page.md")


def write_page(
    path: Path, study: Study, problems: Sequence[Problem], costs: Sequence[Cost], shares: Sequence[tuple[str, float]],
    minutes: float,
) -> None:  # fmt: skip
    """Fill the template and write it."""
    modules = [importlib.import_module(f"benchmarks.peers.{name}") for name in PEERS]
    main = problems[0]
    values = {
        "scenes": _scenes(problems),
        "methods": ", ".join(line.method for line in study.order_lines) or "see results.csv",
        "peers": "\n".join(_peer(module.NAME, module.__doc__ or "") for module in modules),
        "machine": tables.markdown(
            ("what", "which"), facts(module.DISTRIBUTION for module in modules), 2
        ),
        "minutes": f"{minutes:.0f}",
        "intervals": str(OUTPUT_INTERVALS),
        "ratios": tables.ratios(study, main.name),
        "by_solver": "\n".join(f"### {name}\n\n{tables.by_solver(study, name)}" for name in study.scenes),
        "paper": tables.paper_step(main.scene),
        "orders": tables.orders(study),
        "round_off": f"{study.round_off:.1e}",
        "preparation": tables.preparation(study.timed),
        "failures": tables.failures(study),
        "c_cost": _c_cost(costs),
        "c_flags": " ".join(FLAGS),
        "shares": tables.markdown(("part of `solve`", "share"), [(f"`{name}`", f"{100 * share:.0f} %")
                                                              for name, share in shares]),
        "figures": "\n".join(_figures(name) for name in study.scenes),
        "picks": "\n".join(f"* {each}" for each in tables.picks(study)),
    }  # fmt: skip
    text = _TEXTS.read_text()
    for key, value in values.items():
        text = text.replace(f"<<{key}>>", value.rstrip("\n"))
    path.write_text(text)


def _scenes(problems: Sequence[Problem]) -> str:
    rows = []
    for each in problems:
        report = sc.analyse(each.scene)
        path = each.scene.reference
        rows.append((each.name, ", ".join(f"{name} (n = {len(each.scene.model(name).coordinates)})"
                                          for name in each.scene.models),
                     str(report.index), str(report.internal_degrees_of_freedom), f"{path.duration:g} s",
                     f"degree {2 * path.smoothness + 1}"))  # fmt: skip
    return tables.markdown(("scene", "models", "index", "internal states", "duration", "path"), rows, 2)


def _peer(name: str, text: str) -> str:
    """Return the head of a peer's module as a point of a list."""
    paragraphs = [" ".join(each.split()) for each in text.strip().split("\n\n")]
    return f"* **{name}**. " + " ".join(paragraphs)


def _c_cost(costs: Sequence[Cost]) -> str:
    rows = []
    for each in costs:
        cells = ("no gcc", "-", "-", "-") if each.compiled is None else (
            f"{each.compiled:.2f}", f"{each.loop / each.compiled:.1f}", f"{each.solve / each.compiled:.1f}",
            f"{each.seconds_to_compile:.1f}")  # fmt: skip
        rows.append((each.model, f"{each.solve:.1f}", f"{each.loop:.1f}", *cells))
    head = ("model", "`solve`, µs", "compiled loop alone, µs", "the loop in C, µs", "loop / C", "`solve` / C",
            "C compiles in, s")  # fmt: skip
    return tables.markdown(head, rows)


def _figures(scene: str) -> str:
    title = scene.replace("_", " ")
    return (f"![{title}: error against time](work-precision-{scene}.svg)\n\n"
            f"![{title}: constraint violation against time](violation-{scene}.svg)\n")  # fmt: skip
