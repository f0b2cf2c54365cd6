"""The page docs/speed-accuracy/index.md: fixed sections, filled from the record of the study."""

from __future__ import annotations

import importlib
from pathlib import Path

from benchmarks.chart import tables
from benchmarks.chart.c_cost import FLAGS
from benchmarks.chart.candidate import OUTPUT_INTERVALS
from benchmarks.chart.own import PREPARED
from benchmarks.chart.record import Record
from benchmarks.chart.requirements import ratios_table, requirements_table
from benchmarks.chart.selection import ACCURACIES, compare_compiled, fastest, is_compiled, is_own
from benchmarks.chart.study import PEERS
from benchmarks.chart.timing import SLOW

PAGE = "index.md"
_TEXTS = Path(__file__).with_name("page.md")


def render(record: Record) -> str:
    """Fill the template; the same record gives the same text everywhere."""
    peers = [importlib.import_module(f"benchmarks.peers.{name}") for name in PEERS]
    facts, (lines, round_off) = record.facts, record.order_study
    values = {
        "scenes": tables.scenes(facts["scenes"]),
        "methods": ", ".join(line.method for line in lines),
        "peers": "\n".join(_peer(each.NAME, each.__doc__ or "") for each in peers),
        "machine": tables.markdown(("what", "which"), facts["machine"], 2),
        "minutes": f"{facts['minutes']:.0f}",
        "intervals": str(OUTPUT_INTERVALS),
        "requirements": requirements_table(record),
        "ratios": "\n".join(f"{_title(name)}:\n\n{ratios_table(record, name)}" for name in record.scenes),
        "by_solver": "\n".join(f"{_title(name)}:\n\n{tables.by_solver(record, name)}" for name in record.scenes),
        "paper": tables.paper_step(facts["paper"]),
        "orders": tables.orders(record),
        "round_off": f"{round_off:.1e}",
        "preparation": tables.preparation(record),
        "failures": tables.failures(record),
        "c_cost": tables.costs(facts["costs"]),
        "c_flags": " ".join(FLAGS),
        "shares": tables.markdown(("part of `solve`", "share"),
                                  [(f"`{name}`", f"{100 * share:.0f} %") for name, share in facts["shares"]]),
        "figures": "\n".join(_figures(name) for name in record.scenes),
        "picks": tables.picks(record),
        "slower": slower(record),
        "beside_solve": beside_solve(record),
        "slow": f"{SLOW:g}",
    }  # fmt: skip
    text = _TEXTS.read_text(encoding="utf-8")
    for key, value in values.items():
        text = text.replace(f"<<{key}>>", value.rstrip("\n"))
    return text


def slower(record: Record) -> str:
    """Say in one sentence where a peer is faster than every route of the library, machine code on both sides."""
    found: dict[str, list[str]] = {}
    for scene in record.scenes:
        for each in compare_compiled(record.rows, scene):
            ratios = [(each.ratio(peer), peer) for peer in (each.projected, each.reduced)]
            faster = [(ratio, peer) for ratio, peer in ratios if ratio is not None and peer is not None and ratio < 1.0]
            if faster:
                ratio, peer = min(faster, key=lambda pair: pair[0])
                words = f"{each.accuracy:g} ({peer.solver}, {ratio:.1f} of our time)"
                found.setdefault(_title(scene).lower(), []).append(words)
    if not found:
        return "No peer is faster than our fastest route on any scene of this page at 1e-3, 1e-6 or 1e-9."
    return f"We are slower on {'; '.join(scene + ' at ' + ', '.join(errors) for scene, errors in found.items())}."


def beside_solve(record: Record) -> str:
    """Say what a solve of internal dynamics takes beside idas, both interpreted; nothing where there are none."""
    ratios = []
    for scene in record.scenes:
        here = [row for row in record.of(scene) if row.formulation == "reduced" and not is_compiled(row)]
        if any(row.method == PREPARED for row in here):
            for accuracy in ACCURACIES:
                own = fastest(here, accuracy, lambda row: is_own(row) and row.method != PREPARED)
                peer = fastest(here, accuracy, lambda row: row.method.startswith("idas"))
                ratios += [own.point[0] / peer.point[0]] if own and peer else []
    if not ratios:
        return ""
    return (
        f"Interpreted, `solve` takes {min(ratios):.1f} to {max(ratios):.1f} times as long as CasADi's `idas` on the"
        " reduced form, which steps as far as its tolerance allows, and does not check."
    )


def _peer(name: str, text: str) -> str:
    """Return the head of a peer's module as a point of a list."""
    paragraphs = [" ".join(each.split()) for each in text.strip().split("\n\n")]
    return f"* **{name}**. " + " ".join(paragraphs)


def _title(scene: str) -> str:
    return scene.replace("_", " ").capitalize()


def _figures(scene: str) -> str:
    title = _title(scene)
    return (f"![{title}: error against time](work-precision-{scene}.svg)\n\n"
            f"![{title}: constraint violation against time](violation-{scene}.svg)\n")  # fmt: skip
