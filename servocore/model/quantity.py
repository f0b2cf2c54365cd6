"""`Quantity`: name and unit of a scalar."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from servocore.numerics.compiled_calls import Array


@dataclass(frozen=True)
class Quantity:
    """A named scalar of a model: a coordinate, an input, an output or something observed.

    Parameters
    ----------
    name : str
        Identifier, unique within its model.
    unit : str
        SI unit as FMI spells it: ``m``, ``rad``, ``N.m``, ``m/s2``.
    description : str
        One line for tables and tool tips.
    nominal : float, optional
        Typical magnitude of its changes in `unit`: scales Newton's stopping test and the points at which a structure
        is analysed. For a coordinate without one it is derived from the path.
    wraps : bool
        True for an angle computed by atan2: a trajectory of it is made continuous.
    positive : bool
        True if the equations contain its square only: a negative value belongs to another branch, to which a step that
        is too large may converge.
    nonnegative : bool
        True if it is never negative by definition, as the angle from a direction: a limit of one number is then an
        upper bound. This is not checked.
    tension : bool
        True for the force in a rope, which cannot push; implies `positive`.
    """

    name: str
    unit: str = "1"
    description: str = ""
    nominal: float | None = None
    wraps: bool = False
    positive: bool = False
    nonnegative: bool = False
    tension: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "positive", self.positive or self.tension)

    @property
    def magnitude(self) -> float:
        """The nominal value, or one unit if there is none."""
        return 1.0 if self.nominal is None else self.nominal

    @property
    def never_negative(self) -> bool:
        """Whether negative values are excluded by declaration."""
        return self.positive or self.nonnegative

    @property
    def wrong_sign(self) -> str:
        """Explanation of a value that is not positive, as the end of a sentence."""
        if self.tension:
            return "it must stay positive: a rope cannot push"
        return "on another branch of the equations than the one wanted"


@dataclass(frozen=True)
class RunQuantity:
    """A quantity of a whole run: the integral of a reported quantity from the start on, or the root of its mean square.

    Parameters
    ----------
    quantity : Quantity
        Name and unit.
    of : str
        Name of the reported quantity.
    rms : bool
        Whether it is the root of the mean square.
    """

    quantity: Quantity
    of: str
    rms: bool

    def integrand(self, value: Any) -> Any:
        """Return the integrand, from the reported quantity."""
        return value**2 if self.rms else value

    def of_sum(self, total: Any, duration: Any) -> Any:
        """Return it from the integral of the quantity, or of its square, over a duration in s."""
        return np.sqrt(np.maximum(total, 0.0) / duration) if self.rms else total

    def course(self, t: Array, values: Array) -> Array:
        """Return it at every instant (N,) since the first, by Simpson's rule from values of the reported quantity."""
        from scipy.integrate import cumulative_simpson  # noqa: PLC0415 - few runs integrate what they report

        found = np.asarray(cumulative_simpson(self.integrand(values), x=t, initial=0.0), dtype=np.float64)
        found[1:] = self.of_sum(found[1:], t[1:] - t[0])
        found[0] = abs(values[0]) if self.rms else 0.0
        return found


def run_quantities(quantities: Iterable[Quantity]) -> tuple[RunQuantity, ...]:
    """Return the energy ``NAME.energy`` (J) of every power and ``NAME.rms_torque`` of every torque of a motor."""
    found = []
    for each in quantities:
        name, _, kind = each.name.rpartition(".")
        if (kind, each.unit) == ("power", "W"):
            energy = Quantity(f"{name}.energy", "J", f"integral of {each.name} over the time")
            found.append(RunQuantity(energy, each.name, rms=False))
        elif (kind, each.unit) == ("motor_torque", "N.m"):
            text = f"root of the mean square of {each.name} since the start"
            torque = Quantity(f"{name}.rms_torque", "N.m", text, nonnegative=True)
            found.append(RunQuantity(torque, each.name, rms=True))
    return tuple(found)
