"""The page of identified parameters: one HTML file with its figures."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from servocore.files import figure_file
from servocore.identification.result import Identified
from servocore.presentation import Curve, figure_of

_POINTS = 1500  # of a curve
_STYLE = (
    "body{font:15px/1.5 sans-serif;max-width:760px;margin:2em auto;padding:0 1em}table{border-collapse:collapse}"
    "td,th{padding:.2em .8em;text-align:right;border-bottom:1px solid #ddd}td:first-child{text-align:left}"
    "svg{width:100%;height:auto}"
)


def identified_page(found: Identified) -> str:
    """Return the page of a result.

    Parameters
    ----------
    found : Identified
        The result.

    Returns
    -------
    str
        HTML that needs no other file.

    Raises
    ------
    InvalidSetting
        If matplotlib is missing.
    """
    head = ("correlation at lag one", "density near zero by white noise", "dependence on speed, chi-squared of 5")
    residuals = [("input", *head, "delay, s", "bias")]
    for name, (persistence, correlation, by_speed) in found.whiteness.items():
        delay, bias = (", ".join(f"{each:.3g}" for each in of[name]) for of in (found.delays, found.biases))
        residuals.append((name, f"{correlation:.2f}", f"{persistence:.2g}", f"{by_speed:.3g}", delay, bias))
    unknown = "".join(f"<li>{escape(each)}</li>" for each in found.unidentifiable or ("nothing",))
    return "\n".join([
        "<!doctype html>\n<html lang='en'><meta charset='utf-8'><meta name='viewport' content='width=device-width'>",
        f"<title>Identified parameters</title><style>{_STYLE}</style>",
        f"<h1>Identified parameters</h1><p>Logs: {escape(', '.join(found.logs))}.</p>",
        f"<p><b>Verdict.</b> {escape(found.verdict)}.</p><h2>Values</h2>",
        f"{_table(found.table)}<p>With standard errors.</p>",
        f"<h2>Not shown by the logs</h2><ul>{unknown}</ul><h2>Inputs and residuals</h2>",
        _table(residuals), _figure(found), "</html>\n",
    ])  # fmt: skip


def _table(rows: Sequence[Sequence[str]]) -> str:
    """Return texts as a table, the first row its header."""
    cells = ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    header = cells[0].replace("td>", "th>")
    return "<table>" + "".join(f"<tr>{each}</tr>" for each in (header, *cells[1:])) + "</table>"


def _figure(found: Identified) -> str:
    """Return inputs as they were measured and by the model, and their residuals, as an SVG."""
    every, curves = max(1, len(found.residuals["time"]) // _POINTS), list[Curve]()
    for quantity in found.based_on.model().inputs:
        measured, residual = (each[quantity.name][::every] for each in (found.measured, found.residuals))
        for label, values in (("measured", measured), ("by the model", measured - residual)):
            curves.append(Curve(quantity.name, quantity.unit, "", values, {"label": label}))
        curves.append(Curve(f"{quantity.name}, residual", quantity.unit, "", residual, {"color": "0.4"}))
    figure = figure_of(found.residuals["time"][::every], curves, "inputs")
    return "<svg" + figure_file(figure, ".svg").decode().partition("<svg")[2]
