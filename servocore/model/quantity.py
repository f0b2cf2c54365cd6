"""`Quantity`: name and unit of a scalar. This module travels with `servocore.stepping.program`."""

from __future__ import annotations

from dataclasses import dataclass


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
        is looked at. For a coordinate without one it is derived from the path.
    wraps : bool
        True for an angle computed by atan2: a trajectory of it is made continuous.
    positive : bool
        True for what the equations hold only the square of: a negative value belongs to another branch, on which a
        step that is too large may land.
    """

    name: str
    unit: str = "1"
    description: str = ""
    nominal: float | None = None
    wraps: bool = False
    positive: bool = False

    @property
    def magnitude(self) -> float:
        """The nominal value, or one unit if there is none."""
        return 1.0 if self.nominal is None else self.nominal
