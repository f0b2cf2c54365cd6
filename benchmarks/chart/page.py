"""The page docs/speed-accuracy/index.md: fixed sections, filled from the record of the study."""

from __future__ import annotations

import csv
import importlib
from pathlib import Path

from benchmarks.chart import tables
from benchmarks.chart.candidate import OUTPUT_INTERVALS
from benchmarks.chart.own import PREPARED
from benchmarks.chart.record import Record
from benchmarks.chart.requirements import missed, requirement_rows
from benchmarks.chart.selection import ACCURACIES, ALIKE, TIE, compare, fastest, is_compiled, is_own
from benchmarks.chart.study import PEERS

PAGE = "index.md"
_TEXTS = Path(__file__).with_name("page.md")


def render(record: Record) -> str:
    """Fill the template; the same record gives the same text everywhere."""
    peers = [importlib.import_module(f"benchmarks.peers.{name}") for name in PEERS]
    values = {
        "peers": "\n".join(_peer(each.NAME, each.__doc__ or "") for each in peers),
        "machine": ", ".join(f"{name} {value}" for name, value in record.facts["machine"]),
        "minutes": f"{record.facts['minutes']:.0f}",
        "intervals": str(OUTPUT_INTERVALS),
        "comparison": tables.comparison(record),
        "missed": missed(record),
        "round_off": f"{record.order_study[1]:.1e}",
        "figures": "\n".join(_figures(name) for name in record.scenes),
        "slower": slower(record),
        "beside_solve": beside_solve(record),
    }
    text = _TEXTS.read_text(encoding="utf-8")
    for key, value in values.items():
        text = text.replace(f"<<{key}>>", value.rstrip("\n"))
    return text


def write_tables(record: Record, folder: Path) -> None:
    """Write the files beside the page that are computed from the record."""
    for name, lines in (
        ("comparison", tables.comparison_rows(record)),
        ("solvers", tables.solver_rows(record)),
        ("orders", tables.order_rows(record)),
        ("requirements", requirement_rows(record)),
    ):
        with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as stream:
            csv.writer(stream, lineterminator="\n").writerows(lines)


def slower(record: Record) -> str:
    """Say in one sentence where a peer is faster than the library on the same form, evaluated alike."""
    found: dict[str, list[str]] = {}
    for scene in record.scenes:
        for form, compiled in ALIKE:
            for each in compare(record.rows, scene, form, compiled):
                if each.ratio is not None and each.ratio <= 1 / TIE:
                    words = f"{scene} at {each.accuracy:g} ({each.peer.solver if each.peer else ''}, {each.ratio:.2f})"
                    found.setdefault(f"the {form} form{', machine code' if compiled else ''}", []).append(words)
    if not found:
        return "No peer is faster than the library on the same form at 1e-3, 1e-6 or 1e-9."
    return "; ".join(f"On {form} a peer is faster for {', '.join(each)}" for form, each in found.items()) + "."


def beside_solve(record: Record) -> str:
    """Compare `solve` on internal dynamics with idas, both interpreted; nothing where there are none."""
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
        f"With internal dynamics `solve`, with all its checks, takes {min(ratios):.1f} to {max(ratios):.1f} times"
        " as long as CasADi's `idas` on the reduced form, both interpreted."
    )


def _peer(name: str, text: str) -> str:
    """Return the first paragraph of a peer's module as a point of a list; further settings are in the module."""
    return f"* **{name}**: " + " ".join(text.strip().partition("\n\n")[0].split())


def _title(scene: str) -> str:
    return scene.replace("_", " ").capitalize()


def _figures(scene: str) -> str:
    title = _title(scene)
    return (f"![{title}: error against time](work-precision-{scene}.svg)\n\n"
            f"![{title}: constraint violation against time](violation-{scene}.svg)\n")  # fmt: skip
