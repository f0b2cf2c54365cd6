"""The command ``servocore``: list, import, analyse, invert, plan and export scenes."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import rich.box
import rich.table
from rich.markup import escape

from servocore.analysis import analyse
from servocore.cli import (
    export,
    feedforward,
    identification,
    plan,
    studies,
    sweep,
    view,
)
from servocore.cli.command import Command, option
from servocore.cli.console import CommandLine, advised_here, table_console
from servocore.cli.kinds import choice
from servocore.cli.options import Subject
from servocore.errors import InvalidSetting
from servocore.importers.assembly import Assembly
from servocore.importers.from_file import SUFFIXES
from servocore.model.scene import Scene
from servocore.numerics.code_cache import FOLDER, MOST_BYTES, CodeCache
from servocore.scenes import REGISTRY

NAME = "servocore"
IMPORT_EXAMPLES = (
    "ur5.urdf",
    "ur5.urdf --elastic 1e4 --motor-inertia 0.3",
    "crane.xml --import settings.toml",
)
_INDENT = 22  # where the second column of a printed analysis begins


def list_scenes() -> None:
    """List all scenes: description, models (smallest first), inputs, and the outputs that follow the path."""
    table = rich.table.Table(box=rich.box.SIMPLE_HEAD, pad_edge=False, padding=(0, 2, 1, 0))
    table.add_column("scene", no_wrap=True)
    for heading in ("models", "inputs", "outputs"):
        table.add_column(heading)
    table.add_column("description and requirements", ratio=1)
    for name, factory in REGISTRY.items():
        scene = factory()
        model = scene.model()
        ends = ["\n".join(f"{e.name} ({e.unit})" for e in group) for group in (model.inputs, model.outputs)]
        summary, data = described(factory)
        table.add_row(
            name,
            "\n".join(scene.models),
            *ends,
            f"{escape(summary)}\n[dim]{escape(data)}[/dim]" if data else escape(summary),
        )
    table_console().print(table)


def described(factory: Callable[[], Scene]) -> tuple[str, str]:
    """Return the first line of the file of a scene, and its sentence "Data of the scene: ...", empty without one."""
    text = inspect.getdoc(inspect.getmodule(factory)) or ""
    summary = text.partition("\n")[0]
    data = re.search(r"Data of the scene: (.*?(?<!\.)\.)(?:\s|$)", text, re.DOTALL)
    return summary, " ".join(f"data: {data[1]}".replace("``", "").split()) if data else ""


def analyse_scene(subject: Subject) -> None:
    """Analyse the problem of a scene, before anything is solved.

    Prints index, internal dynamics with their eigenvalues, classification, transformations of the equations, the
    condition of the system Jacobian along the default path, the number of differentiations of each equation, and a
    recommendation. For a singular problem the reason and the time are printed (exit code 0).
    """
    report = advised_here(str(analyse(subject.chosen(), model=subject.model)))
    console = table_console()
    if console.is_terminal:
        report = "\n".join(hanging(line, console.width) for line in report.splitlines())
    console.print(report, markup=False, highlight=False, soft_wrap=True)


def hanging(line: str, width: int) -> str:
    """Wrap a line of a printed analysis within its second column."""
    return textwrap.fill(line, max(width, 2 * _INDENT), subsequent_indent=" " * _INDENT, break_on_hyphens=False) or line


def import_file(subject: Subject) -> None:
    """Print what is read from a URDF, MJCF or SDF file, and the analysis of its problem.

    Joints with limits, frames, inputs and outputs, limits that are kept, and the elements of the file that have no part
    in the model. The analysis is that of servocore analyse, along a short line from the posture.
    """
    if Path(subject.scene).suffix.lower() not in SUFFIXES:
        raise InvalidSetting(f"{subject.scene} is no robot file: its name ends in {', '.join(SUFFIXES)}")
    scene = subject.chosen()
    mechanism = scene.models[scene.default_model]
    assert isinstance(mechanism, Assembly)
    console = table_console()
    for label, text in listed(scene, mechanism):
        console.print(f"  {label:<20}{text}", markup=False, highlight=False, soft_wrap=True)
    report = advised_here(str(analyse(scene, model=subject.model)))
    console.print(report, markup=False, highlight=False, soft_wrap=True)


def listed(scene: Scene, mechanism: Assembly) -> list[tuple[str, str]]:
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


@dataclass(frozen=True)
class Action:
    """Action on the cache."""

    title = "Cache"

    clear: bool = option(
        kind=choice("action", {"clear": True}), metavar="[clear]", default=False,
        help="Clear the cache; without this word it is described.",
    )  # fmt: skip


def show_cache(action: Action) -> None:
    """Print place and size of the compiled machine code, or remove it.

    Removed code is compiled again when it is needed. The folder is the user's cache folder, or the one in the
    environment variable SERVOCORE_CACHE.
    """
    kept = CodeCache.of_user()
    if refusal := kept.refusal():
        raise InvalidSetting(f"no machine code is kept: {refusal}; set {FOLDER} to another folder")
    if action.clear:
        count, size = kept.clear()
        where = f"removed from {kept.folder}"
    else:
        found = kept.contents()
        count, size = len(found), sum(file.stat().st_size for file in found)
        where = f"of at most {MOST_BYTES / 1e6:.3g} MB in {kept.folder}"
    libraries = "library" if count == 1 else "libraries"
    table_console().print(f"{count} {libraries} of machine code with {size / 1e6:.3g} MB {where}", soft_wrap=True)


app = CommandLine(
    NAME,
    "Inverse dynamics of underactuated mechanical systems by servo constraints.\n\nThe commands analyse scenes of the"
    " library or your own, compute feedforward inputs for a prescribed path, plan time-optimal trajectories, and export"
    " inverse models for other tools.",
    [
        Command("scenes", list_scenes),
        Command("analyse", analyse_scene, ("rotary_crane", "mass_on_car --model points --parameters heavy.toml")),
        Command("import", import_file, IMPORT_EXAMPLES),
        Command("feedforward", feedforward.feed_forward, feedforward.EXAMPLES),
        Command("plan", plan.plan_motion, plan.EXAMPLES, plan.FIXED),
        Command("sensitivities", studies.show_sensitivities, studies.SENSITIVITIES_EXAMPLES, studies.FIXED),
        Command("sweep", sweep.sweep_scene, sweep.EXAMPLES),
        Command("effects", studies.show_effects, studies.EFFECTS_EXAMPLES, {"model": None}),
        Command("drives", studies.show_drives, studies.DRIVES_EXAMPLES),
        Command("identify", identification.identify_scene, identification.EXAMPLES, {"model": None}),
        Command("excite", identification.excite_scene, identification.EXCITE_EXAMPLES, {"model": None}),
        Command("view", view.view_scene, view.EXAMPLES),
        Command("export", export.export_scene, export.EXAMPLES),
        Command("ssp", export.export_system, export.SSP_EXAMPLES),
        Command("cache", show_cache, ("", "clear")),
    ],
)
