"""The command ``import``: the contents of a robot file, and the analysis of its servo constraint problem."""

from __future__ import annotations

from pathlib import Path

from servocore.analysis import analyse
from servocore.cli.console import advised_here, table_console
from servocore.cli.options import Subject
from servocore.errors import InvalidSetting
from servocore.importers.assembly import Mechanism
from servocore.importers.from_file import SUFFIXES
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
    for label, text in listed(scene, mechanism):
        console.print(f"  {label:<20}{text}", markup=False, highlight=False, soft_wrap=True)
    report = advised_here(str(analyse(scene, model=subject.model)))
    console.print(report, markup=False, highlight=False, soft_wrap=True)


def listed(scene: Scene, mechanism: Mechanism) -> list[tuple[str, str]]:
    """Return the contents of a file, as labels and texts."""
    tree, options, system = mechanism.tree, mechanism.options, scene.model()
    rows = list[tuple[str, str]]()
    for joint in tree.joints.values():
        marks = [mark for mark in ("locked", "passive", "elastic") if joint.name in getattr(options, mark)]
        marks += [f"mimics {joint.mimic[0]}"] if joint.mimic else []
        rows.append(("joint", f"{joint.name}: {' '.join([*marks, joint.kind])}"))
    rows.append(("frames", ", ".join(tree.body)))
    for label, quantities in (("inputs", system.inputs), ("outputs", system.outputs)):
        rows.append((label, ", ".join(f"{each.name} ({each.unit})" for each in quantities)))
    rows += [("limit", f"{each.quantity} {each.bound:.4g}..{each.upper:.4g} {each.unit}") for each in scene.limits]
    return rows + [("left out", each) for each in mechanism.left_out]
