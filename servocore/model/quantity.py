"""`Quantity`: name and unit of a scalar."""

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
