"""The command ``servocore export``: a scene's inverse model as native FMU, C source or WebAssembly."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from servocore.cli.command import option
from servocore.cli.console import PatientProgress
from servocore.cli.kinds import FILE, FOLDER, Kind
from servocore.cli.options import GivenPath, Platforms, Subject, output
from servocore.errors import InvalidSetting, require_package
from servocore.export.building import METHOD, inverse_model
from servocore.export.c_source import export_c, require_folder
from servocore.export.cross_check import STEPS, cross_check_files
from servocore.export.fmu import VERSIONS, export_fmu, export_plant, export_trajectory, require_built, require_version
from servocore.export.targets import chosen_targets, zig
from servocore.export.trajectory_model import TrajectoryOptions
from servocore.export.wasm import export_wasm, loader_beside, require_module
from servocore.files import made_folder, require_places, write_together
from servocore.formulations.reduced import Reduced
from servocore.model.scene import Scene
from servocore.solvers.solve import solve

EXAMPLES = (
    "rotary_crane -o crane.fmu",
    "my_module:my_scene -o mine.fmu --fmi 2 --targets host",
    "cars --parameters heavy.toml --c cars_source",
    "rotary_crane --wasm crane.wasm",
    "rotary_crane --plant -o plant.fmu",
    "rotary_crane --trajectory --from 5 0 -5 --to -2 2 -2 --duration 15 -o line.fmu",
)

NEWEST = VERSIONS[0]
_FMI = Kind("version of FMI", str(NEWEST), lambda text: require_version(int(text)))


@dataclass(frozen=True)
class Products:
    """What is exported, and where it goes."""

    title = "Results"

    output: Path | None = output("FILE.fmu", "The FMU to write.")
    fmi: int | None = option("--fmi", kind=_FMI, metavar="2|3", help=f"Version of FMI. Default: {NEWEST}.")
    cross_check: bool = option(
        "--cross-check", help="Write a run along the path, or the scene's own, beside the FMU: _in.csv, _ref.csv."
    )
    c: Path | None = option("--c", kind=FOLDER, metavar="DIR", help="Write C source into this new folder as well.")
    wasm: Path | None = option(
        "--wasm", kind=FILE, metavar="FILE.wasm", help="Write a WebAssembly module with its loader in JavaScript as"
        " well.",
    )  # fmt: skip
    plant: bool = option("--plant", help="Export where the scene goes under its inputs instead.")
    trajectory: bool = option("--trajectory", help="Export a generator of paths for the scene instead.")

    @property
    def version(self) -> int:
        """Of FMI."""
        return NEWEST if self.fmi is None else self.fmi

    def require_consistent(self, path: GivenPath, targets: str | None) -> None:
        """Raise `InvalidSetting` if options exclude each other, or there is nothing to write."""
        if self.plant and self.trajectory:
            raise InvalidSetting("--plant and --trajectory are FMUs of their own: ask for one at a time")
        if path.options() and not (self.trajectory or self.cross_check):
            raise InvalidSetting(f"{path.options()[0]} belongs to --trajectory or --cross-check")
        other = "--plant" if self.plant else "--trajectory" if self.trajectory else ""
        inverse = _given({"--c": self.c, "--wasm": self.wasm, "--cross-check": self.cross_check})
        if inverse and other:
            raise InvalidSetting(f"{inverse} about inverse models: not with {other}")
        about = _given({"--fmi": self.fmi, "--targets": targets, "--cross-check": self.cross_check})
        if self.output is None and about:
            raise InvalidSetting(f"{about} about an FMU: name it with -o FILE.fmu")
        if not (self.output or inverse):
            more = "" if other else ", a folder for C source with --c DIR, or a module with --wasm FILE"
            raise InvalidSetting(f"name the file to write with -o FILE.fmu{more}")

    def require_apart(self) -> None:
        """Raise `InvalidSetting` if two results are to be in one place."""
        loader = None if self.wasm is None else loader_beside(self.wasm)
        require_places({"--output": self.output, "--wasm": self.wasm, "the loader of --wasm": loader})
        for name, file in (("--output", self.output), ("--wasm", self.wasm)):
            if file is not None and self.c is not None and file.resolve() == self.c.resolve():
                raise InvalidSetting(f"{name} and --c both name {file}")


def export_scene(subject: Subject, path: GivenPath, products: Products, platforms: Platforms) -> None:
    """Export the inverse model of a scene for tools without Python.

    The FMU is native: it needs no Python and no other library. Its inputs are the path and the derivatives that the
    scene needs, its outputs the inputs of the mechanical system and what its model observes. Scenes whose internal
    dynamics are unstable are refused. With --plant it is the forward dynamics that is exported, with --trajectory a
    generator of the path and its derivatives, which carries the path of --reference, --waypoints or --from and --to.

    With --cross-check the run goes along that path.
    """
    targets = platforms.targets
    products.require_consistent(path, targets)
    require_package("jinja2")
    if products.output is not None:
        chosen_targets(targets, products.version)
    scene = subject.chosen()
    products.require_apart()
    if products.output is not None:
        require_built(products.output, targets, products.version)
    if products.wasm is not None:
        require_module(products.wasm)
    if products.c is not None:
        require_folder(scene, products.c)
    with PatientProgress("exporting") as progress:
        _export(scene, subject.model, path, products, targets, progress.describe)
    _told(scene, products, targets)


def _export(
    scene: Scene,
    model: str | None,
    path: GivenPath,
    products: Products,
    targets: str | None,
    progress: Callable[[str], None],
) -> None:
    """Export what is wanted; of an inverse model nothing is in its place before all is made."""
    file, c, wasm = products.output, products.c, products.wasm
    if file is not None and products.plant:
        export_plant(scene, file, fmi=products.version, model=model, targets=targets, progress=progress)
        return
    if file is not None and products.trajectory:
        options = TrajectoryOptions(path.path(scene, model))
        export_trajectory(scene, file, options, fmi=products.version, model=model, targets=targets, progress=progress)
        return
    scene, results = path.along(scene, model), dict[Path, str | bytes]()
    with ExitStack() as folders:
        made = Path(folders.enter_context(TemporaryDirectory(prefix="servocore_")))
        if file is not None and products.cross_check:
            progress("solving")
            solution = solve(scene, Reduced(), METHOD, step=scene.reference.duration / STEPS, model=model)
            texts = cross_check_files(scene, inverse_model(scene, model), solution, file.stem)
            results |= {file.parent / name: text for name, text in texts.items()}
        if file is not None:
            fmu = export_fmu(
                scene, made / file.name, fmi=products.version, model=model, targets=targets, progress=progress
            )
            results[file] = fmu.read_bytes()
        if c is not None:
            sources = export_c(scene, made / "c", model=model)
            results |= {c / each.name: each.read_bytes() for each in sources.iterdir()}
            folders.enter_context(made_folder(c, c))
        if wasm is not None:
            progress("compiling to WebAssembly")
            export_wasm(scene, made / wasm.name, model=model)
            results |= {place: (made / place.name).read_bytes() for place in (wasm, loader_beside(wasm))}
        write_together(results)


def _told(scene: Scene, products: Products, targets: str | None) -> None:
    """Say what was written."""
    what = "plant of " if products.plant else "trajectory of " if products.trajectory else ""
    if products.output is not None:
        print(f"{products.output}: {what}{scene.name}, FMI {products.version}{_noted(targets)}")
    if products.c is not None:
        print(f"{products.c}: C source of {scene.name}")
    if products.wasm is not None:
        print(f"{products.wasm}, {loader_beside(products.wasm)}: WebAssembly of {scene.name}")


def _given(options: Mapping[str, object]) -> str:
    """Return those options that are given as the subject of a sentence, with its verb; empty without one."""
    names = [name for name, value in options.items() if value]
    if not names:
        return ""
    *most, last = names
    return f"{', '.join(most)} and {last} are" if most else f"{last} is"


def _noted(targets: str | None) -> str:
    return "" if targets is not None or zig() else "; for this machine only: pip install 'servocore[native]' for others"
