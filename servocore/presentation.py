"""Trajectories as a figure, an animation, a table in a notebook, and tables of pandas and xarray."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from servocore.errors import extra, refused_if_missing

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

_ONE_COLUMN = 4  # panels; more stand in two columns


@dataclass(frozen=True)
class Curve:
    """A trajectory with its name, unit, meaning, one value an instant, and how Matplotlib draws it."""

    name: str
    unit: str
    description: str
    values: Array
    look: Mapping[str, Any] = field(default_factory=dict)


def figure_of(t: Array, curves: Sequence[Curve], title: str) -> Figure:
    """Return a figure with a panel for all trajectories of a name, angles in degrees, and a legend of their labels.

    Raises
    ------
    InvalidSetting
        If matplotlib is missing.
    """
    with refused_if_missing():
        from matplotlib import pyplot  # noqa: PLC0415 - for figures only
    names = list(dict.fromkeys(curve.name for curve in curves))
    columns = 1 if len(names) <= _ONE_COLUMN else 2
    rows = -(-len(names) // columns)
    figure = pyplot.figure(figsize=(7.0 if columns == 1 else 9.0, 0.9 + 1.4 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False).T.ravel()
    for curve in curves:
        panel, (unit, factor) = panels[names.index(curve.name)], _shown_unit(curve.unit)
        panel.plot(t, factor * curve.values, **curve.look)
        panel.set_title(f"{curve.name} ({unit})", loc="left", fontsize="medium")
        panel.margins(x=0.0)
        panel.grid(alpha=0.25)
    for panel in panels[len(names) :]:
        panel.set_visible(False)
    for panel in (panels[rows - 1], panels[len(names) - 1]):
        panel.tick_params(labelbottom=True)
        panel.set_xlabel("time (s)")
    labels = {label: line for panel in panels for line, label in zip(*panel.get_legend_handles_labels(), strict=True)}
    if labels:
        figure.legend(labels.values(), labels.keys(), loc="outside lower center", ncols=6, frameon=False)
    figure.suptitle(title, x=0.01, ha="left", fontsize="medium")
    return figure


def _shown_unit(unit: str) -> tuple[str, float]:
    """Return a unit as figures write it, and the factor to it."""
    if "rad" in unit:
        return unit.replace("rad", "deg").replace(".", " "), 180.0 / np.pi
    return unit.replace(".", " "), 1.0


def html_table(t: Array, curves: Sequence[Curve], heading: Sequence[str]) -> str:
    """Return the HTML of a notebook: a heading, and name, unit, ends, extremes and meaning of every trajectory."""
    from html import escape  # noqa: PLC0415 - for notebooks

    rows = "".join(
        f"<tr><th>{escape(curve.name)}</th><td>{escape(curve.unit)}</td>"
        + "".join(f"<td>{value:.6g}</td>" for v in (curve.values,) for value in (v[0], v[-1], v.min(), v.max()))
        + f"<td style='text-align:left'>{escape(curve.description)}</td></tr>"
        for curve in curves
    )
    columns = ("", "unit", f"at {t[0]:g} s", f"at {t[-1]:g} s", "minimum", "maximum", "")
    head = "".join(f"<th>{column}</th>" for column in columns)
    text = "<br>".join(escape(line) for line in heading if line)
    return f"<p>{text}</p><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def data_frame(t: Array, curves: Sequence[Curve], about: dict[str, str]) -> Any:
    """Return a pandas DataFrame over the time in s, with units in ``attrs["units"]``.

    Raises
    ------
    InvalidSetting
        If pandas is missing.
    """
    pd = extra("pandas")
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
    xr = extra("xarray")
    time = xr.Variable("time", t, {"units": "s", "long_name": "time"})
    variables = {
        curve.name: ("time", curve.values, {"units": curve.unit, "long_name": curve.description}) for curve in curves
    }
    return xr.Dataset(variables, {"time": time}, about)


@dataclass(frozen=True)
class Motion:
    """Parts between points, and the positions of the points at every instant.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times in s.
    places : ndarray, shape (N, points, 3)
        In m.
    parts : sequence of mapping
        Kind, name, places among the points, axis along which it runs, as a drawing gives them.
    colours : mapping of int to ndarray
        By the number of a part: the quantity that colours it, over time.
    tracked : int or None
        The point that follows the path.
    flat : bool
        Whether all points lie in the plane y = 0.
    """

    t: Array
    places: Array
    parts: Sequence[Mapping[str, Any]]
    colours: Mapping[int, Array]
    tracked: int | None
    flat: bool

    def corners(self) -> tuple[Array, Array]:
        """Return the lowest and the highest coordinates of the motion, with a margin."""
        tips = [self.line(part, k)[-1:] for part in self.parts if part["kind"] == "bridge" for k in range(len(self.t))]
        drawn = np.concatenate([self.places.reshape(-1, 3), *tips])
        low, high = drawn.min(axis=0), drawn.max(axis=0)
        room = _ROOM * max(float((high - low).max()), 1e-3)
        return low - room, high + room

    def line(self, part: Mapping[str, Any], k: int) -> Array:
        """Return the points that a part joins at an instant, shape (n, 3): its own, or its ends."""
        own: Array = self.places[k, part["places"]]
        if part["kind"] == "bridge":
            ways = self.places[:, part["places"][1]] - self.places[:, part["places"][0]]
            lengths = np.linalg.norm(ways, axis=1)
            return np.array([own[0], own[0] + ways[k] * _OVERHANG * lengths.max() / max(lengths[k], 1e-12)])
        if part["kind"] in ("rail", "post"):
            ends, axis = np.repeat(own, 2, axis=0), 2 if part["kind"] == "post" else part["along"]
            low, high = self.places.min(axis=(0, 1))[axis], self.places.max(axis=(0, 1))[axis]
            ends[:, axis] = (low, own[0, 2]) if part["kind"] == "post" else (low, high)
            return ends
        return own


_ROOM, _OVERHANG = 0.06, 1.12
_STEEL, _LOAD, _PATH = "#47525e", "#0072b2", "#d55e00"
_KINDS: dict[str, dict[str, Any]] = {
    "rope": {"color": "black", "lw": 1.6}, "bar": {"color": _STEEL, "lw": 3.0}, "bridge": {"color": _STEEL, "lw": 5.0},
    "rail": {"color": _STEEL, "lw": 3.0}, "spring": {"color": _STEEL, "lw": 1.5, "ls": (0, (2, 1))},
    "post": {"color": _STEEL, "lw": 4.0}, "pin": {"ls": "", "color": _STEEL, "marker": "o", "ms": 4},
    "box": {"ls": "", "color": "#009e73", "marker": "s", "ms": 10, "mec": "black"},
    "body": {"ls": "", "color": _LOAD, "marker": "o", "ms": 9, "mec": "black"},
}  # fmt: skip
_MOST_NAMES = 6


def drawing_of(motion: Motion) -> tuple[Figure, Callable[[int], list[Any]]]:
    """Return a figure of the parts and of the path, and the function that moves the parts to an instant.

    Raises
    ------
    InvalidSetting
        If matplotlib is missing.
    """
    with refused_if_missing():
        from matplotlib import pyplot  # noqa: PLC0415
    shown = [0, 2] if motion.flat else [0, 1, 2]
    figure = pyplot.figure(figsize=(6.4, 4.8), layout=None)
    figure.subplots_adjust(bottom=0.18)
    axes: Any = figure.add_subplot(projection=None if motion.flat else "3d")
    _framed(axes, motion, shown)
    if motion.tracked is not None:
        axes.plot(*motion.places[:, motion.tracked, shown].T, color=_PATH, ls="--", lw=1.2, label="path")
    named = [part["name"] for part in motion.parts if part["name"]]
    lines = [
        axes.plot([], [], *([] if motion.flat else [[]]), **_KINDS[part["kind"]],
                  label=part["name"] if len(named) <= _MOST_NAMES and part["name"] else None)[0]
        for part in motion.parts
    ]  # fmt: skip
    if axes.get_legend_handles_labels()[1]:
        figure.legend(loc="lower center", ncols=4, frameon=False)

    def draw(k: int) -> list[Any]:
        for number, (part, line) in enumerate(zip(motion.parts, lines, strict=True)):
            coordinates = motion.line(part, k)[:, shown].T
            (line.set_data if motion.flat else line.set_data_3d)(*coordinates)
            if number in motion.colours:
                line.set_color(_shade(motion.colours[number], k))
        return lines

    return figure, draw


def animation_of(motion: Motion, title: str, speed: float, most: int) -> FuncAnimation:
    """Return an animation of at most `most` frames, each at an instant of the motion; raises as `drawing_of`."""
    figure, draw_parts = drawing_of(motion)
    from matplotlib import animation  # noqa: PLC0415

    class Shown(animation.FuncAnimation):
        """An animation that a notebook displays."""

        def _repr_html_(self) -> str:
            return str(self.to_jshtml())

    text = figure.suptitle("")
    instants = np.unique(np.searchsorted(motion.t, np.linspace(motion.t[0], motion.t[-1], min(most, len(motion.t)))))

    def draw(k: int) -> list[Any]:
        text.set_text(f"{title}, t = {motion.t[k]:.2f} s")
        return [*draw_parts(k), text]

    pause = 1e3 * (motion.t[-1] - motion.t[0]) / speed / max(len(instants) - 1, 1)
    return Shown(figure, draw, [int(instant) for instant in instants], interval=pause, blit=False)


def _shade(values: Array, k: int) -> tuple[float, float, float]:
    """Return a colour from blue, at the minimum of a quantity, to orange."""
    low, high = float(values.min()), float(values.max())
    share = 0.5 if high - low <= 1e-9 * abs(high) else (float(values[k]) - low) / (high - low)
    return share * 213 / 255, (114 - 20 * share) / 255, 178 * (1 - share) / 255


def _framed(axes: Any, motion: Motion, shown: Sequence[int]) -> None:
    """Set equal scales, limits around the whole motion, and labels with units."""
    low, high = motion.corners()
    # A motion along one line needs some height to be visible.
    wide = float((high - low).max())
    middle, half = (low + high) / 2, np.maximum(high - low, 0.3 * wide) / 2
    for name, axis in zip("xy" if motion.flat else "xyz", shown, strict=True):
        limits = (middle[axis] - half[axis], middle[axis] + half[axis])
        axes.set(**{f"{name}lim": limits, f"{name}label": f"{'xyz'[axis]} (m)"})
    if motion.flat:
        axes.set_aspect("equal")
        axes.grid(alpha=0.25)
    else:
        axes.set_box_aspect(2 * half, zoom=1.2)
        axes.view_init(elev=22, azim=-62)
