"""`SampledFeedback` of measured values, and `SampledEstimates` of derivatives, for exported inverse models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from servocore.export.variables import Choice, order_name
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

    @property
    def memory(self) -> int:
        """The size of the memory."""
        return self.laws["feedback_start"].numel_in(0)

    @property
    def drives(self) -> int:
        """The number of corrected inputs."""
        return self.laws["feedback_start"].numel_out(1)


@dataclass(frozen=True, eq=False)
class SampledEstimates:
    """An estimator from samples, with its memory as argument and result; p are the parameters of the scene's model.

    Attributes
    ----------
    functions : mapping of str to casadi.Function
        ``first_samples``, (input path, k) -> memory, where k is the order of the highest connected derivative;
        ``estimate``, (memory, input path, step, 1 if the path is that at the end of the step, k) -> (memory, path with
        estimated derivatives, error, 0 while there are too few samples); and ``worth``, (error, path, outputs, p, peak
        so far) -> (peak, error of an output, threshold of the warning).
    unknown : tuple of str
        The warning of too few samples, for each k.
    rough : tuple of str
        The warning of a large error, for each k: a format of the error, the error of the output, and its peak.
    start : int
        The start value of k.
    """

    functions: Mapping[str, ca.Function]
    unknown: tuple[str, ...]
    rough: tuple[str, ...]
    start: int

    @property
    def choice(self) -> Choice:
        """The choice of the highest connected derivative; the first item is the highest of all."""
        names = [order_name(order) for order in range(len(self.unknown) + 1)]
        items = tuple((name, f"the {name} and all below it") for name in reversed(names))
        text = "highest derivative of the path that is connected; others are estimated"
        return Choice("connected", text, items, len(names) - self.start)

    @property
    def memory(self) -> int:
        """The size of the memory."""
        return self.functions["estimate"].numel_in(0)
