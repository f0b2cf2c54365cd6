"""`Drive`: motor, transmission and losses behind an input, as a data sheet gives them.

The motor turns n times as fast as the input moves: omega = n w, with w = -B v the rate that belongs to the input u and
n = ratio x rope_falls, by the drum's radius where the input is a force. Of the input u = n tau the drive takes

    n^2 J w_dot + n (c tanh(w / w_0) + d n w)        rotor, dry and viscous friction (as the effect `friction` has it)

for itself: n^2 J B^T B joins M, the friction the forces. u keeps its name, place and unit, and what the motor does is
reported beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Any

import casadi as ca

from servocore.errors import InvalidModel, described
from servocore.model.quantity import Quantity
from servocore.model.symbols import Parameter, Parameters, symbols
from servocore.model.system import MechanicalSystem
from servocore.numerics.memoization import made_once
from servocore.numerics.units import in_unit

CREEP = 0.01
"""w_0 in rad/s or m/s: rate of the input at which dry friction is 76 % of its full value, as of `friction`."""

_SMOOTH = 2e-3  # of the highest speed and torque: corners of a torque-speed curve are rounded off so far, downwards
_BEYOND = 0.05  # of the highest speed: so far above it the largest torque falls to zero
_SLIGHT = 1e-9  # N.m: |tau| is rounded off at zero, so that certificates enclose it

_CORNER = tuple(Parameter(f"torque_speed, a {what}", 0.0, unit, 0.0, 1e12)
                for what, unit in (("speed", "rad/s"), ("torque", "N.m")))  # fmt: skip

Given = float | str
"""A number in SI units, or a text with its unit."""


def _datum(default: float | None, unit: str, lower: float, upper: float, description: str) -> Any:
    """Declare a field of `Drive` with its unit and range; data that are not given count as 1."""
    neutral = 1.0 if default is None else default
    about = {"default": neutral, "unit": unit, "lower": lower, "upper": upper, "description": description}
    return field(default=default, metadata=about)


@dataclass(frozen=True)
class Drive:
    """Motor and transmission of an input, with the data of a data sheet; all but the gear at the motor's shaft.

    Parameters
    ----------
    ratio : float or str
        Speed of the motor by that of the drum, wheel or slewing bridge.
    rope_falls : float or str
        Rope falls that carry the hook, per rope end on the drum: the drum turns so many times faster.
    drum_radius : float or str, optional
        Radius (m) of the drum or wheel, for an input that is a force. Where the input is a torque on a winch, the
        winch's radius is a parameter of the scene, and that of the drum belongs there.
    motor_inertia : float or str
        Moment of inertia (kg.m2) of rotor, brake and coupling.
    efficiency : float or str
        Of the transmission: the reported torque of the motor is larger by it while the motor drives the load, and
        smaller while the load drives the motor. It does not change the motion or the input.
    viscous : float or str
        Viscous friction (N.m.s/rad).
    coulomb : float or str
        Dry friction (N.m), smooth below a rate of the input of 0.01 m/s or rad/s.
    torque_constant : float or str, optional
        Torque by current (N.m/A); the current is reported if it is given.
    torque_speed : sequence of (speed, torque)
        Corners of the curve of the largest torque (N.m) over the speed (rad/s), from speed 0 to the highest speed that
        it allows: five per cent above, no torque is left. The torque in reserve is then reported. Corners are rounded
        off downwards, by the change of the slope times a thousandth of the highest speed, steep ones by two per cent of
        the largest torque.
    rated_torque : float or str, optional
        Continuous torque (N.m), which the duty compares with the effective one.
    rated_power : float or str, optional
        Rated power (W), which the duty compares with the peak.

    Raises
    ------
    InvalidSetting
        If a text is no number with a unit of the right kind.
    InvalidModel
        If a value is outside its range, or the curve is none.

    Examples
    --------
    >>> import servocore as sc
    >>> hoist = sc.Drive(ratio=42.1, motor_inertia="0.03 kg m^2", torque_speed=[(0, 60), ("1450 rpm", "55 N m")])
    >>> crane = sc.scenes.overhead_crane().with_drives(M_w=hoist)
    >>> sc.solve(crane).unit("M_w.motor_speed")
    'rad/s'
    """

    ratio: Given = _datum(1.0, "1", 1e-6, 1e9, "speed of the motor by that of the drum, wheel or bridge")
    rope_falls: Given = _datum(1.0, "1", 1e-3, 1e3, "rope falls that carry the hook, per rope end on the drum")
    drum_radius: Given | None = _datum(None, "m", 1e-6, 1e3, "of the drum or wheel that turns the torque into a force")
    motor_inertia: Given = _datum(0.0, "kg.m2", 0.0, 1e9, "of rotor, brake and coupling at the motor's shaft")
    efficiency: Given = _datum(1.0, "1", 1e-3, 1.0, "of the transmission")
    viscous: Given = _datum(0.0, "N.m.s/rad", 0.0, 1e9, "viscous friction at the motor's shaft")
    coulomb: Given = _datum(0.0, "N.m", 0.0, 1e9, "dry friction at the motor's shaft")
    torque_constant: Given | None = _datum(None, "N.m/A", 1e-9, 1e9, "torque of the motor by its current")
    torque_speed: Sequence[tuple[Any, Any]] = ()
    rated_torque: Given | None = _datum(None, "N.m", 1e-9, 1e12, "continuous torque of the motor")
    rated_power: Given | None = _datum(None, "W", 1e-9, 1e15, "rated power of the motor")

    def __post_init__(self) -> None:
        for name, datum in _DATA.items():
            if (value := getattr(self, name)) is not getattr(Drive, name):
                object.__setattr__(self, name, _checked(datum, value))
        try:
            corners = tuple(tuple(map(_checked, _CORNER, (speed, torque))) for speed, torque in self.torque_speed)
        except (TypeError, ValueError):
            given = described(self.torque_speed)
            raise InvalidModel(f"torque_speed needs pairs of a speed and a torque, not {given}") from None
        rising = all(a[0] < b[0] for a, b in pairwise(corners)) and any(torque for _, torque in corners)
        if corners and not (len(corners) > 1 and corners[0][0] == 0.0 and rising):
            raise InvalidModel(
                "torque_speed needs two corners or more, at rising speeds from 0 on, not all with torque 0:"
                " ((0, 60), (150, 40))"
            )
        object.__setattr__(self, "torque_speed", corners)

    def declared(self, of: str) -> list[Parameter]:
        """Return the data that are given and enter the model, as parameters.

        Parameters
        ----------
        of : str
            Name of the input, before the names of the parameters.

        Returns
        -------
        list of Parameter
            ``M_b.ratio`` and others, with their values as defaults.
        """
        return [
            replace(e, name=f"{of}.{name}", default=getattr(self, name), description=f"{e.description}, of {of}")
            for name, e in _DATA.items()
            if getattr(self, name) != getattr(Drive, name) and not name.startswith("rated_")
        ]


_DATA = {each.name: Parameter(each.name, **each.metadata) for each in fields(Drive) if each.metadata}


def _checked(of: Parameter, value: object) -> float:
    return of.check(in_unit(value, of.unit, of.name) if isinstance(value, str) else value)  # type: ignore[arg-type]  # checked there


@made_once
def driven(system: MechanicalSystem, drives: tuple[tuple[str, Drive], ...]) -> MechanicalSystem:
    """Return a model with drives at its inputs: reflected inertia and friction, and further parameters and observables.

    Raises
    ------
    InvalidModel
        If an input has no place for a drive, or its radius is missing or given twice.
    """
    declared = [each for name, drive in drives for each in drive.declared(name)]
    more = symbols(each.name for each in declared)
    parameters = Parameters(*system.parameters.declared, *declared, p=ca.vertcat(system.p, more))
    q, v, v_dot = system.q, system.v, ca.SX.sym("v_dot", system.v.numel())
    mass, gyroscopic, force, left = system.mass, system.gyroscopic, system.force, ca.SX(system.u)
    observables = dict(system.observables)
    for name, drive in drives:
        k, p = _place(system, name, drive), _data(name, drive, parameters)
        B, n = system.input_matrix[k, :], p["transmission"]
        rate = -ca.mtimes(B, v)
        # The rotor's inertia force acts along B: n^2 J d(Bv)/dt. No Lagrangian is needed, so B may be any rows.
        inertia, along = n**2 * p["motor_inertia"], ca.jtimes(ca.mtimes(B, v), q, v)
        mass += ca.sparsify(inertia * ca.mtimes(B.T, B))
        gyroscopic += ca.sparsify(inertia * B.T * along)
        friction = n * (p["coulomb"] * ca.tanh(rate / CREEP) + p["viscous"] * n * rate)
        force += ca.sparsify(B.T * friction)
        left[k] -= friction - inertia * (ca.mtimes(B, v_dot) + along)
        observables |= _observed(name, drive, p, system.u[k], n * rate)
    # Forces that follow from the motion are those of the mechanism: it gets what the drives leave of the inputs.
    known = ca.Function("sc_left", [q, v, v_dot, system.u, parameters.p], [left], {"cse": True})
    return replace(
        system,
        name=f"{system.name} with drives",
        parameters=parameters,
        home_parameters=(*system.home_parameters, *(each.default for each in declared)),
        mass=mass,
        gyroscopic=gyroscopic,
        force=force,
        observables=observables,
        reactions={quantity: _reaction(function, known) for quantity, function in system.reactions.items()},
    )


def place_of_input(system: MechanicalSystem, name: str) -> int:
    """Return the number of an input; raises `InvalidModel` if there is none."""
    names = [quantity.name for quantity in system.inputs]
    if name not in names:
        raise InvalidModel(f"{system.name} has no input {name} that a drive could act on; it has {', '.join(names)}")
    return names.index(name)


def _place(system: MechanicalSystem, name: str, drive: Drive) -> int:
    """Return the number of an input; raises `InvalidModel` if there is none, or unit and radius disagree."""
    place = place_of_input(system, name)
    unit = system.inputs[place].unit
    if unit not in ("N", "N.m"):
        raise InvalidModel(
            f"the input {name} of {system.name} is in {unit}: a drive makes a torque in N.m or a force in N"
        )
    if (unit == "N") != (drive.drum_radius is not None):
        raise InvalidModel(
            f"{name} is a force: its drive needs drum_radius, the radius of its wheel or drum"
            if unit == "N"
            else f"{name} is a torque: its drive has no drum_radius; the radius of a winch's drum is a parameter of the"
            " scene, such as winch_radius"
        )
    return place


def _data(name: str, drive: Drive, parameters: Parameters) -> dict[str, ca.SX]:
    """Return the data of a drive: symbols of those that are parameters, neutral numbers of the others."""
    p = {each: ca.SX(datum.default) for each, datum in _DATA.items()}
    p |= {each.name.removeprefix(f"{name}."): parameters[each.name] for each in drive.declared(name)}
    return p | {"transmission": p["ratio"] * p["rope_falls"] / p["drum_radius"]}


def _observed(name: str, drive: Drive, p: Mapping[str, ca.SX], u: ca.SX, speed: ca.SX) -> dict[Quantity, ca.SX]:
    """Return torque, speed, power and reserve of the motor under an input, by its speed."""
    torque, efficiency, driving = u / p["transmission"], p["efficiency"], ca.tanh(speed / p["transmission"] / CREEP)
    # tau / eta where the motor drives, tau eta where the load does.
    more, less = 1 / efficiency + efficiency, 1 / efficiency - efficiency
    torque = more / 2 * torque + less / 2 * _size(torque, _SLIGHT) * driving
    known = {
        Quantity(f"{name}.motor_torque", "N.m", f"torque of the motor of {name}"): torque,
        Quantity(f"{name}.motor_speed", "rad/s", f"speed of the motor of {name}"): speed,
        Quantity(f"{name}.power", "W", f"power at the motor's shaft of {name}"): torque * speed,
    }
    if drive.torque_constant is not None:
        known[Quantity(f"{name}.current", "A", f"current of the motor of {name}")] = torque / p["torque_constant"]
    if drive.torque_speed:
        about = f"torque that the motor of {name} could add at its speed"
        used = _size(torque, _SMOOTH * max(most for _, most in drive.torque_speed))
        known[Quantity(f"{name}.torque_reserve", "N.m", about)] = largest_torque(drive, speed) - used
    return known


def motors(system: MechanicalSystem, drives: Mapping[str, Drive], outputs: Sequence[Quantity]) -> ca.Function:
    """Return (outputs, p) -> outputs, the quantities of the motors being those of the inputs among them.

    For inputs that a feedback has changed: speeds are those of the motion that it follows.
    """
    given = ca.SX.sym("outputs", len(outputs))
    known = dict(zip((each.name for each in outputs), ca.vertsplit(given), strict=True))
    for name, drive in drives.items():
        found = _observed(name, drive, _data(name, drive, system.parameters), known[name], known[f"{name}.motor_speed"])
        known |= {quantity.name: expression for quantity, expression in found.items()}
    return ca.Function("motors", [given, system.p], [ca.vertcat(*known.values())], {"cse": True})


def _size(value: ca.SX, rounding: float) -> ca.SX:
    """Return the magnitude of a value, smooth at zero and nowhere below it."""
    return ca.sqrt(value**2 + rounding**2)


def largest_torque(drive: Drive, speed: ca.SX) -> ca.SX:
    """Return the torque (N.m) on the torque-speed curve of a drive at a speed (rad/s), for both directions.

    An even, piecewise linear function of the speed is a sum of |speed - corner|, one for every change of slope. With
    sqrt(x^2 + e^2) or x^2/sqrt(x^2 + e^2) for |x|, whichever lowers the sum, it is smooth and nowhere above the curve,
    and near to it far from a corner. A steep edge has a smaller e, and costs no more torque than the end of the curve.
    """
    (speed_most, torque_last), torque_most = drive.torque_speed[-1], max(torque for _, torque in drive.torque_speed)
    beyond = [((1.0 + _BEYOND) * speed_most, 0.0)] if torque_last else []
    corners = [*drive.torque_speed, *beyond]
    slopes = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in pairwise(corners)]
    torque = ca.SX(corners[0][1])
    for (corner, _), change in zip(corners, [slopes[0], *(b - a for a, b in pairwise(slopes))], strict=False):
        e = _SMOOTH * min(speed_most, torque_most / _BEYOND / max(abs(change), torque_most / speed_most))
        for x in (speed - corner, speed + corner):
            torque += change / 2 * ((x**2 / _size(x, e) if change > 0.0 else _size(x, e)) - corner)
    return torque


def _reaction(function: ca.Function, left: ca.Function) -> ca.Function:
    """Return a reaction (q, v, v_dot, u, d, p) of a mechanism without drives for one with them."""
    *motion, u, d, own = function.mx_in()
    *_, p = left.mx_in()
    values = function(*motion, left(*motion, u, p), d, p[: own.numel()])
    return ca.Function("reaction", [*motion, u, d, p], [values])
