"""`NativeModel`: what becomes an FMU, as one value: variables, choices, mathematics, and the C that steps it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.export.c_functions import c_source
from servocore.export.variables import Causality, Choice, Variable
from servocore.model.quantity import Quantity


@dataclass(frozen=True)
class Bound:
    """What a limit sets to a quantity, and where the quantity stands.

    Attributes
    ----------
    quantity, unit, reason : str
        As of `Limit`; the reason may be empty.
    bound : float
        The number.
    side : float
        1 if the quantity must stay above it, -1 if below.
    row : int
        Which of the limits on what moves it belongs to; -1 for limits of the path.
    rate : bool
        Whether it is the rate of something, which is none where that has no direction.
    """

    quantity: str
    unit: str
    reason: str
    bound: float
    side: float
    row: int
    rate: bool = False

    @property
    def text(self) -> str:
        """The bound as a sentence without its end."""
        why = f"{self.reason}: " if self.reason else ""
        which = "above" if self.side > 0.0 else "below"
        return f"{why}{self.quantity} must stay {which} {self.bound:g} {self.unit}"


@dataclass(frozen=True, eq=False, kw_only=True)
class NativeModel:
    """What is exported, ready to be written down as an FMU.

    Attributes
    ----------
    identifier : str
        The name as an identifier of C.
    title, model : str
        Names of what it is and of the scene's model.
    description : str
        One line.
    kernel : str
        Name of the file in C that steps it.
    own : mapping of str to anything
        What that file needs in model.h beside what all need: values for the template ``KERNEL_own.h.j2``.
    functions : mapping of str to casadi.Function
        The mathematics; their names in C begin with the identifier.
    variables : tuple of Variable
        Inputs, outputs, parameters and internal states, in the order of their numbers.
    choices : tuple of Choice
        Parameters that are one of some names.
    outputs : tuple of Quantity
        What is computed, in the order of the outputs' numbers.
    limits : tuple of Bound
        Where it ends.
    depends : ndarray of bool, shape (outputs, numbers of the inputs)
        Which outputs depend on which numbers of the inputs.
    timed : bool
        Whether what it computes holds the time.
    start_time, duration : float
        Of a default experiment, in s.
    differentiable : bool
        Whether there are derivatives of its outputs.
    terminals : mapping of str to (str, str)
        Causality and description of the terminals.
    elsewhere : tuple of casadi.Function
        What is called beside `functions`.
    more_sources : mapping of str to str
        C that is compiled beside the mathematics, with its headers, by file name.
    deferred_refusals : bool
        Whether the host's setters cannot fail: values are judged when they are used.
    """

    identifier: str
    title: str
    model: str
    description: str
    kernel: str
    own: Mapping[str, Any]
    functions: Mapping[str, ca.Function]
    variables: tuple[Variable, ...]
    choices: tuple[Choice, ...]
    outputs: tuple[Quantity, ...]
    limits: tuple[Bound, ...]
    depends: npt.NDArray[np.bool_]
    timed: bool
    start_time: float
    duration: float
    differentiable: bool
    terminals: Mapping[str, tuple[str, str]]
    elsewhere: tuple[ca.Function, ...] = ()
    more_sources: Mapping[str, str] = field(default_factory=dict)
    deferred_refusals: bool = False

    @property
    def settings(self) -> tuple[Variable, ...]:
        """Parameters that are not the model's."""
        return tuple(variable for variable in self.of("parameter") if variable.setting)

    @property
    def measured(self) -> int:
        """How many inputs, the last ones, are what a feedback measures."""
        feedback = self.own.get("feedback")
        return int(feedback["measured"]) if feedback else 0

    def of(self, causality: Causality) -> tuple[Variable, ...]:
        """Return the variables of one causality."""
        return tuple(variable for variable in self.variables if variable.causality == causality)

    def numbers(self, causality: Causality) -> int:
        """Return how many numbers the variables of one causality have."""
        return sum(variable.size or 1 for variable in self.of(causality))

    def source(self) -> tuple[str, str]:
        """Return header and C source ``IDENTIFIER_mathematics``; all names in them begin with the identifier."""
        return c_source(f"{self.identifier}_mathematics", self.functions.values())

    def token(self, *more: str) -> str:
        """Return an identifier that changes when, and only when, variables, mathematics or `more` do."""
        digest = hashlib.sha256(repr((self.variables, self.choices, self.deferred_refusals)).encode())
        for text in (*self.source(), *self.more_sources.values(), repr(self.own), repr(self.limits), *more):
            digest.update(text.encode())
        code = digest.hexdigest()
        return f"{{{code[:8]}-{code[8:12]}-{code[12:16]}-{code[16:20]}-{code[20:32]}}}"
