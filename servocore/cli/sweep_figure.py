"""The page of a sweep: the peak of the first input over the varied parameters, and a table of all results."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from servocore.files import figure_file

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>Sweep of {title}</title>
<style>body {{ font: 16px/1.5 sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }}
img {{ max-width: 100%; }} table {{ border-collapse: collapse; }}
td, th {{ padding: 0.2rem 1rem 0.2rem 0; text-align: left; }}
td + td, th + th {{ text-align: right; }} .wide {{ overflow-x: auto; }}</style></head>
<body><h1>Sweep of {title}</h1>
<p>{cases} cases, {failed} not solved. Varied: {varied}.</p>
<img alt="{alt}" src="data:image/png;base64,{picture}">
<div class="wide"><table><tr><th>quantity</th><th>unit</th><th>minimum</th><th>median</th><th>maximum</th></tr>
{rows}</table></div>
{failures}<p>Open the numbers with <code>{opening}</code>.</p></body></html>
"""
_SENTENCES = 10


def sweep_page(swept: Any, title: str, store: str) -> tuple[str, bytes]:
    """Return a page about the dataset of a sweep, and its figure as PNG."""
    settings = json.loads(swept.attrs["settings"])  # in the order of the options, which coordinates lose
    first = f"peak_{settings['quantities'][0]}"
    figure = Figure(figsize=(7.0, 4.4), layout="constrained", dpi=130)
    axes = figure.subplots()
    _draw(axes, swept, list(settings["varied"]), first)
    axes.set_title("")
    picture = figure_file(figure, ".png")
    return _page(swept, settings["varied"], title, first, picture, store), picture


def _draw(axes: Axes, swept: Any, varied: Sequence[str], name: str) -> None:
    """Draw a peak over one or two varied parameters; over further dimensions its maximum."""
    x, y = (*varied, name)[:2]
    if "case" in swept.sizes:
        swept.plot.scatter(x=x, y=y, ax=axes, s=5, edgecolors="none", **({} if y == name else {"hue": name}))
        return
    wide = [each for each in varied[:2] if swept.sizes[each] > 1] or varied[:1]
    shown = swept[name].max([each for each in swept[name].dims if each not in wide], keep_attrs=True)
    if shown.ndim < 2:
        shown.plot.line(ax=axes)
        return
    shown.plot.pcolormesh(x=x, y=y, ax=axes, cmap="viridis")
    if min(shown.shape) > 2 and shown.max() > shown.min():
        lines = shown.plot.contour(x=x, y=y, ax=axes, colors="white", linewidths=0.8)
        axes.clabel(lines, fontsize="small")


def _order(name: str) -> tuple[int, str]:
    """Return the sort key of a variable of a dataset: a store has no order."""
    return (name.startswith("margin_") - name.startswith("peak_"), name)


def _page(swept: Any, varied: Mapping[str, Any], title: str, first: str, picture: bytes, store: str) -> str:
    failures = swept.failure.to_numpy().ravel()
    reasons = list(dict.fromkeys(str(failure) for failure in failures[failures != ""]))
    rows = []
    for name in sorted(swept, key=_order):
        if name == "failure" or "instant" in swept[name].dims:
            continue
        values = swept[name].to_numpy()
        finite = values[np.isfinite(values)]
        shown = [f"{value:.4g}" for value in np.quantile(finite, (0.0, 0.5, 1.0))] if finite.size else ["–"] * 3
        cells = "".join(f"<td>{html.escape(str(cell))}</td>" for cell in (name, swept[name].attrs["units"], *shown))
        rows.append(f"<tr>{cells}</tr>\n")
    sentences = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in reasons[:_SENTENCES])
    more = f"<p>Reasons why cases are not solved, among others:</p><ul>{sentences}</ul>\n" if reasons else ""
    ranges = [f"{name} from {min(row):g} to {max(row):g} ({len(row)})" for name, (_, row) in varied.items()]
    opening = f'{"pandas.read_parquet" if store.endswith(".parquet") else "xarray.open_zarr"}("{store}")'
    return _PAGE.format(
        title=html.escape(title), cases=failures.size, failed=int((failures != "").sum()),
        varied=html.escape(", ".join(ranges)), alt=f"{first} over the varied parameters", rows="".join(rows),
        picture=base64.b64encode(picture).decode(), failures=more, opening=html.escape(opening, quote=False),
    )  # fmt: skip
