"""What the study must show, each requirement with its limit, what was measured, and whether it is met."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.chart.own import COMPILED, PREPARED
from benchmarks.chart.record import Record
from benchmarks.chart.rows import Row
from benchmarks.chart.selection import compare, compare_compiled, is_compiled, is_peer
from benchmarks.chart.tables import markdown, milliseconds

WANTED_RATIO = {"projected": 10.0, "reduced": 5.0}
"""How many times the fastest peer must take our fastest route's time, by the form that the peer is given."""
MOST_REDUCED, MOST_PROJECTED = 1e-10, 5e-3
"""Largest errors of M_b, relative to its peak, at the paper's step."""
PAPER_INPUT = "M_b"
ORDER_SHORTFALL = 0.3
"""A fitted order may be so much below the nominal one: leading terms are not all there is."""
WANTED_BESIDE_IDAS = {"mass_on_car": 2.0, "arm": 2.0, "overhead_crane": 5.0, "three_cars": 5.0}
"""The same by scene; of flat ones at the largest error only."""
MOST_OF_C, MOST_MINUTES = 10.0, 20.0


_BESIDE = "time per instant of `ExactInversion`, divided by that of the bare C function, "
_MINUTES = "the whole study"
_COMPILED = "faster than any peer on the reduced form, machine code on both"
_FEW = (
    "a call of ours is mostly the call itself, whatever its steps or instants, and at this error a peer takes few steps"
)
_CALL = "both sides are interpreted here, and a call for so few instants is to a good part the call itself"
_MORE = "the interpreter, and the derivatives of the path, take what C and its arguments that are ready do not"
REASONS = {
    **{f"error {each:g}: faster than any peer on the reduced form": _CALL for each in (1e-3, 1e-6)},
    **{f"{scene}, error {each:g}: {_COMPILED}": _FEW for scene in WANTED_BESIDE_IDAS for each in (1e-3, 1e-6)},
    f"{_BESIDE}generalized": "its functions are some thousands of operations, which CasADi interprets in about 7 ns"
    " each, and C takes a fraction of one; unless it is told not to, `ExactInversion` becomes machine code by itself",
    f"{_BESIDE}points": _MORE,
    f"{_BESIDE}bodies": _MORE,
    _MINUTES: "every setting of every peer is run, those that fail too, and the machine decides the rest",
}
"""Why a requirement may be missed; the page lists those that are."""
NO_REASON = "measured in one run, and not explained: another may say otherwise"


@dataclass(frozen=True)
class Requirement:
    """One thing that must hold; `met` is None where nothing was measured to judge it by."""

    what: str
    wanted: str
    measured: str
    met: bool | None


def requirements(record: Record) -> list[Requirement]:
    """Judge everything but the ratios to peers, which have a table of their own."""
    facts = record.facts
    return [
        *_ratios(record),
        *_beside_idas(record),
        *_paper_step(facts["paper"]),
        *_orders(record),
        *(_beside_c(each) for each in facts["costs"]),
        Requirement(_MINUTES, f"{MOST_MINUTES:g} minutes", f"{facts['minutes']:g} minutes",
                    facts["minutes"] <= MOST_MINUTES),
    ]  # fmt: skip


def _ratios(record: Record) -> Iterator[Requirement]:
    for each in compare(record.rows, record.scenes[0]):
        for form, peer in (("projected", each.projected), ("reduced", each.reduced)):
            ratio, wanted = each.ratio(peer), WANTED_RATIO[form]
            measured = "no peer gets there" if peer is None else "we do not" if ratio is None else f"{ratio:.1f} times"
            met = each.own is not None if peer is None else ratio is not None and ratio >= wanted
            yield Requirement(f"error {each.accuracy:g}: faster than any peer on the {form} form",
                              f"{wanted:g} times", measured, met)  # fmt: skip


def _beside_idas(record: Record) -> Iterator[Requirement]:
    """Judge our fastest routes beside idas on the reduced form, machine code on both; nothing where that is missing."""
    if not any(row.method == PREPARED + COMPILED for row in record.rows):
        return
    compiled = any(row.solved and is_peer(row) and is_compiled(row) for row in record.rows)
    for scene, wanted in WANTED_BESIDE_IDAS.items():
        if scene not in record.scenes:
            continue
        for each in compare_compiled(record.rows, scene):
            if wanted > 2.0 and each.accuracy < 1e-3:
                continue
            ratio = each.ratio(each.reduced)
            measured = "no peer gets there" if each.own else "we do not get there"
            met: bool | None = each.own is not None
            if not compiled:
                measured, met = "its machine code failed", None
            elif ratio is not None:
                measured, met = f"{ratio:.1f} times", ratio >= wanted
            yield Requirement(f"{scene}, error {each.accuracy:g}: {_COMPILED}", f"{wanted:g} times", measured, met)


def _paper_step(paper: Sequence[dict[str, Any]]) -> Iterator[Requirement]:
    """Judge the errors of the paper's largest input at the paper's step; other scenes have no such input."""
    for form, start, most in (("reduced", "exact", MOST_REDUCED), ("projected", "bdf", MOST_PROJECTED)):
        own = [each for each in paper if each["formulation"] == form and each["method"].startswith(start)]
        found = {each["errors"][PAPER_INPUT]: each["method"] for each in own if PAPER_INPUT in each["errors"]}
        if found:
            error = min(found)
            yield Requirement(f"error of {PAPER_INPUT} at a step of 0.1 s, {form}", f"at most {most:g}",
                              f"{error:.1e} ({found[error]})", error <= most)  # fmt: skip


def _orders(record: Record) -> Iterator[Requirement]:
    lines = [line for line in record.order_study[0] if line.nominal > 0]
    fitted = [line for line in lines if line.fit.order is not None]
    short = [line for line in lines if line.fit.order is not None and line.fit.order < line.nominal - ORDER_SHORTFALL]
    if lines:
        names = ", ".join(line.method for line in [*short, *(line for line in lines if line.fit.order is None)])
        above = [f"{each.method} {each.fit.order:.2f} of {each.nominal}" for each in fitted
                 if each.fit.order is not None and each.fit.order > each.nominal + ORDER_SHORTFALL]  # fmt: skip
        yield Requirement("projected methods show at least their nominal order, path of degree 13",
                          f"all {len(lines)}, at most {ORDER_SHORTFALL:g} below",
                          f"{len(fitted) - len(short)}" + (f"; above it: {', '.join(above)}" if above else "")
                          + (f"; not {names}" if names else ""),
                          len(fitted) - len(short) == len(lines))  # fmt: skip


def _beside_c(cost: dict[str, Any]) -> Requirement:
    what = f"{_BESIDE}{cost['model']}"
    if cost["compiled"] is None:
        return Requirement(what, f"at most {MOST_OF_C:g} times", "no gcc", None)
    ratio = cost["inversion"] / cost["compiled"]
    return Requirement(what, f"at most {MOST_OF_C:g} times", f"{ratio:.1f} times", ratio <= MOST_OF_C)


def requirements_table(record: Record) -> str:
    """List what must hold."""
    verdicts = {True: "yes", False: "**no**", None: "not judged"}
    rows = [(each.what, each.wanted, each.measured, verdicts[each.met]) for each in requirements(record)]
    missed = [each.what for each in requirements(record) if each.met is False]
    why = "\n".join(f"* {what}: {REASONS.get(what, NO_REASON)}." for what in missed)
    table = markdown(("what must hold", "wanted", "measured", "met"), rows, 9)
    return f"{table}\nWhat is missed, and why:\n\n{why}\n" if missed else table


def ratios_table(record: Record, scene: str) -> str:
    """Show our fastest route beside the fastest peers on both forms."""
    lines = []
    for each in compare(record.rows, scene):
        for form, peer in (("projected", each.projected), ("reduced", each.reduced)):
            ratio = each.ratio(peer)
            lines.append((f"{each.accuracy:g}", _route(each.own), milliseconds(each.own), form, _route(peer),
                          milliseconds(peer), "-" if ratio is None else f"{ratio:.1f}"))  # fmt: skip
    head = ("error", "our fastest route", "ms", "peer's form", "fastest peer", "ms", "ratio")
    return markdown(head, lines, 9)


def _route(row: Row | None) -> str:
    if row is None:
        return "none gets there"
    solver = "" if row.solver == "servocore" else f"{row.solver}: "
    return f"{solver}{row.method}, {row.model}, {row.setting}"
