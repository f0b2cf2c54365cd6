"""Carriages of a crane's rope, with and without a flexible drive: straight rails, and a bridge that slews."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca

from servocore.model.quantity import Quantity
from servocore.model.symbols import Coordinates, Parameters

_TURNS = 2 * ca.pi


@dataclass(frozen=True, eq=False)
class Drive:
    """A drive of the carriage: measured quantity, its position, and the Jacobian of its rate.

    Attributes
    ----------
    measured : Quantity
        Name and unit of its position.
    position : casadi.SX
        Expression of q.
    row : casadi.SX
        Shape (1, n): the rate is row times v, and a force f of the drive is row^T f.
    friction : str
        Name of the parameter of its dry friction.
    """

    measured: Quantity
    position: ca.SX
    row: ca.SX
    friction: str


@dataclass(frozen=True, eq=False)
class Frame:
    """Contribution of a carriage to a model.

    Attributes
    ----------
    masses : tuple of casadi.SX
        What moves with each of its coordinates, kg or kg m².
    potential : casadi.SX
        Energy in J.
    constraints : casadi.SX
        Column; may be empty.
    exit : casadi.SX
        Where the rope leaves the trolley.
    drives : tuple of Drive
        One an input but for the winch's.
    """

    masses: tuple[ca.SX, ...]
    potential: ca.SX
    constraints: ca.SX
    exit: ca.SX
    drives: tuple[Drive, ...]


def _is_flexible(effects: frozenset[str]) -> bool:
    return bool(effects & {"flexible bridge", "flexible rail"})


def _offset(p: Parameters, effects: frozenset[str]) -> tuple[ca.SX, ca.SX]:
    """Return how far to the side of the trolley, and how far below the rail, the rope leaves it."""
    return (p["exit_side"], p["exit_drop"]) if "sheave offset" in effects else (ca.SX(0), ca.SX(0))


def exit_height(p: Parameters, effects: frozenset[str]) -> ca.SX:
    """Return the height of the rope's exit in m, from the rail upwards."""
    return -_offset(p, effects)[1]


def _stiffness(inertia: ca.SX, p: Parameters) -> ca.SX:
    """Spring between the drive's share and the rest with which they, free at both ends, swing at the frequency."""
    share = p["motor_share"]
    return (_TURNS * p["bridge_frequency"]) ** 2 * inertia * share * (1 - share)


@dataclass(frozen=True)
class Rails:
    """A trolley on one straight rail, or on a bridge that moves along two; the last rail is the trolley's.

    Attributes
    ----------
    rails : tuple of Quantity
        Positions along the rails.
    masses : tuple of str
        Names of the parameters that move along each rail beside what moves along the next ones.
    frictions : tuple of str
        Names of the parameters of dry friction.
    """

    rails: tuple[Quantity, ...]
    masses: tuple[str, ...]
    frictions: tuple[str, ...]

    @property
    def _motor(self) -> Quantity:
        first = self.rails[0]
        return Quantity(f"{first.name}_motor", first.unit, "position of the drive, before the flexible part")

    def quantities(self, effects: frozenset[str]) -> tuple[Quantity, ...]:
        """Return its coordinates."""
        return (*self.rails, self._motor) if _is_flexible(effects) else self.rails

    def frame(self, c: Coordinates, p: Parameters, effects: frozenset[str], trolley_mass: ca.SX) -> Frame:
        """Return its masses and energy; the first rail's drive is the flexible one.

        The mass of the trolley may be less than its parameter.
        """
        own, *carried = (trolley_mass if mass == "trolley_mass" else p[mass] for mass in self.masses)
        positions, first = [c[rail.name] for rail in self.rails], self.rails[0].name
        potential, measured, masses = ca.SX(0), list(self.rails), [sum(carried, own), *carried]
        if _is_flexible(effects):
            motor, share = self._motor.name, p["motor_share"]
            masses = [sum(carried, (1 - share) * own), *carried, share * own]
            potential = _stiffness(own, p) * (c[first] - c[motor]) ** 2 / 2
            measured[0] = self._motor
        side, drop = _offset(p, effects)
        place = ca.vertcat(*positions, -drop)
        place[len(positions) - 1] += side
        drives = tuple(
            Drive(each, c[each.name], ca.jacobian(c[each.name], c.q), friction)
            for each, friction in zip(measured, self.frictions, strict=True)
        )
        return Frame(tuple(masses), potential, ca.SX(0, 1), place, drives)

    def guess(self, exit_: ca.SX, p: Parameters, effects: frozenset[str]) -> ca.SX:
        """Return its coordinates with the rope's exit where it is to be."""
        side, _ = _offset(p, effects)
        positions = exit_[:-1]
        positions[-1] -= side
        return ca.vertcat(positions, positions[0]) if _is_flexible(effects) else positions


PHI_MOTOR = Quantity("phi_motor", "rad", "angle of the slewing drive, before the flexible bridge", wraps=True)


@dataclass(frozen=True)
class SlewingBridge:
    """A bridge that turns about a vertical axis, with a trolley on it; directions in the place of angles.

    Attributes
    ----------
    phi, trolley : Quantity
        The bridge's angle, and how far from the axis the trolley is.
    invariant : bool
        Whether d . p = s and d x p = 0 replace p = s d: they are invariant under rotations about the axis even where
        they do not hold.
    """

    phi: Quantity
    trolley: Quantity
    invariant: bool = False

    def quantities(self, effects: frozenset[str]) -> tuple[Quantity, ...]:
        """Return its coordinates: bridge direction, trolley point and distance, direction of a flexible drive."""
        names = ("d_x", "d_y", "p_x", "p_y")
        own = (*(Quantity(name, "1" if name[0] == "d" else "m") for name in names), self.trolley)
        return (*own, Quantity("e_x", "1"), Quantity("e_y", "1")) if _is_flexible(effects) else own

    def frame(self, c: Coordinates, p: Parameters, effects: frozenset[str], trolley_mass: ca.SX) -> Frame:
        """Return its masses, energy and constraints: |d| = 1, p = s d, and |e| = 1 of a flexible drive."""
        d, place, s = c.q[0:2], c.q[2:4], c[self.trolley.name]
        inertia, across = p["bridge_inertia"], ca.vertcat(-d[1], d[0])
        on_bridge = ca.vertcat(ca.dot(d, place) - s, ca.dot(across, place)) if self.invariant else place - s * d
        constraints, potential = [ca.sumsqr(d) - 1, on_bridge], ca.SX(0)
        rest, motor = inertia, list[ca.SX]()
        driven, at, measured = d, 0, self.phi
        if _is_flexible(effects):
            driven, at, measured = c.q[5:7], 5, PHI_MOTOR
            rest, motor = (1 - p["motor_share"]) * inertia, [p["motor_share"] * inertia] * 2
            # k |d - e|^2 / 2 = k (1 - cos of the angle between them): its torque is k times the sine
            potential = _stiffness(inertia, p) * ca.sumsqr(d - driven) / 2
            constraints.append(ca.sumsqr(driven) - 1)
        row = ca.SX(1, len(c))
        row[0, at], row[0, at + 1] = -driven[1], driven[0]
        side, drop = _offset(p, effects)
        return Frame(
            masses=(rest, rest, trolley_mass, trolley_mass, ca.SX(0), *motor),
            potential=potential,
            constraints=ca.vertcat(*constraints),
            exit=ca.vertcat(place + side * across, -drop),
            drives=(
                Drive(measured, ca.atan2(driven[1], driven[0]), row, "bridge_friction"),
                Drive(self.trolley, s, ca.jacobian(s, c.q), "trolley_friction"),
            ),
        )

    def guess(self, exit_: ca.SX, p: Parameters, effects: frozenset[str]) -> ca.SX:
        """Return its coordinates with the rope's exit where it is to be."""
        side, _ = _offset(p, effects)
        place = exit_[:2]
        s = ca.sqrt(ca.sumsqr(place) - side**2)
        d = place / s  # each product more in this chain shows in the time of an exact inversion
        if "sheave offset" in effects:
            x, y = place[0], place[1]
            # exit = s d + side (-d_y, d_x), as complex numbers (s + i side) d
            d = ca.vertcat(s * x + side * y, s * y - side * x) / ca.sumsqr(place)
            place = s * d
        return ca.vertcat(d, place, s, d) if _is_flexible(effects) else ca.vertcat(d, place, s)


Carriage: TypeAlias = Rails | SlewingBridge
"""A carriage of a crane's rope."""
