"""`from_file`: a scene from a robot or crane file."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path

import casadi as ca

from servocore.errors import ServocoreWarning
from servocore.importers.assembly import Assembly
from servocore.importers.coordinates import UNITS
from servocore.importers.link_files import read_sdf, read_urdf
from servocore.importers.mjcf import read_mjcf
from servocore.importers.options import Elastic, Options
from servocore.importers.tree import FREE, Tree
from servocore.importers.xml_files import XmlFile
from servocore.model.limits import RATE, Limit, Named
from servocore.model.scene import Scene
from servocore.references.base import Reference
from servocore.references.profiles import DEGREE13
from servocore.references.rest_to_rest import rest_to_rest

SUFFIXES = (".urdf", ".xml", ".mjcf", ".sdf")
"""Suffixes of files that are read; their kind is known by the root element."""

_WAY = {"rad": 0.2, "m": 0.1}
"""Length of the default path of an output."""

_DURATION = 2.0  # s, of the default path
_SHARE = 0.2  # of the range of an output, at most

READERS: Mapping[str, Callable[[XmlFile], Tree]] = {"robot": read_urdf, "mujoco": read_mjcf, "sdf": read_sdf}
"""Readers by the root element."""


def read_tree(path: str | PathLike[str]) -> Tree:
    """Return the mechanism of a file.

    Parameters
    ----------
    path : path-like
        A URDF, MJCF or SDF file.

    Returns
    -------
    Tree
        Bodies, joints, drives and constraints.

    Raises
    ------
    InvalidModel
        If the file cannot be read, contradicts itself, or holds an element that cannot be represented.
    """
    file = XmlFile.read(Path(path))
    if file.root.tag not in READERS:
        raise file.fault(file.root, "is no robot file: the root element is <robot> (URDF), <mujoco> (MJCF) or <sdf>")
    return READERS[file.root.tag](file)


def from_file(
    path: str | PathLike[str],
    outputs: Sequence[str] = (),
    reference: Reference | None = None,
    *,
    inputs: Sequence[str] | None = None,
    elastic: Mapping[str, Elastic] | None = None,
    passive: Sequence[str] = (),
    locked: Sequence[str] = (),
    points: Sequence[str] = (),
    ropes: Sequence[str] = (),
    taut: Sequence[str] = (),
    posture: Mapping[str, float] | None = None,
    payload: Mapping[str, float] | None = None,
    gravity: Sequence[float] | None = None,
    limits: bool = True,
) -> Scene:
    """Return a scene of the mechanism in a URDF, MJCF or SDF file.

    Coordinates are called as the joints, inputs ``JOINT.torque`` or ``JOINT.force`` for slides, motors ``JOINT.motor``.

    Parameters
    ----------
    path : path-like
        The file. MJCF needs the package mujoco (extra ``mjcf``).
    outputs : sequence of str
        What follows the path: joints; a frame for its place ``tool0.x``, ``tool0.y``, ``tool0.z`` in the axes of the
        base (m); ``tool0.rx``, ``.ry``, ``.rz`` for its rotation vector from the posture (rad). All driven joints when
        empty.
    reference : Reference, optional
        Path of the outputs; a short line from the posture when not given.
    inputs : sequence of str, optional
        Driven joints, drives of the file, or components of wrenches at the centre of mass of a body in its axes
        (``drone.force_z``, ``drone.torque_x``); all drives of the file when not given.
    elastic : mapping of str to Elastic, optional
        Elastic joints; their stiffness, motor inertia and damping, unless zero, become parameters.
    passive, locked : sequence of str
        Joints without a drive; joints that are held in the posture.
    points : sequence of str
        Bodies that become point masses with coordinates of their own, tied to their joints by constraints: so a load on
        a rope of hinges is seen to be flat.
    ropes : sequence of str
        Bodies that become point masses on a rope in the place of the free hinges above them.
    taut : sequence of str
        Tendons that are ropes of their largest length.
    posture : mapping of str to float, optional
        Values of joints (rad, m) at the start; zero, or the middle of limits that exclude zero, for others.
    payload : mapping of str to float, optional
        Point masses (kg) at frames; they become parameters.
    gravity : sequence of float, optional
        Acceleration of gravity in the axes of the base, m/s2; that of the file, or 9.81 m/s2 along -z, when not given.
    limits : bool
        Whether the limits of the file are kept.

    Returns
    -------
    Scene
        With one model, ``file``.

    Raises
    ------
    InvalidModel
        If the file cannot be read, contradicts itself or holds an element that cannot be represented, or the outputs
        are dependent at the posture.
    InvalidSetting
        If an option names something that the file does not have.

    Examples
    --------
    >>> import servocore as sc
    >>> arm = sc.scenes.from_file("arm.urdf", elastic={"elbow": sc.Elastic(1e4, motor_inertia=0.3)})  # doctest: +SKIP
    """
    options = Options(
        outputs, inputs, elastic or {}, passive, locked, points, ropes, taut, posture or {}, payload or {}, gravity,
        limits,
    )  # fmt: skip
    return scene_of(read_tree(path), options, reference)


def scene_of(tree: Tree, options: Options, reference: Reference | None = None) -> Scene:
    """Return the scene of a mechanism; see `from_file`.

    Parameters
    ----------
    tree : Tree
        The mechanism.
    options : Options
        Choices.
    reference : Reference, optional
        Path of the outputs; a short line from the posture when not given.
    """
    assembly = Assembly(tree, options)
    limits = limits_of(assembly) if options.limits else ()
    system = assembly()
    opposed = ca.gradient(system.potential, system.q), system.force, ca.jacobian(system.constraints, system.q).T
    acting, row = ca.sparsify(ca.horzcat(system.mass, *opposed)), assembly.coordinates.index
    if idle := [each.joint for each in assembly.inputs if each.joint and not acting[row(each.joint), :].nnz()]:
        found = f"{tree.source}: {', '.join(idle)} moves no mass, its drive does nothing"
        cure = "give masses or an armature to the file, or a payload, or hold it by locked"
        warnings.warn(f"{found}: {cure}", ServocoreWarning, stacklevel=3)
    if reference is None:
        bounds = {limit.quantity: (limit.bound, limit.upper) for limit in limits}
        target = list[float]()
        for x, each in zip(system.home, system.outputs, strict=True):
            low, high = bounds.get(each.name, FREE)
            way = min(_WAY.get(each.unit, 0.1), _SHARE * (high - low))
            target.append(x + (way if x + 2 * way < high else -way))  # within its limits
        reference = rest_to_rest(system.home, target, _DURATION, DEGREE13)
    return Scene(tree.name, {"file": assembly}, reference, limits=limits, drawing=assembly.drawing, hint=assembly.hint)


def limits_of(assembly: Assembly) -> tuple[Limit, ...]:
    """Return the limits of a file: of joints, their rates, inputs and controls."""
    rows = list[tuple[str, str, tuple[float, float], bool]]()
    for joint in assembly.moving:
        unit = UNITS[joint.kind][0]
        rows.append((joint.name, unit, (joint.lower, joint.upper), False))
        rows.append((joint.name, unit, (-joint.velocity, joint.velocity), True))
    rows += [(of.name, of.unit, ends, False) for drive in assembly.inputs for of, ends in drive.bounds.items()]
    return tuple(
        Limit(f"{name}{RATE * rate}", f"{unit}{'/s' * rate}", low, "", Named(name), upper=high, rate=rate)
        for name, unit, (low, high), rate in rows
        if low < high and (math.isfinite(low) or math.isfinite(high))
    )
