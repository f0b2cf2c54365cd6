"""The command ``import``: the contents of a robot file, and the analysis of its servo constraint problem."""

from __future__ import annotations

import math
from pathlib import Path

import rich.box
import rich.table

from servocore.analysis import analyse
from servocore.cli.console import advised_here, table_console
from servocore.cli.options import Subject
from servocore.errors import InvalidSetting
from servocore.importers.assembly import Mechanism
from servocore.importers.from_file import SUFFIXES
from servocore.importers.tree import Joint
from servocore.model.scene import Scene

EXAMPLES = (
    "ur5.urdf",
    "ur5.urdf --servo-output tool0 --elastic 1e4 --motor-inertia 0.3",
    "crane.xml --import settings.toml",
)


def import_file(subject: Subject) -> None:
    """Print what is read from a URDF, MJCF or SDF file, and the analysis of its problem.

    Joints with limits, frames, inputs and outputs, limits that are kept, and the elements of the file that have no part
    in the model. The analysis is that of servocore analyse, along a short line from the posture.
    """
    if Path(subject.scene).suffix.lower() not in SUFFIXES:
        raise InvalidSetting(f"{subject.scene} is no robot file: its name ends in {', '.join(SUFFIXES)}")
    scene = subject.chosen()
    mechanism = scene.models[scene.default_model]
    assert isinstance(mechanism, Mechanism)
    console = table_console()
    console.print(joint_table(mechanism))
    for label, text in listed(scene, mechanism):
        console.print(f"  {label:<20}{text}", markup=False, highlight=False, soft_wrap=True)
    report = advised_here(str(analyse(scene, model=subject.model)))
    console.print(report, markup=False, highlight=False, soft_wrap=True)


def joint_table(mechanism: Mechanism) -> rich.table.Table:
    """Return the joints of a mechanism with their limits."""
    table = rich.table.Table(box=rich.box.SIMPLE_HEAD, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in ("joint", "kind", "range", "velocity", "effort", "damping", "armature"):
        table.add_column(heading, no_wrap=heading == "joint")
    for name, joint in mechanism.tree.joints.items():
        numbers = (joint.velocity, joint.effort, joint.damping or math.inf, joint.armature or math.inf)
        table.add_row(name, _kind(joint, mechanism), _range(joint), *map(_number, numbers))
    return table


def listed(scene: Scene, mechanism: Mechanism) -> list[tuple[str, str]]:
    """Return what else a file holds, as labels and texts."""
    tree, system = mechanism.tree, scene.model()
    inputs, outputs = (
        ", ".join(f"{each.name} ({each.unit})" for each in quantities) for quantities in (system.inputs, system.outputs)
    )
    limits = [f"{limit.quantity} {_interval(limit.bound, limit.upper)} {limit.unit}" for limit in scene.limits]
    rows = [
        ("frames", ", ".join([*tree.body, *tree.frames])),
        ("inputs", inputs),
        ("outputs", outputs),
        ("limits", ", ".join(limits) or "none"),
    ]
    return rows + [("left out", each) for each in mechanism.left_out]


def _kind(joint: Joint, mechanism: Mechanism) -> str:
    options = mechanism.options
    if joint.mimic:
        return f"mimics {joint.mimic[0]}"
    marks = [mark for mark in ("locked", "passive") if joint.name in getattr(options, mark)]
    return " ".join([*marks, *(["elastic"] if joint.name in options.elastic else []), joint.kind])


def _range(joint: Joint) -> str:
    return "" if math.isinf(joint.lower) and math.isinf(joint.upper) else _interval(joint.lower, joint.upper)


def _interval(low: float, high: float) -> str:
    return f"{low:.4g}..{high:.4g}"


def _number(value: float) -> str:
    return "" if math.isinf(value) else f"{value:.4g}"
