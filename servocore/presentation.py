"""Trajectories as a figure, as a table in a notebook, and as tables of pandas and xarray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from servocore.errors import refused_if_missing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

_ONE_COLUMN = 4  # panels; more stand in two columns


@dataclass(frozen=True)
class Curve:
    """A trajectory with its name, unit, meaning, and one value an instant."""

    name: str
    unit: str
    description: str
    values: Array


def figure_of(t: Array, curves: Sequence[Curve], title: str) -> Figure:
    """Return a figure with a panel for every trajectory, angles in degrees.

    Raises
    ------
    InvalidSetting
        If matplotlib is missing.
    """
    with refused_if_missing():
        from matplotlib import pyplot  # noqa: PLC0415, only whoever plots needs it
    columns = 1 if len(curves) <= _ONE_COLUMN else 2
    rows = -(-len(curves) // columns)
    figure = pyplot.figure(figsize=(7.0 if columns == 1 else 9.0, 0.9 + 1.4 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False).T.ravel()
    for panel, curve in zip(panels, curves, strict=False):
        unit, factor = _shown_unit(curve.unit)
        panel.plot(t, factor * curve.values)
        panel.set_title(f"{curve.name} ({unit})", loc="left", fontsize="medium")
        panel.margins(x=0.0)
        panel.grid(alpha=0.25)
    for panel in panels[len(curves) :]:
        panel.set_visible(False)
    for panel in (panels[rows - 1], panels[len(curves) - 1]):
        panel.tick_params(labelbottom=True)
        panel.set_xlabel("time (s)")
    figure.suptitle(title, x=0.01, ha="left", fontsize="medium")
    return figure


def _shown_unit(unit: str) -> tuple[str, float]:
    """Return a unit as figures write it, and the factor to it."""
    if "rad" in unit:
        return unit.replace("rad", "deg").replace(".", " "), 180.0 / np.pi
    return unit.replace(".", " "), 1.0


def html_table(t: Array, curves: Sequence[Curve], heading: Sequence[str]) -> str:
    """Return what a notebook shows: a heading, and of every trajectory name, unit, ends, extremes and meaning."""
    from html import escape  # noqa: PLC0415 - for notebooks

    rows = "".join(
        f"<tr><th>{escape(curve.name)}</th><td>{escape(curve.unit)}</td>"
        + "".join(f"<td>{value:.6g}</td>" for value in _ends_and_extremes(curve.values))
        + f"<td style='text-align:left'>{escape(curve.description)}</td></tr>"
        for curve in curves
    )
    columns = ("", "unit", f"at {t[0]:g} s", f"at {t[-1]:g} s", "least", "largest", "")
    head = "".join(f"<th>{column}</th>" for column in columns)
    text = "<br>".join(escape(line) for line in heading if line)
    return f"<p>{text}</p><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def _ends_and_extremes(values: Array) -> tuple[float, float, float, float]:
    return float(values[0]), float(values[-1]), float(values.min()), float(values.max())


def data_frame(t: Array, curves: Sequence[Curve], about: dict[str, str]) -> Any:
    """Return a pandas DataFrame over the time in s, with units in ``attrs["units"]``.

    Raises
    ------
    InvalidSetting
        If pandas is missing.
    """
    with refused_if_missing():
        import pandas as pd  # noqa: PLC0415
    frame = pd.DataFrame({curve.name: curve.values for curve in curves}, index=pd.Index(t, name="time"))
    frame.attrs.update(about, units={"time": "s"} | {curve.name: curve.unit for curve in curves})
    return frame


def dataset(t: Array, curves: Sequence[Curve], about: dict[str, str]) -> Any:
    """Return an xarray Dataset over ``time``, with ``units`` and ``long_name`` of every variable.

    Raises
    ------
    InvalidSetting
        If xarray is missing.
    """
    with refused_if_missing():
        import xarray as xr  # noqa: PLC0415
    time = xr.Variable("time", t, {"units": "s", "long_name": "time"})
    variables = {
        curve.name: ("time", curve.values, {"units": curve.unit, "long_name": curve.description}) for curve in curves
    }
    return xr.Dataset(variables, {"time": time}, about)
