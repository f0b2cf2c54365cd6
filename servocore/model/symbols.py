"""Named symbols: coordinates with their velocities, and parameters with default, unit and bounds.

A model is written with CasADi expressions of these symbols. Parameters stay symbols, as
inputs of every compiled function: an FMU can tune them, a user can differentiate by them.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidModel, described, require_kind, require_real
from servocore.model.quantity import Quantity
from servocore.numerics.units import behind


@dataclass(frozen=True)
class Parameter:
    """A named constant of a model.

    Parameters
    ----------
    name : str
        Identifier, unique within its model.
    default : float
        Value unless another is given, in `unit`.
    unit : str
        SI unit as FMI spells it.
    lower, upper : float
        Closed bounds, in `unit`.
    description : str
        One line for tables and tool tips.
    fixed : bool
        Whether FMUs keep it constant after initialization, because a change would move coordinates instantaneously.
    """

    name: str
    default: float
    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    description: str = ""
    fixed: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise InvalidModel(f"the name of a parameter must be a text, not {described(self.name)}")
        require_kind(self.unit, str, f"the unit of parameter {self.name}", "a text such as 'kg'", InvalidModel)
        require_real(self.default, f"the default of parameter {self.name}", "a number", InvalidModel)
        for bound in (self.lower, self.upper):
            require_kind(bound, (int, float), f"a bound of parameter {self.name}", "a number", InvalidModel)
        if not self.lower <= self.upper:
            raise InvalidModel(f"parameter {self.name} has no value between {self.lower} and {self.upper} {self.unit}")

    def check(self, value: float) -> float:
        """Return `value` as a float, or raise `InvalidModel` if it is not a number within the bounds.

        Parameters
        ----------
        value : float
            In the unit of the parameter.

        Returns
        -------
        float
            The same value.
        """
        try:
            if isinstance(value, bool | np.bool_ | str):  # converted by float: a text from a file would be accepted
                raise TypeError
            number = float(value)
        except (TypeError, ValueError):
            raise InvalidModel(f"parameter {self.name} must be a number, not {value!r}") from None
        except OverflowError:
            raise InvalidModel(f"parameter {self.name} is too large for a number in double precision") from None
        if not math.isfinite(number) and math.isinf(self.upper) and math.isinf(self.lower):
            raise InvalidModel(f"parameter {self.name} must be a finite number, not {number:g}{behind(self.unit)}")
        if not (math.isfinite(number) and self.lower <= number <= self.upper):
            raise InvalidModel(
                f"parameter {self.name} = {number:g}{behind(self.unit)} is outside its range"
                f" [{self.lower:g}, {self.upper:g}]{behind(self.unit)}"
            )
        return number


def require_unique(names: Sequence[str], kind: str) -> None:
    """Raise `InvalidModel`, naming them, if some of the names are the same."""
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InvalidModel(f"{kind} named twice: {', '.join(repeated)}")


def quantities_of(values: Any, what: str) -> tuple[Quantity, ...]:
    """Return a sequence of quantities as a tuple; raises `InvalidModel` if it is something else."""
    if isinstance(values, str | Quantity) or not isinstance(values, Sequence):
        raise InvalidModel(f"{what} must be a sequence of Quantity, not {described(values)}")
    for value in values:
        require_kind(value, Quantity, what, "made of Quantity, such as Quantity('x', 'm')", InvalidModel)
        for attribute in ("name", "unit"):
            require_kind(
                getattr(value, attribute), str, f"{what}: the {attribute} of a quantity", "a text", InvalidModel
            )
        number = value.nominal is None or isinstance(value.nominal, int | float | np.number)
        if not value.name or not number or not 0.0 < value.magnitude < math.inf:
            raise InvalidModel(
                f"{what}: a quantity needs a name and a nominal magnitude that is positive and finite, not"
                f" {value.name!r} and {value.nominal!r}"
            )
    return tuple(values)


def numbers(values: Any, names: Sequence[str], what: str) -> tuple[float, ...]:
    """Return finite numbers, one for each of some names, as a tuple; empty if not given.

    Raises
    ------
    InvalidModel
        If there are too few or too many, or one is not finite.
    """
    listed = values.tolist() if isinstance(values, np.ndarray) else values
    if listed is None or (isinstance(listed, list | tuple) and not listed):
        return ()
    if not isinstance(listed, list | tuple):
        raise InvalidModel(f"{what} must be a tuple of numbers, not {described(values)}")
    if len(listed) != len(names):
        raise InvalidModel(f"{what} has length {len(listed)}, one number is needed for each of {', '.join(names)}")
    for name, value in zip(names, listed, strict=True):
        number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
        if not (number and math.isfinite(value)):
            raise InvalidModel(f"{what} must hold a finite number for {name}, not {described(value)}")
    return tuple(float(entry) for entry in listed)


def symbols(names: Iterable[str]) -> ca.SX:
    """Return a column of symbols, empty without names."""
    return ca.vertcat(ca.SX(0, 1), *map(ca.SX.sym, names))


@dataclass(frozen=True, eq=False)
class Coordinates:
    """The coordinates q of a system and their velocities v, as symbols by name.

    Parameters
    ----------
    *quantities : Quantity
        Name and unit of each coordinate.

    Attributes
    ----------
    q, v : casadi.SX
        Column vectors of length n.
    """

    quantities: tuple[Quantity, ...]
    q: ca.SX = field(init=False, repr=False)
    v: ca.SX = field(init=False, repr=False)

    def __init__(self, *quantities: Quantity) -> None:
        object.__setattr__(self, "quantities", quantities_of(quantities, "Coordinates(...)"))
        require_unique(self.names, "coordinate")
        object.__setattr__(self, "q", symbols(self.names))
        object.__setattr__(self, "v", symbols(f"v_{name}" for name in self.names))

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the order of q."""
        return tuple(quantity.name for quantity in self.quantities)

    @property
    def nominal(self) -> tuple[float, ...]:
        """Typical magnitudes in the order of q."""
        return tuple(quantity.magnitude for quantity in self.quantities)

    def scaled(self, magnitudes: Sequence[float]) -> Coordinates:
        """Return the same symbols with these nominal values.

        Parameters
        ----------
        magnitudes : sequence of float
            One per coordinate, in its unit.

        Returns
        -------
        Coordinates
            New coordinates; these are unchanged.
        """
        copied = copy.copy(self)
        pairs = zip(self.quantities, magnitudes, strict=True)
        object.__setattr__(copied, "quantities", tuple(replace(each, nominal=float(size)) for each, size in pairs))
        return copied

    def __len__(self) -> int:
        return len(self.quantities)

    def index(self, name: str) -> int:
        """Position of the coordinate called `name`; raises `InvalidModel` if there is none.

        Parameters
        ----------
        name : str
            Of a coordinate.

        Returns
        -------
        int
            Counted from zero.
        """
        if name not in self.names:
            raise InvalidModel(f"no coordinate is called {name}; there are {', '.join(self.names)}")
        return self.names.index(name)

    def __getitem__(self, name: str) -> ca.SX:
        return self.q[self.index(name)]

    def velocity(self, name: str) -> ca.SX:
        """Return the symbol of the velocity of the coordinate called `name`.

        Parameters
        ----------
        name : str
            Of a coordinate.

        Returns
        -------
        casadi.SX, scalar
            Its entry of `v`.
        """
        return self.v[self.index(name)]


@dataclass(frozen=True, eq=False)
class Parameters:
    """The parameters p of a system, as symbols by name.

    Parameters
    ----------
    *declared : Parameter
        Name, unit, default and bounds of each.
    p : casadi.SX, optional
        Their symbols, where a model has them already.

    Attributes
    ----------
    p : casadi.SX
        Column vector in the order of `declared`.
    """

    declared: tuple[Parameter, ...]
    p: ca.SX = field(init=False, repr=False)

    def __init__(self, *declared: Parameter, p: ca.SX | None = None) -> None:
        for parameter in declared:
            require_kind(parameter, Parameter, "Parameters(...)", "made of Parameter, one by one", InvalidModel)
        object.__setattr__(self, "declared", declared)
        require_unique(self.names, "parameter")
        object.__setattr__(self, "p", symbols(self.names) if p is None else p)

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the order of p."""
        return tuple(parameter.name for parameter in self.declared)

    def __len__(self) -> int:
        return len(self.declared)

    def __getitem__(self, name: str) -> ca.SX:
        self._require_known((name,))
        return self.p[self.names.index(name)]

    def values(self, changed: Mapping[str, float] | None = None) -> npt.NDArray[np.float64]:
        """Return the vector p: the defaults, with the values in `changed` in their place.

        Parameters
        ----------
        changed : mapping of str to float, optional
            Values by name, in the units of the parameters.

        Returns
        -------
        ndarray, shape (parameters,)
            In the order of `declared`.

        Raises
        ------
        InvalidModel
            If a name is unknown or a value leaves its bounds.
        """
        changed = {} if changed is None else changed
        require_kind(changed, Mapping, "parameter values", "a mapping of names to numbers", InvalidModel)
        self._require_known(tuple(changed))
        return np.array(
            [parameter.check(changed.get(parameter.name, parameter.default)) for parameter in self.declared]
        )

    def _require_known(self, names: tuple[str, ...]) -> None:
        unknown = [name for name in names if name not in self.names]
        if unknown:
            raise InvalidModel(
                f"no parameter is called {', '.join(map(str, unknown))}; there are {', '.join(self.names) or 'none'}"
            )


def named(quantities: Iterable[Quantity | Parameter], values: ca.SX) -> list[tuple[str, ca.SX]]:
    """Return the rows of an expression by the names of their quantities."""
    return list(zip((quantity.name for quantity in quantities), ca.vertsplit(values), strict=True))
