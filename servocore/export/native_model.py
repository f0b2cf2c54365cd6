"""`NativeModel`: the content of an FMU, as one value: variables, choices, mathematics, and its kernel in C."""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidModel, InvalidSetting
from servocore.export.about import About
from servocore.export.c_functions import c_source
from servocore.export.variables import INTERNAL_STEP, Causality, Choice, Variable, listed, of_quantity, placed
from servocore.model.limits import run_quantities
from servocore.model.quantity import Quantity

_LONGEST_IDENTIFIER = 40
_NAMES_TAKEN = ("main", "all", "clean", "help", "install", "package", "test")  # files, and CMake's own targets
_NAME = re.compile(r"[a-zA-Z_]\w*(\.\w+)*(\[\d+\])?", re.ASCII)  # of a variable


def identifier_of(name: str) -> str:
    """Return a name as an identifier of C, at most 40 characters long."""
    # CasADi does not accept two consecutive underscores.
    identifier = re.sub(r"[\W_]+", "_", name, flags=re.ASCII)[:_LONGEST_IDENTIFIER].strip("_")
    if not identifier:
        return "model"
    taken = not identifier[0].isalpha() or keyword.iskeyword(identifier) or identifier.lower() in _NAMES_TAKEN
    return f"model_{identifier}" if taken else identifier


@dataclass(frozen=True)
class Bound:
    """One side of a limit, and the place of its quantity.

    Attributes
    ----------
    quantity, unit, reason : str
        As of `Limit`; the reason may be empty.
    bound : float
        The number.
    side : float
        1 if the quantity must stay above it, -1 if below.
    row : int
        Number of the limit of the motion that it belongs to; -1 for limits of the path. Of a run: of the output.
    rate : bool
        Whether it is the rate of a quantity, which is NaN where that has no direction.
    """

    quantity: str
    unit: str
    reason: str
    bound: float
    side: float = 1.0
    row: int = -1
    rate: bool = False

    @property
    def text(self) -> str:
        """The bound as a sentence without its end."""
        why = f"{self.reason}: " if self.reason else ""
        which = "above" if self.side > 0.0 else "below"
        return f"{why}{self.quantity} must stay {which} {self.bound:g} {self.unit}"


@dataclass(frozen=True)
class HostRules:
    """Rules of the hosts of an FMU.

    Attributes
    ----------
    deferred_refusals : bool
        Whether values are checked when they are used, since the host's setters cannot fail: a slave of PythonFMU.
    stdio : bool
        Whether the C library has ``<stdio.h>``; without it messages have a question mark in the place of each number.
    internal_steps : int
        Largest number of steps of a method in a communication step; one with more is refused.

    Raises
    ------
    InvalidSetting
        If the number is not positive.
    """

    deferred_refusals: bool = False
    stdio: bool = True
    internal_steps: int = 100_000

    def __post_init__(self) -> None:
        """Refuse an impossible number."""
        if self.internal_steps < 1:
            raise InvalidSetting(f"there must be at least 1 internal step, not {self.internal_steps}")


@dataclass(frozen=True, eq=False, kw_only=True)
class NativeModel:
    """An exported model, ready to be written as an FMU.

    Attributes
    ----------
    identifier : str
        The name as an identifier of C.
    title, model : str
        Names of the FMU and of the scene's model.
    description : str
        One line.
    kernel : str
        Name of the file in C that steps it.
    own : mapping of str to anything
        Values for the template ``KERNEL_own.h.j2``, the part of model.h for that file.
    functions : mapping of str to casadi.Function
        The mathematics; their names in C begin with the identifier.
    variables : tuple of Variable
        Inputs, outputs, parameters and internal states, in the order of their numbers.
    choices : tuple of Choice
        Parameters with a list of named items.
    outputs : tuple of Quantity
        Computed quantities, in the order of the outputs' numbers.
    added_up : tuple of (int, bool)
        Of each of the last outputs: the output of which it is the integral over the run, or, where marked, the root of
        the mean square.
    limits : tuple of Bound
        Bounds of its validity.
    run_limits : tuple of Bound
        Bounds of outputs that are added up, at the end of a run.
    depends : ndarray of bool, shape (outputs, numbers of the inputs)
        Which outputs depend on which numbers of the inputs.
    timed : bool
        Whether its equations contain the time.
    start_time, duration : float
        Of a default experiment, in s.
    differentiable : bool
        Whether it provides derivatives of its outputs.
    elsewhere : tuple of casadi.Function
        Functions that are called besides `functions`.
    more_sources : mapping of str to str
        Further C sources to compile, with their headers, by file name.
    host : HostRules
        Rules of its hosts.
    about : About
        Origin and rights.
    cross_check : mapping of str to str
        Files of a run by their names.

    Raises
    ------
    InvalidModel
        If two variables have one name, or a name is not valid in FMI.
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
    depends: npt.NDArray[np.bool_]
    duration: float
    start_time: float = 0.0
    timed: bool = False
    differentiable: bool = False
    limits: tuple[Bound, ...] = ()
    run_limits: tuple[Bound, ...] = ()
    added_up: tuple[tuple[int, bool], ...] = ()
    elsewhere: tuple[ca.Function, ...] = ()
    more_sources: Mapping[str, str] = field(default_factory=dict)
    host: HostRules = HostRules()
    about: About = field(default_factory=About)
    cross_check: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse variables of one name, and names that FMI does not have."""
        names = [each.name for each in listed(self.variables, 2)]
        taken = {INTERNAL_STEP} - {each.name for each in self.settings}
        every = [*names, *(each.name for each in self.choices), "time", *taken]
        if repeated := sorted({name for name in every if every.count(name) > 1}):
            raise InvalidModel(f"{self.title} cannot be exported: variables named twice: {', '.join(repeated)}")
        for name in names:
            if not _NAME.fullmatch(name):
                raise InvalidModel(
                    f"{self.title} cannot be exported: FMI has no variable called {name!r}; names are the letters a to"
                    f" z and A to Z, digits and underscores"
                )

    @property
    def settings(self) -> tuple[Variable, ...]:
        """Parameters of the FMU besides those of the model."""
        return tuple(variable for variable in self.of("parameter") if variable.role)

    def of(self, causality: Causality) -> tuple[Variable, ...]:
        """Return the variables of one causality."""
        return tuple(variable for variable in self.variables if variable.causality == causality)

    def numbers(self, causality: Causality) -> int:
        """Return the number of scalars in the variables of one causality."""
        return sum(variable.size or 1 for variable in self.of(causality))

    def with_starts(self, start: Mapping[str, float | str]) -> Self:
        """Return the model with start values of inputs and parameters by the names of FMI 2, and items of choices.

        Raises
        ------
        InvalidSetting
            If there is no such variable or item, or a number is not finite or outside its range.
        """
        left = dict(start)
        variables = tuple(_with_starts(each, left) for each in self.variables)
        choices = tuple(_with_item(each, left) for each in self.choices)
        if left:
            numbers = [scalar.name for each in self.variables if each.starts for scalar in each.scalars]
            known = ", ".join((*numbers, *(each.name for each in self.choices)))
            raise InvalidSetting(
                f"{self.title} has no input or parameter {next(iter(left))!r} to start with; there are {known}"
            )
        return replace(self, variables=variables, choices=choices)

    def with_run_quantities(self) -> Self:
        """Return the model with energies and effective torques of its motors as further outputs, if it has any."""
        found, names = run_quantities(self.outputs), [each.name for each in self.outputs]
        of, known = [names.index(each.of) for each in found], [*names, *(each.name for each in found)]
        return replace(
            self,
            outputs=(*self.outputs, *found),
            variables=placed([*self.variables, *(of_quantity(each, "output") for each in found)]),
            depends=np.vstack([self.depends, self.depends[of]]),
            run_limits=tuple(replace(each, row=known.index(each.quantity)) for each in self.run_limits),
            added_up=tuple(zip(of, (each.rms for each in found), strict=True)),
        )

    @cached_property
    def source(self) -> tuple[str, str]:
        """Header and C source ``IDENTIFIER_mathematics``; all names in them begin with the identifier."""
        return c_source(f"{self.identifier}_mathematics", self.functions.values())


def _with_item(choice: Choice, left: dict[str, float | str]) -> Choice:
    """Return a choice with the default item of its name, if there is one, and remove it from those that are left."""
    names = [name for name, _ in choice.items]
    if (item := left.pop(choice.name, names[choice.start - 1])) not in names:
        raise InvalidSetting(f"{choice.name} = {item!r} is unknown; it may be {', '.join(names)}")
    return replace(choice, start=names.index(str(item)) + 1)


def _with_starts(variable: Variable, left: dict[str, float | str]) -> Variable:
    """Return a variable with the start values of its names, and remove them from those that are left."""
    starts, unit = list(variable.starts), variable.unit_behind
    for k, name in enumerate(scalar.name for scalar in variable.scalars if starts):
        value = left.pop(name, starts[k])
        if isinstance(value, str) or not math.isfinite(value):
            raise InvalidSetting(f"{name} = {value!r}{unit} is not a finite number")
        if not variable.low <= value <= variable.high:
            bounds = f"[{variable.low:g}, {variable.high:g}]{unit}"
            raise InvalidSetting(f"{name} = {value:g}{unit} is outside its range {bounds}")
        starts[k] = float(value)
    return replace(variable, starts=tuple(starts))
