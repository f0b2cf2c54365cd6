"""The page of identified parameters: one HTML file with its figures."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from servocore.identification.result import Identified
from servocore.numerics.compiled_calls import Array

_WIDTH, _HEIGHT, _PAD = 720, 150, 6
_POINTS = 1500  # of a curve
_COLOURS = ("#0072b2", "#d55e00")
_STYLE = (
    "body{font:15px/1.5 sans-serif;max-width:760px;margin:2em auto;padding:0 1em}table{border-collapse:collapse}"
    "td,th{padding:.2em .8em;text-align:right;border-bottom:1px solid #ddd}td:first-child{text-align:left}"
)


def identified_page(found: Identified, note: str = "") -> str:
    """Return the page of a result.

    Parameters
    ----------
    found : Identified
        The result.
    note : str
        A sentence at its head, as that the log is synthetic.

    Returns
    -------
    str
        HTML that needs no other file.
    """
    parts = [
        "<!doctype html>\n<html lang='en'><meta charset='utf-8'><meta name='viewport' content='width=device-width'>",
        f"<title>Identified parameters</title><style>{_STYLE}</style>",
        f"<h1>Identified parameters</h1><p>{escape(note)} Logs: {escape(', '.join(found.logs))}.</p>",
        f"<p><b>Verdict.</b> {escape(found.verdict)}.</p>",
        "<h2>Values</h2>",
        _table(
            ("parameter", "believed", "identified", "standard error", "from what was believed"),
            [
                (name, f"{believed:.4g}", f"{found.values[name]:.5g}", f"{error:.2g}", f"{found.prior_share[name]:.0%}")
                for (name, error), believed in zip(found.standard_errors.items(), found.believed.values(), strict=True)
            ],
        ),
        "<p>Intervals of 95 %, relative to the believed values: before (grey) and after the logs.</p>",
        _intervals(found),
        "<h2>Not shown by the logs</h2>",
        "<ul>" + "".join(f"<li>{escape(each)}</li>" for each in found.unidentifiable or ("nothing",)) + "</ul>",
        "<h2>Inputs, measured (blue) and by the model (orange)</h2>",
    ]
    t, residuals = found.residuals["time"], found.residuals
    for name, (persistence, correlation) in found.whiteness.items():
        measured = found.measured[name]
        model = measured - residuals[name]
        delay, bias = (", ".join(f"{each:.3g}" for each in of[name]) for of in (found.delays, found.biases))
        parts += [
            f"<h3>{escape(name)}</h3>{_chart(t, (measured, model))}<p>Residuals: correlation at lag one"
            f" {correlation:.2f}, spectral density near zero {persistence:.2g} times that of white noise."
            f" Delay {delay} s, bias {bias}.</p>{_chart(t, (residuals[name],))}"
        ]
    return "\n".join([*parts, "</html>", ""])


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["".join(f"<th>{escape(cell)}</th>" for cell in head)]
    lines += ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    return "<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"


def _svg(height: int, body: str) -> str:
    return f"<svg viewBox='0 0 {_WIDTH} {height}' width='100%' xmlns='http://www.w3.org/2000/svg'>{body}</svg>"


def _chart(t: Array, curves: Sequence[Array]) -> str:
    """Return curves over time with their bounds as an SVG; NaN are left out."""
    low, high = (float(bound([bound(each[np.isfinite(each)]) for each in curves])) for bound in (np.min, np.max))
    every, size = max(1, len(t) // _POINTS), high - low or 1.0
    x = _PAD + (_WIDTH - 2 * _PAD) * (t - t[0]) / float(np.ptp(t))
    lines = ""
    for curve, colour in zip(curves, _COLOURS, strict=False):
        y = _PAD + (_HEIGHT - 2 * _PAD) * (high - curve) / size
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x[::every], y[::every], strict=True) if np.isfinite(b))
        lines += f"<polyline points='{points}' fill='none' stroke='{colour}' stroke-width='1'/>"
    label = f"<text x='{_PAD}' y='14' font-size='11'>{high:.3g}</text>"
    label += f"<text x='{_PAD}' y='{_HEIGHT - 2}' font-size='11'>{low:.3g}; {float(np.ptp(t)):.3g} s</text>"
    return _svg(_HEIGHT, lines + label)


def _intervals(found: Identified) -> str:
    """Return the intervals before and after, one row a parameter."""
    rows, widest = "", 2 * max(found.uncertainties.values())
    for k, (name, before) in enumerate(found.uncertainties.items()):
        size = abs(found.believed[name]) or 1.0
        change, after = (found.values[name] - found.believed[name]) / size, found.standard_errors[name] / size
        for place, half, colour, thick in ((0.0, before, "#bbb", 9), (change, after, _COLOURS[0], 4)):
            a, b = (float(np.clip(place + sign * 2 * half, -1.1 * widest, 1.1 * widest)) for sign in (-1, 1))
            x = [450 + 240 * end / (1.1 * widest) for end in (a, b)]
            rows += f"<line x1='{x[0]:.1f}' x2='{max(x[1], x[0] + 2):.1f}' y1='{20 * k + 12}' y2='{20 * k + 12}' "
            rows += f"stroke='{colour}' stroke-width='{thick}'/>"
        rows += f"<text x='0' y='{20 * k + 16}' font-size='12'>{escape(name)}</text>"
    return _svg(20 * len(found.uncertainties) + 10, rows)
