"""The page of a study; all its numbers are computed here from the results."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.identification.cranes import KINDS, WRONG
from benchmarks.identification.study import Row

_GOOD = 1.96
FAMILIES = {
    "A": "good: samples every 1 to 5 ms, noise of 0.3 to 2 % of half the range of an input, encoders of 0.01 mm",
    "B": "coarse: 5 to 10 ms, 0.5 to 3 %, encoders of 0.2 mm, delays of 0 to 8 ms, 1 % outliers, 3 % missing samples",
    "C": "as A, but the log begins in motion",
    "D": "as B, two logs in one fit",
}
_HEAD = """# Identification of random cranes

`make identification` writes this page, and continues a study that was interrupted. Synthetic logs: `sc.measured`
simulates random cranes under sampled drives. Parameters are 1/1.5 to 1.5 times the defaults, believed values wrong by
up to 22 %, paths of 20 s random multisines. Families of logs:

"""
_STRAY = """
## Stray

Jobs of 8 to 15 s under the feedforward of believed and of identified data, without sensors, so that parameters alone
let the load stray; medians in mm. *Kept* counts jobs whose stray is within the prediction, *worse* those on which the
identified data stray farther than the believed ones by more than the prediction.

"""
_WRONG = """
## Wrong plants

The model lacks an effect of the plant. *Beyond* counts jobs on which the load strays farther than predicted with the
residuals of the fit, in brackets the median of stray by prediction there.

"""


def page(rows: Sequence[Row], peers: str) -> str:
    """Return the page of a study, with the table of other methods."""
    good = [row for row in rows if not row.refused]
    right = [row for row in good if not row.case.wrong]
    plain = [row for row in right if row.case.family in "AB"]
    lines = [*(f"* **{name}**, {about}." for name, about in FAMILIES.items()), "", *_summary(plain), ""]
    lines += [
        "| cranes | family | logs | coverage of 95 % | rms of error by Cramér-Rao bound | largest error without a"
        " warning, standard errors | warnings | not settled | median, s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for kind in (*KINDS, "all"):
        for family in FAMILIES:
            own = [row for row in right if row.case.family == family and kind in (row.case.kind, "all")]
            lines += [f"| {kind} | {family} | {_accuracy(own)} |"] if own else []
    lines += ["", "Rms error of each parameter, %:", "", *_by_parameter(right)]
    refused = [row for row in rows if row.refused]
    lines += ["", f"Refused: {len(refused)}." + "".join(f"\n* {row.case}: {row.refused}" for row in refused)]
    return _HEAD + "\n".join(lines) + "\n" + _STRAY + _stray(plain) + _WRONG + _wrong(good) + peers


def _summary(rows: Sequence[Row]) -> list[str]:
    if not rows:
        return ["No log yet."]
    best = [row for row in rows if row.case.family == "A"]
    cranes = len({(row.case.kind, row.case.family, row.case.seed) for row in rows})
    warned = f"{np.mean([bool(row.doubts) for row in best]):.1%}" if best else "none"
    trusted = _by_bound([row for row in best if not row.doubts])
    return [
        f"{cranes} logs of families A and B: coverage of 95 % intervals {_coverage(rows)}, rms error on A"
        f" {_by_bound(best)} times the Cramér-Rao bound with all logs, {trusted} without those that are"
        f" warned of, warnings on {warned} of the good logs, median"
        f" {np.median([row.seconds for row in rows]):.1f} s of processor time a log."
    ]


def _coverage(rows: Sequence[Row]) -> str:
    return f"{np.mean(np.abs(np.concatenate([row.z for row in rows])) < _GOOD):.1%}"


def _by_bound(rows: Sequence[Row]) -> str:
    ratios = [np.array(row.errors) / np.array(row.bounds) for row in rows]
    return f"{np.sqrt(np.mean(np.concatenate(ratios) ** 2)):.2f}" if ratios else "-"


def _accuracy(rows: Sequence[Row]) -> str:
    worst = max((float(np.abs(row.z).max()) for row in rows if not row.doubts), default=np.nan)
    counts = sum(bool(row.doubts) for row in rows), sum(not row.settled for row in rows)
    seconds = np.median([row.seconds for row in rows])
    cells = [str(len(rows)), _coverage(rows), _by_bound(rows), f"{worst:.1f}", *map(str, counts), f"{seconds:.1f}"]
    return " | ".join(cells)


def _by_parameter(rows: Sequence[Row]) -> list[str]:
    every = tuple(dict.fromkeys(name for names in KINDS.values() for name in names))
    lines = [f"| cranes | family | {' | '.join(every)} |", "|---|---|" + "---|" * len(every)]
    for kind, names in KINDS.items():
        for family in FAMILIES:
            own = [row.errors for row in rows if row.case.family == family and row.case.kind == kind]
            if own:
                rms = dict(zip(names, 100 * np.sqrt(np.mean(np.square(own), axis=0)), strict=True))
                cells = (f"{rms[name]:.2g}" if name in rms else "" for name in every)
                lines.append(f"| {kind} | {family} | {' | '.join(cells)} |")
    return lines


def _stray(rows: Sequence[Row]) -> str:
    if not rows:
        return "No job yet.\n"
    stray, predicted, believed = np.array([(row.stray, row.predicted, row.believed) for row in rows]).T
    medians = [float(np.median(each)) for each in (believed, stray, predicted)]
    cells = [str(len(rows)), *(f"{each:.2g}" for each in medians), f"{medians[2] / medians[1]:.2g}"]
    cells += [f"{np.mean(stray <= predicted):.0%}", str(int(np.sum(stray > believed + predicted)))]
    head = "| jobs | believed | identified | predicted, 95 % | predicted by identified | kept | worse |\n"
    return f"{head}|---|---|---|---|---|---|---|\n| {' | '.join(cells)} |\n"


def _wrong(rows: Sequence[Row]) -> str:
    lines = ["| the model lacks | logs | with warnings | beyond | of these with warnings |", "|---|---|---|---|---|"]
    for wrong in (*WRONG, "all"):
        own = [row for row in rows if row.case.wrong and wrong in (row.case.wrong, "all")]
        beyond = [row for row in own if row.stray > row.predicted]
        warned = [sum(bool(row.doubts) for row in some) for some in (own, beyond)]
        by = f" ({np.median([row.stray / row.predicted for row in beyond]):.2g})" if beyond else ""
        lines.append(f"| {wrong} | {len(own)} | {warned[0]} | {len(beyond)}{by} | {warned[1]} |")
    return "\n".join(lines) + "\n"
