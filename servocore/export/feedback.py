"""`SampledFeedback`: a feedback on what is measured that an exported inverse model carries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from servocore.export.variables import INPUT_TIME
from servocore.model.quantity import Quantity
from servocore.numerics.machine_code import renamed


@dataclass(frozen=True, eq=False)
class SampledFeedback:
    """A law for sampled data: memory in, memory and inputs out; p are the parameters of the scene's model.

    Attributes
    ----------
    measured : tuple of (Quantity, int or None)
        What is measured, with the number of components of vectors.
    laws : mapping of str to casadi.Function
        For each input time T ``begin_T``, (path, measured, p, h) -> memory, and ``feedback_T``, (memory, path, path
        before, measured, acting, feedforward, p, h, share, limits) -> (memory, inputs).
    judge : casadi.Function
        (path before, measured, p, h) -> (whether what is measured makes sense, distance from the path, turn of the
        step).
    not_measured : str
        What to say where it makes none, behind the time; a format of the numbers that are shown.
    largest_turn : float
        Beyond this turn of a step there is the feedforward only.
    too_long : str
        How to begin to say how long a step may be: ``with this load it``.
    distance : float
        Start value of the distance from the path up to which there is feedback, in m.
    shown : tuple of int
        Places of measured numbers that `not_measured` tells, each as ``%g``.
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
        """How many numbers are measured."""
        return sum(size or 1 for _, size in self.measured)

    def functions(self, identifier: str) -> dict[str, ca.Function]:
        """Return all functions by name, called as in C.

        Parameters
        ----------
        identifier : str
            What names in C begin with.

        Returns
        -------
        dict of str to casadi.Function
            With dense arguments and results.
        """
        names = [f"{each}_{time}" for time, _ in INPUT_TIME.items for each in ("begin", "feedback")]
        functions_by_name = {**{name: self.laws[name] for name in names}, "judge": self.judge}
        return {name: renamed(each, f"{identifier}_{name}") for name, each in functions_by_name.items()}

    def own(self) -> dict[str, object]:
        """Return what the kernel needs to know.

        Returns
        -------
        dict of str to object
            Values for the templates of the sources.
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
