"""The page of the atlas: one screen of advice, then fixed sections for every row; numbers come from the results."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from benchmarks.atlas.record import FAILS, REFUSED, SURVIVES, Findings, Record, Row

HEAD = """# Failure atlas

How the integration of servo constraints fails, why, and what does not fail. Every row predicts its failure from theory,
measures it, and measures beside it a route of this library that survives; where that route ends is said as a number.
`make atlas` writes this page, its figures and [results.csv](results.csv); the numbers below are those of the last run:
{survives} observations of routes that survive, {fails} of failures, {refused} of refusals. {gaps}

*survives*: right within the bound. *fails*: wrong, or given up, as predicted. *refused*: an error in advance.
In the column *expected*, ± stands for what theory predicts; ≤ and ≥ are bounds that a result must keep, some of
them set after a first run had been seen; where there is neither it says *no prediction*.
"""
SUMMARY = """## Who survives

![Shares of observations that survive, are refused or fail, by row and kind of route](summary.png)

*Every row below by kinds of routes; the numbers count observations of the table. A failure is one that theory predicts:
most of them were provoked.* [SVG](summary.svg)
"""
COLUMNS = ("scene", "route", "parameter", "value", "expected", "observed", "verdict")


def page(rows: Sequence[Row], findings: Sequence[Findings]) -> str:
    """Return the page as Markdown."""
    records = [record for found in findings for record in found.records]
    counts = {verdict: sum(each.verdict == verdict for each in records) for verdict in (SURVIVES, FAILS, REFUSED)}
    missed = sum(not each.agrees for each in records)
    reasons = "; ".join(reason for found in findings for reason in found.gaps.values())
    gaps = f"{missed} not as expected{': ' + reasons if reasons else ''}." if missed else "All are as expected."
    parts = [HEAD.format(**counts, gaps=gaps), SUMMARY, _advice(rows)]
    parts += [_section(k, row, found) for k, (row, found) in enumerate(zip(rows, findings, strict=True), 1)]
    return "\n".join(parts)


def _advice(rows: Sequence[Row]) -> str:
    lines = ["## Do and avoid", "", "| | avoid | do |", "|---|---|---|"]
    lines += [f"| [{k}]({anchor(k, row)}) | {row.avoid} | {row.do} |" for k, row in enumerate(rows, 1)]
    return "\n".join([*lines, ""])


def anchor(number: int, row: Row) -> str:
    """Return the link to a row's section."""
    kept = "".join(each for each in f"{number}. {row.title}".lower() if each.isalnum() or each in " -")
    return "#" + kept.replace(" ", "-")


def _section(number: int, row: Row, found: Findings) -> str:
    theory, survivor, limit, caption = (
        text.format(**found.facts) for text in (row.theory, row.survivor, row.limit, row.caption)
    )
    return "\n".join([
        f"## {number}. {row.title}", "",
        "### What fails", "", theory, "",
        "### What was seen", "", f"![{row.title}]({row.name}.png)", "", f"*{caption}* [SVG]({row.name}.svg)", "",
        table(found.records), "",
        "### What survives", "", survivor, "",
        "### Its limit", "", limit, "",
    ])  # fmt: skip


def table(records: Iterable[Record]) -> str:
    """Return records as a Markdown table."""
    lines = [f"| {' | '.join(COLUMNS)} |", f"|{'---|' * len(COLUMNS)}"]
    lines += [f"| {' | '.join(_cell(getattr(each, name)) for name in COLUMNS)} |" for each in records]
    return "\n".join(lines)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<=", "≤").replace(">=", "≥").replace("+-", "±")
