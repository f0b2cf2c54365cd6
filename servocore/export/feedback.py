"""`SampledFeedback`: a feedback of measured values, for exported inverse models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from servocore.model.quantity import Quantity


@dataclass(frozen=True, eq=False)
class SampledFeedback:
    """A sampled-data law, with its memory as argument and result; p are the parameters of the scene's model.

    Attributes
    ----------
    measured : tuple of (Quantity, int or None)
        Measured quantities, with the number of components of vectors.
    laws : mapping of str to casadi.Function
        For each input time T ``begin_T``, (path, measured, p, h) -> memory, and ``feedback_T``, (memory, path, path
        before, measured, acting, feedforward, p, h, share, limits) -> (memory, inputs).
    judge : casadi.Function
        (path before, measured, p, h) -> (whether the measured values are possible, distance from the path, turn in
        the step).
    not_measured : str
        The refusal of impossible values, after the time; a format of the numbers in `shown`.
    largest_turn : float
        Largest turn in a step with feedback.
    too_long : str
        Beginning of the sentence on the longest possible step: ``with this load it``.
    distance : float
        Start value of the distance from the path up to which there is feedback, in m.
    shown : tuple of int
        Places of measured numbers in `not_measured`, each as ``%g``.
    """

    measured: tuple[tuple[Quantity, int | None], ...]
    laws: Mapping[str, ca.Function]
    judge: ca.Function
    not_measured: str
    largest_turn: float
    too_long: str
    distance: float
    shown: tuple[int, ...] = ()

    @property
    def numbers(self) -> int:
        """The number of measured values."""
        return sum(size or 1 for _, size in self.measured)

    def own(self) -> dict[str, object]:
        """Return values for the templates of the sources.

        Returns
        -------
        dict of str to object
            The values by name.
        """
        law = self.laws["feedback_start"]
        return {
            "measured": self.numbers,
            "memory": law.numel_in(0),
            "drives": law.numel_out(1),
            "largest_turn": self.largest_turn,
            "too_long": self.too_long,
            "not_measured": self.not_measured,
            "shown": self.shown,
        }
