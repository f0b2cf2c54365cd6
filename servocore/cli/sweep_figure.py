"""The page of a sweep: the peak of the first input over what varies, and a table of all that was computed."""

from __future__ import annotations

import base64
import html
import io
import json
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>Sweep of {title}</title>
<style>body {{ font: 16px/1.5 sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }}
img {{ max-width: 100%; }} table {{ border-collapse: collapse; }}
td, th {{ padding: 0.2rem 1rem 0.2rem 0; text-align: left; }}
td + td, th + th {{ text-align: right; }} .wide {{ overflow-x: auto; }}</style></head>
<body><h1>Sweep of {title}</h1>
<p>{cases} cases, {failed} not solved. What varies: {varied}.</p>
<img alt="{alt}" src="data:image/png;base64,{picture}">
<div class="wide"><table><tr><th>quantity</th><th>unit</th><th>least</th><th>median</th><th>largest</th></tr>
{rows}</table></div>
{failures}<p>Open the numbers with <code>{opening}</code>.</p></body></html>
"""
_SENTENCES = 10


def sweep_page(swept: Any, title: str, store: str) -> tuple[str, bytes]:
    """Return a page about the dataset of a sweep, and its figure as PNG."""
    first = f"peak_{json.loads(swept.attrs['settings'])['quantities'][0]}"
    figure = Figure(figsize=(7.0, 4.4), layout="constrained", dpi=130)
    _draw(figure.subplots(), figure, swept, first)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return _page(swept, title, first, stream.getvalue(), store), stream.getvalue()


def _draw(axes: Axes, figure: Figure, swept: Any, name: str) -> None:
    """Draw a peak over one or two of the things that vary; over more dimensions the largest."""
    varied = list(json.loads(swept.attrs["settings"])["varied"])  # in the order of the options, which coordinates lose
    label = f"peak of {name.removeprefix('peak_')} ({swept[name].attrs['units']})"
    if "case" in swept.sizes:
        x = swept[varied[0]].to_numpy()
        if len(varied) == 1:
            axes.plot(x, swept[name].to_numpy(), ".", markersize=3)
            axes.set_ylabel(label)
        else:
            points = axes.scatter(x, swept[varied[1]].to_numpy(), c=swept[name].to_numpy(), s=5, cmap="viridis")
            figure.colorbar(points, ax=axes, label=label)
            axes.set_ylabel(_titled(swept, varied[1]))
        axes.set_xlabel(_titled(swept, varied[0]))
        return
    shown = swept[name].max([dimension for dimension in swept[name].dims if dimension not in varied[:2]])
    if len(varied) < 2 or min(shown.sizes.values()) < 2:
        long = max(shown.dims, key=lambda each: shown.sizes[each])
        line = shown.max([dimension for dimension in shown.dims if dimension != long])
        axes.plot(swept[long].to_numpy(), line.to_numpy())
        axes.set_xlabel(_titled(swept, long))
        axes.set_ylabel(label)
        return
    x, y = varied[:2]
    values = np.ma.masked_invalid(shown.transpose(y, x).to_numpy())
    mesh = axes.pcolormesh(swept[x].to_numpy(), swept[y].to_numpy(), values, cmap="viridis", shading="nearest")
    figure.colorbar(mesh, ax=axes, label=label)
    if values.count() and min(values.shape) > 2 and values.max() > values.min():
        lines = axes.contour(swept[x].to_numpy(), swept[y].to_numpy(), values, colors="white", linewidths=0.8)
        axes.clabel(lines, fontsize="small")
    axes.set_xlabel(_titled(swept, x))
    axes.set_ylabel(_titled(swept, y))


def _titled(swept: Any, name: Any) -> str:
    unit = swept[name].attrs.get("units", "")
    return f"{str(name).replace('_', ' ')} ({unit})" if unit else str(name)


def _order(name: str) -> tuple[int, str]:
    """Return what sorts the variables of a dataset: a store gives them in no order of its own."""
    return (name.startswith("margin_") - name.startswith("peak_"), name)


def _page(swept: Any, title: str, first: str, picture: bytes, store: str) -> str:
    failures = swept.failure.to_numpy().ravel()
    told = list(dict.fromkeys(str(failure) for failure in failures[failures != ""]))
    rows = []
    for name in sorted(swept, key=_order):
        if name == "failure" or "instant" in swept[name].dims:
            continue
        values = swept[name].to_numpy()
        with np.errstate(all="ignore"):
            finite = values[np.isfinite(values)]
        shown = (
            [f"{value:.4g}" for value in (finite.min(), np.median(finite), finite.max())] if finite.size else ["–"] * 3
        )
        cells = "".join(f"<td>{html.escape(str(cell))}</td>" for cell in (name, swept[name].attrs["units"], *shown))
        rows.append(f"<tr>{cells}</tr>\n")
    sentences = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in told[:_SENTENCES])
    more = f"<p>Cases that are not solved say, among others:</p><ul>{sentences}</ul>\n" if told else ""
    settings = json.loads(swept.attrs["settings"])
    varied = ", ".join(
        f"{name} from {min(values):g} to {max(values):g} ({len(values)})"
        for name, (_, values) in settings["varied"].items()
    )
    opening = f'{"pandas.read_parquet" if store.endswith(".parquet") else "xarray.open_zarr"}("{store}")'
    return _PAGE.format(
        title=html.escape(title), cases=failures.size, failed=int((failures != "").sum()), varied=html.escape(varied),
        alt=f"{first} over what varies", picture=base64.b64encode(picture).decode(), rows="".join(rows), failures=more,
        opening=html.escape(opening, quote=False),
    )  # fmt: skip
