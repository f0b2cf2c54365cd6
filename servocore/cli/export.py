"""The command ``servocore export``: a scene's inverse model as native FMU or as C source."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from servocore.cli.chosen_scene import GivenPath, chosen
from servocore.cli.console import PatientProgress
from servocore.cli.options import Model, Parameters, SceneName, Tolerance, Waypoints
from servocore.errors import InvalidSetting, require_package
from servocore.export.building import METHOD, inverse_model
from servocore.export.c_source import export_c, require_folder
from servocore.export.cross_check import STEPS, cross_check_files
from servocore.export.fmu import VERSIONS, export_fmu, export_plant, export_trajectory, require_built, require_version
from servocore.export.targets import HOST, TARGETS, chosen_targets, zig
from servocore.export.trajectory_model import TrajectoryWishes
from servocore.export.wasm import export_wasm, loader_beside, require_module
from servocore.files import made_folder, require_places, write_together
from servocore.formulations.reduced import Reduced
from servocore.model.scene import Scene as SceneValue
from servocore.solvers.solve import solve

EXAMPLES = """[bold]Examples[/bold]

[cyan]servocore export rotary_crane -o crane.fmu[/cyan]

[cyan]servocore export my_module:my_scene -o mine.fmu --fmi 2 --targets host[/cyan]

[cyan]servocore export cars --parameters heavy.toml --c cars_source[/cyan]

[cyan]servocore export rotary_crane --wasm crane.wasm[/cyan]

[cyan]servocore export rotary_crane --plant -o plant.fmu[/cyan]
"""

NEWEST = VERSIONS[0]

Output = Annotated[Path | None, typer.Option("-o", "--output", metavar="FILE.fmu", help="The FMU to write.")]
Version = Annotated[int | None, typer.Option("--fmi", metavar="2|3", help=f"Version of FMI. Default: {NEWEST}.")]
Targets = Annotated[
    str | None,
    typer.Option(
        "--targets", metavar="LIST",
        help=f"all, {HOST}, or some of {', '.join(TARGETS)}, with commas. Default: all with the package ziglang, else"
        f" {HOST}.",
    ),
]  # fmt: skip
CrossCheck = Annotated[
    bool,
    typer.Option("--cross-check", help="Write a run along the scene's own path beside it: _in.csv, _ref.csv."),
]
Folder = Annotated[
    Path | None, typer.Option("--c", metavar="DIR", help="Write C source for other hosts into this new folder as well.")
]
PlantWanted = Annotated[bool, typer.Option("--plant", help="Export where the scene goes under its inputs instead.")]
TrajectoryWanted = Annotated[
    bool, typer.Option("--trajectory", help="Export a generator of paths for the scene instead.")
]
CarriedPath = Annotated[
    Path | None, typer.Option("--reference", metavar="FILE.csv", help="A path that --trajectory shall carry.")
]
Module = Annotated[
    Path | None,
    typer.Option(
        "--wasm", metavar="FILE.wasm", help="Write a WebAssembly module with its loader in JavaScript as well."
    ),
]


def export_scene(
    scene: SceneName,
    output: Output = None,
    fmi: Version = None,
    model: Model = None,
    parameters: Parameters = None,
    targets: Targets = None,
    cross_check: CrossCheck = False,
    c: Folder = None,
    wasm: Module = None,
    plant: PlantWanted = False,
    trajectory: TrajectoryWanted = False,
    reference: CarriedPath = None,
    tolerance: Tolerance = None,
    waypoints: Waypoints = None,
) -> None:
    """Export the inverse model of a scene for tools without Python.

    The FMU is native: it needs no Python and no other library. Its inputs are
    the path and the derivatives that the scene needs, its outputs the inputs of
    the mechanical system and what its model observes. Scenes whose internal
    dynamics are unstable are refused. With --plant it is the forward dynamics that
    is exported, with --trajectory a generator of the path and its derivatives.
    """
    carried, version = GivenPath(reference, waypoints, tolerance), NEWEST if fmi is None else require_version(fmi)
    if plant or trajectory or carried.option():
        _require_one(plant, trajectory, carried, {"--c": c, "--wasm": wasm, "--cross-check": cross_check or None})
        _require_named(output)
        _export_beside(scene, plant, (output, parameters, carried), version, model, targets)
        return
    _require_fmu(output, {"--fmi": fmi, "--targets": targets, "--cross-check": cross_check or None}, c or wasm)
    subject = _possible(scene, parameters, {"--output": output, "--c": c, "--wasm": wasm}, version, targets)
    with PatientProgress("exporting") as progress, ExitStack() as folders:
        made = Path(folders.enter_context(TemporaryDirectory(prefix="servocore_")))
        results: dict[Path, str | bytes] = {}  # none is in its place before all are made
        if output is not None and cross_check:
            progress.describe("solving")
            solution = solve(subject, Reduced(), METHOD, step=subject.reference.duration / STEPS, model=model)
            texts = cross_check_files(subject, inverse_model(subject, model), solution, output.stem)
            results |= {output.parent / name: text for name, text in texts.items()}
        if output is not None:
            fmu = export_fmu(
                subject, made / output.name, fmi=version, model=model, targets=targets, tell=progress.describe
            )
            results[output] = fmu.read_bytes()
        if c is not None:
            sources = export_c(subject, made / "c", model=model)
            results |= {c / file.name: file.read_bytes() for file in sources.iterdir()}
            folders.enter_context(made_folder(c, c))
        if wasm is not None:
            progress.describe("compiling to WebAssembly")
            export_wasm(subject, made / wasm.name, model=model)
            results |= {place: (made / place.name).read_bytes() for place in (wasm, loader_beside(wasm))}
        write_together(results)
    _told(subject, output, version, targets, c, wasm)


def _told(
    subject: SceneValue, output: Path | None, fmi: int, targets: str | None, c: Path | None, wasm: Path | None
) -> None:
    """Say what was written."""
    if output is not None:
        print(f"{output}: {subject.name}, FMI {fmi}{_noted(targets)}")
    if c is not None:
        print(f"{c}: C source of {subject.name}")
    if wasm is not None:
        print(f"{wasm}, {loader_beside(wasm)}: WebAssembly of {subject.name}")


def _require_fmu(output: Path | None, about: Mapping[str, object | None], beside: Path | None) -> None:
    """Raise `InvalidSetting` without a file to write, or where options are about an FMU and none is wanted."""
    given = _given(about)
    if output is None and given:
        raise InvalidSetting(f"{given} about an FMU: name it with -o FILE.fmu")
    if output is None and beside is None:
        raise InvalidSetting(
            "name the file to write with -o FILE.fmu, a folder for C source with --c DIR, or a module with --wasm FILE"
        )


def _given(options: Mapping[str, object | None]) -> str:
    """Return those options that are given as the subject of a sentence, with its verb; empty without one."""
    names = [name for name, value in options.items() if value is not None]
    if not names:
        return ""
    *most, last = names
    return f"{', '.join(most)} and {last} are" if most else f"{last} is"


def _possible(
    scene: str, parameters: Path | None, results: Mapping[str, Path | None], fmi: int, targets: str | None
) -> SceneValue:
    """Return the scene, after a look at all that can be refused before the work."""
    output, c, wasm = results.values()
    require_package("jinja2")
    if output is not None:
        chosen_targets(targets, fmi)
    subject = chosen(scene, parameters)
    loader = None if wasm is None else loader_beside(wasm)
    require_places({"--output": output, "--wasm": wasm, "the loader of --wasm": loader}, [parameters])
    _require_apart(output, wasm, c)
    if output is not None:
        require_built(output, targets, fmi)
    if wasm is not None:
        require_module(wasm)
    if c is not None:
        require_folder(subject, c)
    return subject


def _require_apart(output: Path | None, wasm: Path | None, folder: Path | None) -> None:
    """Raise `InvalidSetting` if a file is to be where a folder is to be."""
    for option, file in (("--output", output), ("--wasm", wasm)):
        if file is not None and folder is not None and file.resolve() == folder.resolve():
            raise InvalidSetting(f"{option} and --c both name {file}")


def _require_one(plant: bool, trajectory: bool, carried: GivenPath, others: Mapping[str, object | None]) -> None:
    """Raise `InvalidSetting` if options do not go with --plant or --trajectory."""
    if plant and trajectory:
        raise InvalidSetting("--plant and --trajectory are FMUs of their own: ask for one at a time")
    if carried.option() and not trajectory:
        raise InvalidSetting(f"{carried.option()} belongs to --trajectory")
    given = _given(others)
    if given:
        raise InvalidSetting(f"{given} about inverse models: not with {'--plant' if plant else '--trajectory'}")


def _require_named(output: Path | None) -> None:
    """Raise `InvalidSetting` if there is no file to write."""
    if output is None:
        raise InvalidSetting("name the file to write with -o FILE.fmu")


def _export_beside(
    scene: str, plant: bool, files: tuple[Path | None, Path | None, GivenPath], fmi: int, model: str | None,
    targets: str | None,
) -> None:  # fmt: skip
    """Export plant or trajectory, what an inverse model stands between."""
    output, parameters, carried = files
    if output is None:
        return
    require_package("jinja2")
    require_built(output, targets, fmi)
    subject = chosen(scene, parameters)
    require_places({"--output": output}, [parameters, carried.reference, carried.waypoints])
    with PatientProgress("exporting") as progress:
        if plant:
            export_plant(subject, output, fmi=fmi, model=model, targets=targets, tell=progress.describe)
        else:
            path = carried.path(subject, model)
            export_trajectory(
                subject, output, TrajectoryWishes(path), fmi=fmi, model=model, targets=targets, tell=progress.describe
            )
    print(f"{output}: {'plant' if plant else 'trajectory'} of {subject.name}, FMI {fmi}{_noted(targets)}")


def _noted(targets: str | None) -> str:
    return "" if targets is not None or zig() else "; for this machine only: pip install 'servocore[native]' for others"
