"""`Solution`: the result of a run, arrays by name with units."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

from servocore.errors import InvalidModel, InvalidSetting
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array, lock_arrays
from servocore.presentation import Curve, Motion, animation_of, data_frame, dataset, drawing_of, figure_of, html_table

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.animation import FuncAnimation
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Statistics:
    """Effort of a run and residuals of the equations.

    Attributes
    ----------
    steps, newton_iterations, factorizations : int
        Totals of the run; iterations are those of the slowest block of each step.
    worst_residual : float
        Largest residual of any equation, scaled by the step size to the level of accelerations.
    servo_violation, servo_rate_violation : float
        Largest ``|c|`` in the unit of the outputs, and largest ``|dc/dt|``.
    constraint_violation, constraint_rate_violation : float
        Largest ``|g|`` and ``|dg/dt|``.
    error_estimate : float or None
        With error control: its estimate of the largest error of the inputs, relative to their peaks.
    choices_of_states : int
        How often the states of internal dynamics were chosen, the first time included.
    branch : str
        Branch of the solution and its verification, with instants at which branches meet. Empty where it was not
        checked: with ``checks=False``, and from user-defined routes.
    """

    steps: int
    newton_iterations: int
    factorizations: int
    worst_residual: float
    servo_violation: float
    servo_rate_violation: float
    constraint_violation: float
    constraint_rate_violation: float
    error_estimate: float | None = None
    choices_of_states: int = 1
    branch: str = ""


_SMALLEST_PEAK = 1e-6  # of the largest input: a smaller one may be all round-off

NO_STATISTICS = Statistics(0, 0, 0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class ErrorEstimate(Mapping[str, "float | None"]):
    """Estimated errors of the inputs of a run: ``error["F"]`` is the largest error of F, in its unit.

    None stands for an unknown error. Errors of the path, such as those of a fit to samples, are not included.

    Attributes
    ----------
    absolute : mapping of str to float or None
        By name of the input.
    peaks : mapping of str to float
        Largest magnitude of every input.
    basis : str
        Reference of the comparison, or the reason why no error is known.
    """

    absolute: Mapping[str, float | None]
    peaks: Mapping[str, float]
    basis: str

    @property
    def relative(self) -> Mapping[str, float | None]:
        """Errors relative to the peaks; the peak of an input is at least a millionth of the largest."""
        least = max(_SMALLEST_PEAK * max(self.peaks.values(), default=0.0), 1e-300)
        return {k: None if e is None else e / max(self.peaks[k], least) for k, e in self.absolute.items()}

    @property
    def largest(self) -> float | None:
        """Largest known relative error; None if none is known."""
        return max((error for error in self.relative.values() if error is not None), default=None)

    def __getitem__(self, name: str) -> float | None:
        return self.absolute[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.absolute)

    def __len__(self) -> int:
        return len(self.absolute)


@dataclass(frozen=True)
class Margin:
    """Margin of a limit.

    Attributes
    ----------
    slack : float
        Smallest distance to the nearer bound, negative beyond it.
    time, value, bound : float
        Time of that distance, the quantity at that time, and that bound.
    unit : str
        Of all but the time.
    """

    slack: float
    time: float
    value: float
    bound: float
    unit: str


NOTHING_KNOWN = ErrorEstimate({}, {}, "these values were not compared with more accurate ones")


@dataclass(frozen=True, eq=False, repr=False)
class Solution:
    """Trajectories by name.

    ``solution["M_b"]`` is an array over ``solution.t``; ``solution.unit("M_b")`` its unit. Arrays are read-only:
    ``solution["M_b"].copy()`` can be written into.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times in s.
    channels : tuple of Quantity
        Names and units of the columns of `values`.
    values : ndarray, shape (N, number of channels)
        One row a time.
    statistics : Statistics
        `NO_STATISTICS` for results that no run of this library produced.
    route : str
        Model, formulation and method that produced it.
    fit_error : float or None
        The reference's own estimate of its distance from the sampled positions it was fitted to, in m.
    advice : str
        Recommendation of the analysis that chose the formulation; empty when the caller chose.
    estimator : callable or None
        Function from the solution to `error`; omitted when the solution is pickled.
    fit_estimator : callable or None
        Function from the solution to `fit_effect`; omitted when the solution is pickled.
    margins : mapping of str to Margin
        Margins of the limits of the scene (not of the path) by name, at the instants of the solution.
    origin : Problem or None
        The solved problem, for drawings and further computations; omitted when the solution is pickled.
    motion : Motion or None
        The exact motion that checks read, known between routes and checks only.
    """

    t: Array
    channels: tuple[Quantity, ...]
    values: Array
    route: str
    statistics: Statistics = NO_STATISTICS
    fit_error: float | None = None
    advice: str = ""
    estimator: Callable[[Solution], ErrorEstimate] | None = field(default=None, repr=False)
    fit_estimator: Callable[[Solution], ErrorEstimate | None] | None = field(default=None, repr=False)
    margins: Mapping[str, Margin] = field(default_factory=dict)
    origin: Any = field(default=None, repr=False)  # a `Problem`, of a higher layer
    motion: Any = field(default=None, repr=False)  # a `Motion`, of a higher layer

    def __post_init__(self) -> None:
        lock_arrays(self, "t", "values")  # `error` and others are computed from them

    @cached_property  # it may take longer than the solution
    def error(self) -> ErrorEstimate:
        """Numerical error of the inputs on the path as it is, computed at the first access.

        Errors of the path (see `fit_effect`), of data and of the model are not in it.
        """
        return NOTHING_KNOWN if self.estimator is None else self.estimator(self)

    @cached_property
    def fit_effect(self) -> ErrorEstimate | None:
        """About how far the inputs are off because the path was fitted to samples, which are rounded or noisy.

        By how much they change when the path is fitted to every second sample. None of a path that is no such fit.
        """
        return None if self.fit_estimator is None else self.fit_estimator(self)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "estimator": None, "fit_estimator": None, "origin": None, "motion": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        lock_arrays(self, "t", "values")

    @cached_property  # every column is found by it
    def names(self) -> tuple[str, ...]:
        """Names of all trajectories."""
        return tuple(channel.name for channel in self.channels)

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def __getitem__(self, name: str) -> Array:
        column: Array = self.values[:, self._index(name)]
        return column

    def unit(self, name: str) -> str:
        """Return the unit of a trajectory; raises KeyError if there is none of that name.

        Parameters
        ----------
        name : str
            Of an input, an observable, an output or a coordinate.

        Returns
        -------
        str
            Such as ``N.m``.
        """
        return self.channels[self._index(name)].unit

    def _index(self, name: str) -> int:
        if name not in self.names:
            raise KeyError(f"{name}; there are {', '.join(self.names)}")
        return self.names.index(name)

    def __repr__(self) -> str:
        return f"<Solution of {self._heading}: {', '.join(self.names)}>"

    def _repr_html_(self) -> str:
        branch = self.statistics.branch
        return html_table(self.t, self._curves(None), (f"Solution of {self._heading}", self.advice, branch))

    @property
    def _heading(self) -> str:
        return f"{self.route}, {len(self.t)} instants from {self.t[0]:g} s to {self.t[-1]:g} s"

    def _curves(self, names: Sequence[str] | None) -> list[Curve]:
        chosen = [self._index(name) for name in (self.names if names is None else names)]
        return [Curve(c.name, c.unit, c.description, self.values[:, k]) for k in chosen for c in [self.channels[k]]]

    def plot(self, names: Sequence[str] | None = None) -> Figure:
        """Plot trajectories over time, a panel each, angles in degrees.

        Parameters
        ----------
        names : sequence of str, optional
            Which; all of them when not given.

        Returns
        -------
        matplotlib.figure.Figure
            Made by pyplot, so that ``matplotlib.pyplot.show()`` shows it.

        Raises
        ------
        KeyError, InvalidSetting
            If there is no trajectory of a name; if matplotlib is missing, which is part of the extra ``report``.
        """
        return figure_of(self.t, self._curves(names), self.route)

    def animate(self, *, speed: float = 1.0, frames: int = 200) -> FuncAnimation:
        """Return an animation of the system in space, drawn as by `view`, at instants of the solution.

        Parameters
        ----------
        speed : float
            Ratio of the playback speed to real time.
        frames : int
            Largest number of frames.

        Returns
        -------
        matplotlib.animation.FuncAnimation
            A notebook displays it; ``animation.save("crane.gif", writer="pillow")`` writes it.

        Raises
        ------
        InvalidSetting
            If the solution lacks its problem, as from a file or a user-defined route, a number is not positive, or
            matplotlib is missing; it is part of the extra ``report``.
        InvalidModel
            If the drawing of the scene cannot be drawn, or there is nothing to draw.
        """
        for value, kind, what in ((speed, Real, "a positive speed"), (frames, Integral, "a whole number of frames")):
            if not isinstance(value, kind) or not value > 0:
                raise InvalidSetting(f"an animation needs {what}, not {value!r}")
        return animation_of(self._motion(), self.origin.name.replace("_", " "), speed, frames)

    def draw(self, time: float) -> Figure:
        """Draw the system in space at the instant that is next to a time, as `animate` does.

        Parameters
        ----------
        time : float
            In s.

        Returns
        -------
        matplotlib.figure.Figure
            Made by pyplot.

        Raises
        ------
        InvalidSetting, InvalidModel
            As `animate`.
        """
        figure, draw = drawing_of(self._motion())
        draw(min(range(len(self.t)), key=lambda k: abs(float(self.t[k]) - time)))
        return figure

    def _motion(self) -> Motion:
        if self.origin is None:
            raise InvalidSetting("this solution lacks its problem, as from a file, so that it cannot be drawn")
        import casadi as ca  # noqa: PLC0415 - for animations only

        from servocore.model.drawing import picture_of  # noqa: PLC0415
        from servocore.numerics.components import filled  # noqa: PLC0415

        system = self.origin.system
        picture = picture_of(system, self.channels, self.origin.drawing)
        if not picture.points:
            raise InvalidModel(f"{system.name}: nothing of it can be drawn")
        places = ca.Function("sc_places", [picture.reported, system.p], [picture.coordinates])
        points = filled(places(self.values.T, self.origin.p)).T.reshape(len(self.t), picture.points, 3)
        colours = {k: self.values[:, e["colour"]] for k, e in enumerate(picture.parts) if e["colour"] is not None}
        return Motion(self.t, points, picture.parts, colours, picture.tracked, picture.flat)

    def to_pandas(self, names: Sequence[str] | None = None) -> Any:
        """Return trajectories as a pandas DataFrame over the time in s; units are in ``attrs["units"]``.

        Parameters
        ----------
        names : sequence of str, optional
            Which; all of them when not given.

        Returns
        -------
        pandas.DataFrame
            One row an instant.

        Raises
        ------
        KeyError, InvalidSetting
            If there is no trajectory of a name; if pandas is missing, which is part of the extra ``sweep``.
        """
        return data_frame(self.t, self._curves(names), {"route": self.route})

    def to_xarray(self, names: Sequence[str] | None = None) -> Any:
        """Return trajectories as an xarray Dataset over ``time``, units as attributes.

        Parameters
        ----------
        names : sequence of str, optional
            Which; all of them when not given.

        Returns
        -------
        xarray.Dataset
            One variable a trajectory, with ``units`` and ``long_name``.

        Raises
        ------
        KeyError, InvalidSetting
            If there is no trajectory of a name; if xarray is missing, which is part of the extra ``sweep``.
        """
        return dataset(self.t, self._curves(names), {"route": self.route})

    def to_csv(self, path: str | Path, names: Sequence[str] | None = None) -> None:
        """Write time and trajectories as CSV in full double precision; all of them unless `names` are given.

        Parameters
        ----------
        path : str or Path
            The file.
        names : sequence of str, optional
            Trajectories to write.
        """
        from pathlib import Path  # noqa: PLC0415 - with what it imports, it would take longer than all other modules

        from servocore.files import csv_text, write_together  # noqa: PLC0415

        names = self.names if names is None else names
        write_together({Path(path): csv_text(["time", *names], [self.t, *[self[name] for name in names]])})
