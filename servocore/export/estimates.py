"""`SampledEstimates`: what an exported inverse model estimates of its path where derivatives are not connected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from servocore.export.variables import Choice, order_name
from servocore.numerics.machine_code import renamed

_NAMES = ("first_samples", "estimate", "worth")


@dataclass(frozen=True, eq=False)
class SampledEstimates:
    """An estimation from samples, memory in and memory out; p are the parameters of the scene's model.

    Attributes
    ----------
    functions : mapping of str to casadi.Function
        ``first_samples``, (path as it is told, k) -> memory, where k is the highest derivative that is connected;
        ``estimate``, (memory, path, step, 1 if it is told for the end of the step, k) -> (memory, path with what is
        estimated, error, 0 while there are too few samples); and ``worth``, (error, path, outputs, p, peak so far) ->
        (peak, what the error is worth, from where on that is told).
    unknown : tuple of str
        What to say while there are too few samples, for each k.
    rough : tuple of str
        What to say of an error that is told, for each k: a format of the error, what it is worth, and the peak.
    start : int
        The highest derivative that is connected at first.
    """

    functions: Mapping[str, ca.Function]
    unknown: tuple[str, ...]
    rough: tuple[str, ...]
    start: int

    @property
    def choice(self) -> Choice:
        """Which derivatives are connected; the first item is all of them."""
        names = [order_name(order) for order in range(len(self.unknown) + 1)]
        items = tuple((name, f"the {name} and what is below it") for name in reversed(names))
        text = "highest derivative of the path that is connected; others are estimated"
        return Choice("connected", text, items, len(names) - self.start)

    def renamed(self, identifier: str) -> dict[str, ca.Function]:
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
        return {name: renamed(self.functions[name], f"{identifier}_{name}") for name in _NAMES}

    def own(self) -> dict[str, object]:
        """Return what the kernel needs to know.

        Returns
        -------
        dict of str to object
            By name, for the templates of the sources.
        """
        memory = self.functions["estimate"].numel_in(0)
        return {"memory": memory, "unknown": self.unknown, "rough": self.rough}
