"""`SampledEstimates`: estimation of derivatives of the path that are not connected, for exported inverse models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from servocore.export.variables import Choice, order_name


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

    def own(self) -> dict[str, object]:
        """Return values for the templates of the sources.

        Returns
        -------
        dict of str to object
            The values by name.
        """
        memory = self.functions["estimate"].numel_in(0)
        return {"memory": memory, "unknown": self.unknown, "rough": self.rough}
