"""The page of the atlas: a table of advice, then one section a row; numbers come from the results."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.atlas.record import FAILS, REFUSED, SURVIVES, Findings, Row

HEAD = """# Failure atlas

How the integration of servo constraints fails, at which rate, and which routes stay accurate. Every row predicts a
failure from theory, measures it, and measures beside it a route that survives, with its limit. `make atlas` writes
this page, its figures and [results.csv](results.csv), all observations beside the expected result;
`python -m benchmarks.atlas --page` writes the page from the stored results. {survives} observations are of routes that
survive (accurate within the bound), {fails} of failures (wrong, or ended with an error, as predicted), {refused} of
refusals in advance. {gaps}
"""
SUMMARY = """![Observations that survive, are refused or fail, by row and kind of route](summary.png)

*Each square is an observation. Most failures are provoked, so their numbers are no rates.* [SVG](summary.svg)
"""


def page(rows: Sequence[Row], findings: Sequence[Findings]) -> str:
    """Return the page as Markdown."""
    records = [record for found in findings for record in found.records]
    counts = {verdict: sum(each.verdict == verdict for each in records) for verdict in (SURVIVES, FAILS, REFUSED)}
    missed = sum(not each.agrees for each in records)
    reasons = "; ".join(reason for found in findings for reason in found.gaps.values())
    gaps = f"{missed} not as expected{': ' + reasons if reasons else ''}." if missed else "All are as expected."
    parts = [HEAD.format(**counts, gaps=gaps), _advice(rows), SUMMARY]
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
        theory, "",
        f"![{row.title}]({row.name}.png)", "", f"*{caption}* [SVG]({row.name}.svg)", "",
        f"**Survives.** {survivor}", "",
        f"**Limits.** {limit}", "",
    ])  # fmt: skip
