"""A table of variables describes an FMU; user page, systems and tests are generated from it.

`crane_fmu.catalogue.variables` writes the tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

Causality = Literal["input", "output", "parameter"]
Variability = Literal["continuous", "tunable", "fixed"]

ORDERS = ("position", "velocity", "acceleration", "jerk", "snap")
"""Names of the load path's derivatives of order 0, 1, ..."""

START_ORDERS = ORDERS[:4]
"""Those that say where the crane and its load are at the start, and how fast."""

DIMENSION = 3
"""Components of the load path."""

REST = (5.0, 0.0, -5.0)
"""Where the load hangs at rest when nothing is connected, in m."""

INPUT_TIMES = ("start", "end")
"""The instant of a communication step that its inputs may belong to; the first is the default."""

CRANE_PARAMETERS = ("bridge_inertia", "trolley_mass", "load_mass", "winch_inertia", "winch_radius", "gravity")
"""Parameters of the crane in the order in which a plant takes them."""


def components(*vectors: str) -> tuple[str, ...]:
    """Return the names of the components of vectors, one vector after the other."""
    return tuple(f"{name}[{k}]" for name in vectors for k in range(1, DIMENSION + 1))


PATH_INPUTS = components(*(f"load.{order}" for order in ORDERS))
"""What the inverse model has to be told of the load path, order by order."""

FEEDBACK_INPUTS = (
    *(f"measured.{name}" for name in ("phi", "s", "l", "phi_dot", "s_dot", "l_dot")),
    *components("measured.position", "measured.velocity"),
)
"""What the feedback has to be told of the crane."""

FROM_FILE = "file"
"""What a trajectory is told in place of a time law to follow the table that it carries."""

SHORTEST_STEP = 1e-6
"""Below this many seconds inputs from second differences drown in round-off: exact values are taken instead."""

LARGEST_TURN = 1.0
"""Of the fastest pendulum in a step, in rad: beyond it the feedback is left out."""


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
    unit, display_unit : str
        SI unit, and the unit that tools should show; empty for choices.
    start : float or str, optional
        None for what is calculated; the name of an item for choices.
    minimum, maximum, nominal : float, optional
        As in FMI 2.0.
    choices : tuple of str
        Names of an enumeration's items, which are numbered from 1.
    """

    name: str
    causality: Causality
    variability: Variability
    description: str
    unit: str = ""
    display_unit: str = ""
    start: float | str | None = None
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None
    choices: tuple[str, ...] = ()

    @property
    def is_choice(self) -> bool:
        """True for an Enumeration, False for a Real."""
        return bool(self.choices)


@dataclass(frozen=True)
class Interface:
    """All variables of an FMU in the order of their value references.

    Attributes
    ----------
    variables : tuple of Variable
        The table.
    """

    variables: tuple[Variable, ...]

    def of(self, causality: Causality) -> tuple[Variable, ...]:
        """Return the variables of one causality."""
        return tuple(variable for variable in self.variables if variable.causality == causality)

    def index(self, name: str) -> int:
        """Value reference of the variable called `name`; raises ValueError if there is none."""
        return [variable.name for variable in self.variables].index(name)

    def with_starts(self, starts: Mapping[str, float | str]) -> Interface:
        """Return the table with other start values, for those variables that it has."""
        given = {
            name: value
            for name, value in starts.items()
            if name not in {variable.name for variable in self.of("output")}
        }
        return Interface(
            tuple(replace(variable, start=given.get(variable.name, variable.start)) for variable in self.variables)
        )
