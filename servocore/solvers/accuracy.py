"""How accurate a run shall be: a step, or a tolerance."""

from __future__ import annotations

from dataclasses import dataclass

from servocore.errors import InvalidSetting


@dataclass(frozen=True)
class Fixed:
    """A constant step of `h` seconds; a 200th of the duration when None."""

    h: float | None = None


@dataclass(frozen=True)
class Adaptive:
    """The accuracy wanted of every reported trajectory; the only knob.

    An error e of a trajectory with peak P is accepted when e <= atol + rtol P. Newton's method always goes down to
    round-off, so it needs no tolerance of its own.

    Parameters
    ----------
    rtol : float
        Relative to the peak of each trajectory over the run.
    atol : float
        In the trajectory's own unit.
    most_steps : int
        A run that needs more is given up.
    """

    rtol: float = 1e-6
    atol: float = 0.0
    most_steps: int = 1_000_000

    def __post_init__(self) -> None:
        if not (0.0 <= self.rtol < 1.0 and 0.0 <= self.atol < float("inf") and self.rtol + self.atol > 0.0):
            raise InvalidSetting(
                f"tolerances must be finite and not negative, one of them positive, and rtol below 1;"
                f" they are rtol = {self.rtol}, atol = {self.atol}"
            )
