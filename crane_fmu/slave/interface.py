"""A table of variables describes an FMU; slave, model description, user page and tests are generated from it.

The module travels into the FMUs and needs the standard library only. Value references are positions in the table;
`crane_fmu.catalogue.variables` writes the tables.
"""

from __future__ import annotations

import json
import math
import uuid
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Literal

Causality = Literal["input", "output", "parameter"]
Variability = Literal["continuous", "tunable", "fixed"]
Value = float | str

ORDERS = ("position", "velocity", "acceleration", "jerk", "snap")
"""Names of the load path's derivatives of order 0, 1, ..."""

DIMENSION = 3
"""Components of the load path."""

REST = (5.0, 0.0, -5.0)
"""Where the load hangs at rest when nothing is connected, in m."""

INPUT_TIMES = ("start", "end")
"""The instant of a communication step that its inputs may belong to; the first is the default."""

CRANE_PARAMETERS = ("bridge_inertia", "trolley_mass", "load_mass", "winch_inertia", "winch_radius", "gravity")
"""Parameters of the crane in the order in which a plant takes them."""

FEEDBACK_INPUTS = (
    *(f"measured.{name}" for name in ("phi", "s", "l", "phi_dot", "s_dot", "l_dot")),
    *(f"measured.{name}[{k}]" for name in ("position", "velocity") for k in (1, 2, 3)),
)
"""What the feedback has to be told of the crane."""

THREE_PHASE, FROM_FILE = "three-phase", "file"
"""Time laws of a trajectory that have parameters of their own."""


@dataclass(frozen=True)
class Variable:
    """One variable of an FMU.

    Attributes
    ----------
    name : str
        Structured name.
    causality, variability : str
        As in FMI 2.0.
    description : str
        One line for tool tips.
    reads : str
        Where the slave takes the value from, or what it hands it to: ``path derivative 2, component 1``,
        ``channel M_b``, ``parameter load_mass``, ``setting model``.
    unit, display_unit : str
        SI unit, and the unit that tools should show; empty for texts.
    start : float or str, optional
        None for what is calculated.
    minimum, maximum, nominal : float, optional
        As in FMI 2.0.
    choices : tuple of str
        Legal values of a text.
    """

    name: str
    causality: Causality
    variability: Variability
    description: str
    reads: str
    unit: str = ""
    display_unit: str = ""
    start: Value | None = None
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None
    choices: tuple[str, ...] = ()

    @property
    def is_text(self) -> bool:
        """True for a String, False for a Real."""
        return bool(self.choices)

    def complaint(self, value: Value) -> str | None:
        """Say in a sentence why `value` is not legal for this variable, or return None."""
        if self.is_text:
            legal = value in self.choices
            return None if legal else f"{self.name} = {value!r} is unknown; it may be {', '.join(self.choices)}"
        low, high = self.minimum, self.maximum
        number = float(value)
        if math.isfinite(number) and (low is None or number >= low) and (high is None or number <= high):
            return None
        bounds = f"[{'-inf' if low is None else f'{low:g}'}, {'inf' if high is None else f'{high:g}'}]"
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.name} = {number:g}{unit} is outside its range {bounds}{unit}"


@dataclass(frozen=True)
class Interface:
    """All variables of an FMU in the order of their value references."""

    variables: tuple[Variable, ...]

    def of(self, causality: Causality) -> tuple[Variable, ...]:
        """Return the variables of one causality."""
        return tuple(each for each in self.variables if each.causality == causality)

    def index(self, name: str) -> int:
        """Value reference of the variable called `name`; raises KeyError if there is none."""
        return self._places[name]

    @cached_property
    def _places(self) -> dict[str, int]:
        return {each.name: k for k, each in enumerate(self.variables)}

    def __getitem__(self, name: str) -> Variable:
        return self.variables[self.index(name)]

    @cached_property
    def guid(self) -> str:
        """Identifier that changes when, and only when, the table does."""
        return str(uuid.uuid5(uuid.NAMESPACE_OID, self.to_json()))

    def to_json(self) -> str:
        """Serialise; equal tables give equal text."""
        return json.dumps([asdict(each) for each in self.variables], indent=1, sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Interface:
        """Undo `to_json`."""
        rows = [{**row, "choices": tuple(row["choices"])} for row in json.loads(text)]
        return cls(tuple(Variable(**row) for row in rows))
