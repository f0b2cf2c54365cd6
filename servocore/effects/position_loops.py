"""`PositionLoops`: position loops that drive a plant beside the inputs that were computed for it."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from servocore.errors import InvalidModel, require_positive
from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem
from servocore.stepping.observation import observed


@dataclass(frozen=True)
class PositionLoops:
    """A position loop in every drive: u = u_S + K (y_S - y) + D (y_S' - y').

    The gains follow from the inertia that a drive feels where the path ends, the others being free: K is that
    inertia times the square of the bandwidth, D twice the damping times bandwidth times inertia.

    Parameters
    ----------
    bandwidth : float
        In rad/s.
    damping : float
        1 is critical.
    """

    bandwidth: float = 6.0
    damping: float = 1.0

    def __post_init__(self) -> None:
        for what, value in (("bandwidth", self.bandwidth), ("damping", self.damping)):
            require_positive(value, f"the {what} of position loops", "a number")


def reported(system: MechanicalSystem) -> dict[str, tuple[Quantity, ca.SX]]:
    """Return observables, outputs and coordinates by name, with their expressions."""
    known = ((each, expression) for each, expression in observed(system) if each not in system.inputs)
    return {each.name: (each, expression) for each, expression in known}


def is_position(system: MechanicalSystem, expression: ca.SX) -> bool:
    """Whether an expression depends on the configuration alone."""
    return not ca.depends_on(expression, ca.vertcat(system.v, system.lam, system.u, ca.vec(system.gamma)))


def measured_in(system: MechanicalSystem, names: tuple[str, ...]) -> tuple[tuple[Quantity, ...], ca.SX]:
    """Return the measured quantities and their expressions of q, by the names of reported quantities.

    Raises
    ------
    InvalidModel
        If the system reports nothing of a name, or something that is no position, or there are not as many as inputs.
    """
    by_name = reported(system)
    missing = [name for name in names if name not in by_name]
    if missing:
        raise InvalidModel(
            f"{system.name} reports no {', '.join(missing)} for its drives to measure; there are {', '.join(by_name)}"
        )
    if len(names) != len(system.inputs):
        known = [name for name, (_, each) in by_name.items() if is_position(system, each)]
        raise InvalidModel(
            f"{system.name} has {len(system.inputs)} inputs, and drives that measure {', '.join(names) or 'nothing'}:"
            f" name as many positions, of {', '.join(known)}"
        )
    expressions = [by_name[name] for name in names]
    column = ca.vertcat(*(each for _, each in expressions))
    if not is_position(system, column):
        raise InvalidModel(f"{system.name}: {', '.join(names)} are not all positions, which drives measure")
    return tuple(each for each, _ in expressions), column


def held(quantities: tuple[Quantity, ...], signal: ca.MX, position: ca.MX, rate: ca.MX, gains: ca.MX) -> ca.MX:
    """Return the inputs of drives whose loops hold them on a signal of inputs, positions and rates.

    Parameters
    ----------
    quantities : tuple of Quantity
        Measured ones.
    signal : casadi.MX, shape (3 m,)
        Feedforward, and what is wanted of positions and rates.
    position, rate : casadi.MX, shape (m,)
        As they are measured.
    gains : casadi.MX, shape (2 m,)
        Of positions, then of rates.
    """
    m = len(quantities)
    lag = wrapped(quantities, signal[m : 2 * m] - position)
    return signal[:m] + gains[:m] * lag + gains[m:] * (signal[2 * m :] - rate)


def wrapped(quantities: tuple[Quantity, ...], differences: ca.MX) -> ca.MX:
    """Return differences with those of angles between half a turn to both sides."""
    each = zip(quantities, ca.vertsplit(differences), strict=True)
    return ca.vertcat(*(ca.atan2(ca.sin(d), ca.cos(d)) if quantity.wraps else d for quantity, d in each))
