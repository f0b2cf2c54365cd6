"""The one table of the FMU's variables; slave, model description, user page and tests are generated from it.

The module travels into the FMU and needs the standard library only. Value references are positions in the table.
"""

from __future__ import annotations

import json
import math
import uuid
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Literal, Protocol

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


@dataclass(frozen=True)
class Variable:
    """One variable of the FMU.

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
        return f"{self.name} = {number:g} {self.unit} is outside its range {bounds} {self.unit}"


class ParameterLike(Protocol):
    """What the table needs to know of a model's parameter; `servocore.Parameter` is one."""

    @property
    def name(self) -> str:
        """Identifier."""

    @property
    def default(self) -> float:
        """Value unless set."""

    @property
    def unit(self) -> str:
        """SI unit."""

    @property
    def lower(self) -> float:
        """Smallest legal value."""

    @property
    def upper(self) -> float:
        """Largest legal value."""

    @property
    def description(self) -> str:
        """One line."""


@dataclass(frozen=True)
class Interface:
    """All variables of the FMU in the order of their value references: inputs, outputs, parameters."""

    variables: tuple[Variable, ...]

    def of(self, causality: Causality) -> tuple[Variable, ...]:
        """Return the variables of one causality."""
        return tuple(each for each in self.variables if each.causality == causality)

    def index(self, name: str) -> int:
        """Value reference of the variable called `name`; raises KeyError if there is none."""
        for k, each in enumerate(self.variables):
            if each.name == name:
                return k
        raise KeyError(name)

    def __getitem__(self, name: str) -> Variable:
        return self.variables[self.index(name)]

    @property
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


_INPUT_UNITS = ("m", "m/s", "m/s2", "m/s3", "m/s4")

# Exact only while they are constant: a change of these moves the trolley or the rope at once.
_FIXED_PARAMETERS = frozenset({"gravity", "winch_radius"})


def crane_interface(
    parameters: Iterable[ParameterLike], models: Sequence[str], formulations: Sequence[str]
) -> Interface:
    """Return the table for the crane's parameters and the models and formulations that an FMU carries."""
    return Interface((*_inputs(), *_outputs(), *_parameters(parameters), *_settings(models, formulations)))


def _inputs() -> Iterable[Variable]:
    for order, (quantity, unit) in enumerate(zip(ORDERS, _INPUT_UNITS, strict=True)):
        for k in range(DIMENSION):
            yield Variable(
                name=f"load.{quantity}[{k + 1}]",
                causality="input",
                variability="continuous",
                description=f"{quantity} wanted of the load, component {'xyz'[k]}",
                reads=f"path derivative {order}, component {k + 1}",
                unit=unit,
                start=REST[k] if order == 0 else 0.0,
            )


def _outputs() -> Iterable[Variable]:
    rows: tuple[tuple[str, str, str, float | None, float, str], ...] = (
        ("M_b", "N.m", "", None, 1000.0, "slewing torque on the bridge, positive as phi"),
        ("F", "N", "", None, 1000.0, "force on the trolley along the bridge, positive as s"),
        ("M_w", "N.m", "", None, 100.0, "winch torque, positive where it pays out rope"),
        ("phi", "rad", "deg", None, 1.0, "bridge angle, continuous across full turns"),
        ("s", "m", "", 0.0, 1.0, "distance of the trolley from the slewing axis"),
        ("l", "m", "", 0.0, 1.0, "rope length"),
        ("tension", "N", "kN", 0.0, 1000.0, "rope tension"),
        ("swing", "rad", "deg", 0.0, 0.1, "angle of the rope from the vertical"),
    )
    for name, unit, display, minimum, nominal, text in rows:
        yield Variable(
            name, "output", "continuous", text, f"channel {name}", unit, display, None, minimum, None, nominal
        )


def _parameters(parameters: Iterable[ParameterLike]) -> Iterable[Variable]:
    for each in parameters:
        yield Variable(
            name=each.name,
            causality="parameter",
            variability="fixed" if each.name in _FIXED_PARAMETERS else "tunable",
            description=each.description,
            reads=f"parameter {each.name}",
            unit=each.unit,
            start=each.default,
            minimum=each.lower,
            maximum=each.upper,
            nominal=each.default,
        )


def _settings(models: Sequence[str], formulations: Sequence[str]) -> Iterable[Variable]:
    yield Variable(
        name="internal_step",
        causality="parameter",
        variability="tunable",
        description="step of the method; a communication step takes the nearest whole number of them; 0: one",
        reads="setting internal_step",
        unit="s",
        start=0.0,
        minimum=0.0,
    )
    texts = (
        ("model", models, "model of the crane that is solved"),
        ("formulation", formulations, "how the servo constraints enter the equations"),
        ("input_time", INPUT_TIMES, "instant of a communication step that its inputs belong to"),
    )
    for name, choices, description in texts:
        yield Variable(
            name=name,
            causality="parameter",
            variability="fixed",
            description=f"{description}: {', '.join(choices)}",
            reads=f"setting {name}",
            start=choices[0],
            choices=tuple(choices),
        )
