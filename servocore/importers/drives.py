"""Inputs of an imported mechanism: drives of joints, tendons and frames, and wrenches on free bodies."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from servocore.errors import InvalidSetting
from servocore.importers.coordinates import MOTOR, UNITS, Layout
from servocore.importers.tree import FREE, Actuator, Joint
from servocore.model.quantity import Quantity

_WRENCH = re.compile(r"(.+)\.(force|torque)_([xyz])")
_EXACT = 1e-9  # of a unit wrench that rotors must exert

Bounds = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Drive:
    """An input.

    Attributes
    ----------
    quantity : Quantity
        Its name and unit.
    power : casadi.SX
        Power of a unit input, linear in the rates.
    joint : str
        The joint on which it acts; empty for others.
    symbol : casadi.SX
        Its symbol.
    bounds : mapping of Quantity to (float, float)
        Limits of the input and of what is observed of it.
    observed : mapping of Quantity to casadi.SX
        Quantities that depend on the input.
    wrench : (str, int), optional
        Body and number of the component of a wrench on it.
    rotor : str
        Frame on which a force along an axis acts; empty for others.
    """

    quantity: Quantity
    power: ca.SX
    joint: str = ""
    symbol: ca.SX = field(default_factory=lambda: ca.SX.sym("u"))
    bounds: Mapping[Quantity, Bounds] = field(default_factory=dict)
    observed: Mapping[Quantity, ca.SX] = field(default_factory=dict)
    wrench: tuple[str, int] | None = None
    rotor: str = ""


def chosen_drives(layout: Layout) -> list[Drive]:
    """Return the inputs: those that were chosen, or all drives of the file but passive ones.

    Raises
    ------
    InvalidSetting
        If a name is no joint, no drive and no component of a wrench, or stands twice.
    """
    tree, options = layout.tree, layout.options
    names = options.inputs
    if names is None:
        beside = [each.name for each in tree.actuators if each.kind != "joint" and each.name not in options.passive]
        names = [*layout.driven, *beside]
    if not names:
        raise InvalidSetting(f"{tree.source} has no drive: name inputs, components of wrenches as BODY.force_z too")
    drives = [_drive(name, layout) for name in names]
    listed = [drive.quantity.name for drive in drives]
    if len(set(listed)) < len(listed):
        raise InvalidSetting(f"inputs: {next(name for name in listed if listed.count(name) > 1)} stands twice")
    return drives


def _drive(name: str, layout: Layout) -> Drive:
    tree, motion = layout.tree, layout.motion
    actuators = {each.name: each for each in tree.actuators}
    if (part := _WRENCH.fullmatch(name)) and part[1] in tree.body:
        number = 3 * (part[2] == "torque") + "xyz".index(part[3])
        power = motion.power(layout.place(part[1]).moved(tree.body[part[1]].centre), np.eye(6)[number])
        return Drive(Quantity(name, "N" if number < 3 else "N.m"), power, wrench=(part[1], number))
    joints = {f"{joint.name}.{UNITS[joint.kind][2]}": joint for joint in tree.joints.values()} | {**tree.joints}
    joints |= {each.name: tree.joints[each.on] for each in tree.actuators if each.kind == "joint"}
    if name in joints:
        return _on_joint(joints[name], layout)
    if name not in actuators:
        listed = ", ".join([*tree.joints, *actuators])
        raise InvalidSetting(
            f"inputs: {tree.source} has no joint or drive {name}; there are {listed}, and wrenches as BODY.force_z"
        )
    actuator = actuators[name]
    gear = np.array(actuator.gear)
    if actuator.kind == "tendon":
        length = layout.length(tree.tendons[actuator.on])
        rate = ca.jtimes(length, layout.q, layout.v)
        return _limited(Drive(Quantity(f"{name}.force", "N"), rate), actuator, float(gear[0]), length)
    size, unit = float(np.linalg.norm(gear[:3])), Quantity(f"{name}.force", "N")
    if not size:
        size, unit = float(np.linalg.norm(gear[3:])), Quantity(f"{name}.torque", "N.m")
    power = motion.power(layout.place(actuator.on), gear / size)
    return _limited(Drive(unit, power, rotor=actuator.on), replace(actuator, bias=(0.0, 0.0, 0.0)), size, ca.SX(0))


def _on_joint(joint: Joint, layout: Layout) -> Drive:
    """Return the drive of a joint, of its motor where it is elastic."""
    name, (_, unit, force) = joint.name, UNITS[joint.kind]
    if name in layout.locked or joint.mimic or joint.kind == "ball":
        why = "a ball" if joint.kind == "ball" else "a mimic" if joint.mimic else "locked or part of a rope"
        raise InvalidSetting(f"inputs: {name} is {why} and has no drive of its own")
    motor = f"{name}{MOTOR}" if name in layout.options.elastic else name
    quantity = Quantity(f"{name}.{force}", unit)
    effort = {quantity: (-joint.effort, joint.effort)}
    drive = Drive(quantity, layout.coordinates.velocity(motor), name, bounds=effort)
    on = [actuator for actuator in layout.tree.actuators if actuator.kind == "joint" and actuator.on == name]
    return _limited(drive, on[0], on[0].gear[0], layout.coordinates[motor]) if len(on) == 1 else drive


def _limited(drive: Drive, actuator: Actuator, gear: float, length: ca.SX) -> Drive:
    """Return the drive with the limits of an actuator, and its ctrl where that is not the force itself."""
    gain, (constant, position, damping) = actuator.gain, actuator.bias
    ranges, bounds, observed = [actuator.limits], dict[Quantity, Bounds](), dict[Quantity, ca.SX]()
    if any(actuator.bias):
        ctrl = Quantity(f"{actuator.name}.ctrl", "1", f"control of {actuator.name}")
        bias = constant + gear * (position * length + damping * drive.power)
        observed[ctrl], bounds[ctrl] = (drive.symbol / gear - bias) / gain, actuator.control
    else:
        ranges.append((gain * actuator.control[0], gain * actuator.control[1]))
    behind = [drive.bounds.get(drive.quantity, FREE), actuator.behind]
    lower, upper = zip(*behind, *(sorted((gear * low, gear * high)) for low, high in ranges), strict=True)
    return replace(drive, bounds=bounds | {drive.quantity: (max(lower), min(upper))}, observed=observed)


def rotors(layout: Layout, drives: list[Drive]) -> dict[Quantity, ca.SX]:
    """Return the forces of the drives of frames that share the wrenches among the inputs.

    Raises
    ------
    InvalidSetting
        If they cannot exert the wrenches alone.
    """
    found = dict[Quantity, ca.SX]()
    for body in dict.fromkeys(drive.wrench[0] for drive in drives if drive.wrench):
        parts = {drive.wrench[1]: drive for drive in drives if drive.wrench and drive.wrench[0] == body}
        centre = layout.centre(body)
        placed = [(each, layout.place(each.on)) for each in layout.tree.actuators if each.kind == "frame"]
        on = [(each, place) for each, place in placed if place.stage == centre.stage]
        if not on:
            continue
        G = np.column_stack([place.wrench(each.gear) for each, place in on])
        wanted = np.column_stack([centre.wrench(np.eye(6)[number]) for number in parts])
        share = np.linalg.pinv(G, rcond=_EXACT) @ wanted
        if np.abs(G @ share - wanted).max() > _EXACT:
            raise InvalidSetting(
                f"inputs: {', '.join(each.name for each, _ in on)} cannot exert"
                f" {', '.join(drive.quantity.name for drive in parts.values())} independently of each other"
            )
        for row, (each, _) in zip(share, on, strict=True):
            force = ca.dot(row, ca.vertcat(*[drive.symbol for drive in parts.values()]))
            found[Quantity(f"{each.name}.drive", "N", f"drive of {each.name}")] = force
    return found
