"""Requirements of the study: limit, measured value, and verdict of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.chart.own import COMPILED, PREPARED
from benchmarks.chart.record import Record
from benchmarks.chart.selection import Comparison, compare, is_compiled, is_peer

WANTED_RATIO = {"projected": 10.0, "reduced": 5.0}
"""Least ratio of the fastest peer's time and that of our fastest route on the reduced form, by the peer's form."""
MOST_REDUCED, MOST_PROJECTED = 1e-10, 5e-3
"""Largest errors of M_b, relative to its peak, at the paper's step."""
PAPER_INPUT = "M_b"
ORDER_SHORTFALL = 0.3
"""A fitted order may be so much below the nominal one: leading terms are not all there is."""
WANTED_BESIDE_IDAS = {"mass_on_car": 2.0, "arm": 2.0, "overhead_crane": 5.0, "three_cars": 5.0}
"""The same by scene; of flat ones at the largest error only."""
WANTED_PROJECTED = {False: 1.5, True: 2.0}
"""The same on the projected form, prepared on both sides, interpreted or as machine code."""
MOST_OF_C, MOST_MINUTES = 10.0, 15.0


_BESIDE = "time per instant of `ExactInversion`, divided by that of the bare C function, "
_MINUTES = "the whole study"
_COMPILED = "faster than any peer on the reduced form, machine code on both"
_ON_PROJECTED = "faster than any peer, both on the projected form"
_ALIKE = "faster than any peer, both on the reduced form"
_ACROSS = "reduced form here, faster than any peer on the projected form"
_FEW = "the overhead of a call dominates here, and at this error a peer takes few steps"
_CALL = "both sides are interpreted, and for so few instants the overhead of a call dominates"
_MORE = "the interpreter and the derivatives of the path take additional time"
REASONS = {
    **{f"error {each:g}: {_ALIKE}": _CALL for each in (1e-3, 1e-6)},
    **{f"{scene}, error {each:g}: {_COMPILED}": _FEW for scene in WANTED_BESIDE_IDAS for each in (1e-3, 1e-6)},
    f"{_BESIDE}generalized": "In generalized coordinates the interpreter dominates: it takes about 7 ns for each of"
    " some thousands of operations, C a fraction of one; `ExactInversion` is compiled unless that is switched off",
    f"{_BESIDE}points": _MORE,
    f"{_BESIDE}bodies": _MORE,
    _MINUTES: "every setting of every peer is run, and the time depends on the machine",
}
"""Why a requirement may be missed; the page lists those that are."""
NO_REASON = "not explained; another run may differ"


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
        *_projected(record),
        *_paper_step(facts["paper"]),
        *_orders(record),
        *(_beside_c(each) for each in facts["costs"]),
        Requirement(_MINUTES, f"{MOST_MINUTES:g} minutes", f"{facts['minutes']:g} minutes",
                    facts["minutes"] <= MOST_MINUTES),
    ]  # fmt: skip


def _ratios(record: Record) -> Iterator[Requirement]:
    """Judge the first scene: both on the reduced form, and our reduced form against the paper's, all interpreted."""
    scene = record.scenes[0]
    reduced, projected = (compare(record.rows, scene, form) for form in ("reduced", "projected"))
    for each, other in zip(reduced, projected, strict=True):
        across = Comparison("projected", False, each.accuracy, each.own, other.peer)
        for pair, words in ((across, _ACROSS), (each, _ALIKE)):
            wanted = WANTED_RATIO[pair.form]
            measured = "no peer gets there" if pair.peer is None else "we do not" if pair.own is None else ""
            met = pair.own is not None if pair.peer is None else pair.ratio is not None and pair.ratio >= wanted
            yield Requirement(f"error {each.accuracy:g}: {words}", f"{wanted:g} times",
                              measured or f"{pair.ratio:.1f} times", met)  # fmt: skip


def _beside_idas(record: Record) -> Iterator[Requirement]:
    """Judge our fastest routes beside idas on the reduced form, machine code on both; nothing where that is missing."""
    if not any(row.method == PREPARED + COMPILED for row in record.rows):
        return
    compiled = any(row.solved and is_peer(row) and is_compiled(row) for row in record.rows)
    for scene, wanted in WANTED_BESIDE_IDAS.items():
        if scene not in record.scenes:
            continue
        for each in compare(record.rows, scene, "reduced", compiled=True):
            if wanted > 2.0 and each.accuracy < 1e-3:
                continue
            measured = "no peer gets there" if each.own else "we do not get there"
            met: bool | None = each.own is not None
            if not compiled:
                measured, met = "its machine code failed", None
            elif each.ratio is not None:
                measured, met = f"{each.ratio:.1f} times", each.ratio >= wanted
            yield Requirement(f"{scene}, error {each.accuracy:g}: {_COMPILED}", f"{wanted:g} times", measured, met)


def _projected(record: Record) -> Iterator[Requirement]:
    """Judge prepared runs of the projected form, wherever a peer gets there and runs were prepared."""
    for scene in record.scenes:
        for compiled, wanted in WANTED_PROJECTED.items():
            for each in compare(record.rows, scene, "projected", compiled):
                if each.peer is not None and each.own is not None:
                    words = f"{scene}, error {each.accuracy:g}: {_ON_PROJECTED}{COMPILED if compiled else ''}"
                    met = each.ratio is not None and each.ratio >= wanted
                    yield Requirement(words, f"{wanted:g} times", f"{each.ratio:.1f} times", met)


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


def missed(record: Record) -> str:
    """List the requirements that are missed, each with its reason; one sentence if there are none."""
    found = requirements(record)
    lines = [f"* {each.what}: {REASONS.get(each.what, NO_REASON)}." for each in found if each.met is False]
    head = f"{sum(each.met is True for each in found)} of {len(found)} requirements are met."
    return "\n".join([f"{head} Missed:", "", *lines] if lines else [head])


def requirement_rows(record: Record) -> Iterator[tuple[str, ...]]:
    """Yield the requirements as lines of a file, the head first."""
    yield "requirement", "wanted", "measured", "met"
    verdicts = {True: "yes", False: "no", None: "not judged"}
    for each in requirements(record):
        yield each.what, each.wanted, each.measured, verdicts[each.met]
