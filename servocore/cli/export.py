"""The commands ``servocore export`` and ``servocore ssp``: native FMUs, C source, WebAssembly, systems of FMUs."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from servocore.cli.command import given_options, option
from servocore.cli.console import PatientProgress
from servocore.cli.kinds import COUNT, FILE, FILE_READ, FOLDER, Kind
from servocore.cli.options import Certified, GivenPath, Platforms, Subject, output
from servocore.errors import InvalidSetting, install, require_package
from servocore.export.about import About
from servocore.export.building import inverse_model
from servocore.export.c_source import export_c, require_folder
from servocore.export.fmu import (
    VERSIONS,
    export_fmu,
    export_plant,
    export_ssp,
    export_trajectory,
    require_built,
    require_version,
)
from servocore.export.inverse_functions import METHOD
from servocore.export.native_model import HostRules
from servocore.export.parameter_sets import STEPS, cross_check_files
from servocore.export.targets import zig
from servocore.export.trajectory_model import TrajectoryOptions
from servocore.export.wasm import LOADER, export_wasm, require_module
from servocore.files import made_folder, write_together
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

SSP_EXAMPLES = ("overhead_crane -o crane.ssp", "cars --from 1 --to 3 --duration 4 -o cars.ssp")

NEWEST = VERSIONS[0]
_FMI = Kind("version of FMI", str(NEWEST), lambda text: require_version(int(text)))


@dataclass(frozen=True)
class Component:
    """The standard of FMUs, their maker, and the rules of their hosts."""

    title = "FMUs"

    fmi: int | None = option(
        "--fmi", kind=_FMI, metavar="2|3", help=f"Version of FMI. Default: {NEWEST}, in a system 2, with SSP 1.0."
    )
    about: Path | None = option(
        "--about", kind=FILE_READ, metavar="FILE.toml",
        help="Version, author, licence, icon and more of the FMU's maker, by the keys of servocore.About.",
    )  # fmt: skip
    no_stdio: bool = option("--no-stdio", help="Call no function of <stdio.h>: messages have ? in place of numbers.")
    max_internal_steps: int | None = option(
        "--max-internal-steps", kind=COUNT, metavar="N",
        help=f"Refuse a communication step of more internal ones. Default: {HostRules.internal_steps}.",
    )  # fmt: skip

    def told(self) -> About | None:
        """Return the content of the file of the maker."""
        return About.from_toml(self.about) if self.about is not None else None

    def host(self) -> HostRules:
        """Return the rules of the hosts."""
        return HostRules(stdio=not self.no_stdio, internal_steps=self.max_internal_steps or HostRules.internal_steps)


@dataclass(frozen=True)
class Products:
    """Files to export."""

    title = "Results"

    output: Path | None = output("FILE.fmu", "The FMU to write.")
    cross_check: bool = option(
        "--cross-check",
        help="Write a run along the path, or that of the scene, beside the FMU and into it: _in.csv, _ref.csv.",
    )
    c: Path | None = option("--c", kind=FOLDER, metavar="DIR", help="Write C source into this new folder as well.")
    wasm: Path | None = option(
        "--wasm", kind=FILE, metavar="FILE.wasm", help="Write a WebAssembly module with its loader in JavaScript as"
        " well.",
    )  # fmt: skip
    plant: bool = option("--plant", help="Export the forward dynamics of the scene instead.")
    trajectory: bool = option("--trajectory", help="Export a trajectory generator for the scene instead.")

    def require_consistent(self, path: GivenPath, component: Component, platforms: Platforms) -> None:
        """Raise `InvalidSetting` if options exclude each other, or there is nothing to write."""
        if self.plant and self.trajectory:
            raise InvalidSetting("--plant and --trajectory are separate FMUs: export one at a time")
        if path.options() and not (self.trajectory or self.cross_check):
            raise InvalidSetting(f"{path.options()[0]} belongs to --trajectory or --cross-check")
        other = "--plant" if self.plant else "--trajectory" if self.trajectory else ""
        inverse = [flag for flag in ("--c", "--wasm", "--cross-check") if flag in given_options(self)]
        if inverse and other:
            raise InvalidSetting(f"{inverse[0]} is for inverse models: not with {other}")
        of_fmu = [*given_options(component), *given_options(platforms), *(["--cross-check"] * self.cross_check)]
        if self.output is None and of_fmu:
            raise InvalidSetting(f"{of_fmu[0]} belongs to an FMU: name it with -o FILE.fmu")
        if not (self.output or inverse):
            more = "" if other else ", a folder for C source with --c DIR, or a module with --wasm FILE"
            raise InvalidSetting(f"name the file to write with -o FILE.fmu{more}")


def export_scene(
    subject: Subject, path: GivenPath, products: Products, component: Component, platforms: Platforms,
    certified: Certified,
) -> None:  # fmt: skip
    """Export the inverse model of a scene for tools without Python.

    The FMU is native: it needs no Python and no other library. Its inputs are the path and its derivatives up to the
    required order, its outputs the inputs of the mechanical system and the observables. Scenes with unstable internal
    dynamics are refused. With --plant the forward dynamics is exported, with --trajectory a trajectory generator for
    the path of --reference, --waypoints or --from and --to. With --cross-check the run follows that path. The verdict
    of the certificate, a proof that the inputs hold at all times of that path, is printed on the error stream.

    Without --targets the FMU has libraries for all platforms if the package ziglang is installed, else for this
    machine.
    """
    targets = platforms.targets
    products.require_consistent(path, component, platforms)
    require_package("jinja2")
    file, fmi = products.output, NEWEST if component.fmi is None else component.fmi
    scene, model, kind = subject.chosen(), subject.model, ""
    if file is not None:
        require_built(file, targets, fmi)
    if products.wasm is not None:
        require_module(products.wasm)
    if products.c is not None:
        require_folder(scene, products.c)
    with PatientProgress("exporting") as shown:
        progress = shown.describe
        common: dict[str, Any] = {"fmi": fmi, "model": model, "targets": targets, "host": component.host(),
                                  "about": component.told(), "progress": progress}  # fmt: skip
        told = [] if products.plant else certified.line(path.along(scene, model), model, progress)
        if file is not None and products.plant:
            kind = "plant of "
            export_plant(scene, file, **common)
        elif file is not None and products.trajectory:
            kind = "trajectory of "
            export_trajectory(scene, file, TrajectoryOptions(path.path(scene, model)), **common)
        else:
            _export_inverse(path.along(scene, model), products, common)
    if file is not None:
        alone = "" if targets is not None or zig() else f"; for this machine only; for others {install('native')}"
        print(f"{file}: {kind}{scene.name}, FMI {fmi}{alone}")
    if products.c is not None:
        print(f"{products.c}: C source of {scene.name}")
    if products.wasm is not None:
        print(f"{products.wasm}, {products.wasm.with_suffix(LOADER)}: WebAssembly of {scene.name}")
    print(*told, sep="\n", end="\n" * len(told), file=sys.stderr)


def _export_inverse(scene: Scene, products: Products, common: Mapping[str, Any]) -> None:
    """Export an inverse model; no file is moved into its place before all are complete."""
    model, progress = common["model"], common["progress"]
    file, c, wasm = products.output, products.c, products.wasm
    results = dict[Path, str | bytes]()
    with ExitStack() as folders:
        made = Path(folders.enter_context(TemporaryDirectory(prefix="servocore_")))
        texts = dict[str, str]()
        if file is not None and products.cross_check:
            progress("solving")
            solution = solve(scene, Reduced(), METHOD, step=scene.reference.duration / STEPS, model=model)
            texts = cross_check_files(scene, inverse_model(scene, model), solution, file.stem, common["fmi"])
            results |= {file.parent / name: text for name, text in texts.items()}
        if file is not None:
            fmu = export_fmu(scene, made / file.name, cross_check=texts, **common)
            results[file] = fmu.read_bytes()
        if c is not None:
            sources = export_c(scene, made / "c", model=model)
            results |= {c / each.name: each.read_bytes() for each in sources.iterdir()}
            folders.enter_context(made_folder(c, c))
        if wasm is not None:
            progress("compiling to WebAssembly")
            export_wasm(scene, made / wasm.name, model=model)
            results |= {place: (made / place.name).read_bytes() for place in (wasm, wasm.with_suffix(LOADER))}
        write_together(results)


@dataclass(frozen=True)
class Results:
    """The file to write."""

    title = "Results"

    output: Path | None = output("FILE.ssp", "The system to write. Default: SCENE.ssp.")


def export_system(
    subject: Subject, path: GivenPath, results: Results, component: Component, platforms: Platforms,
    certified: Certified,
) -> None:  # fmt: skip
    """Export trajectory, inverse model and plant of a scene as FMUs that are connected: feedforward in one file.

    FMUs are native, of FMI 2 in a system of SSP 1.0, or of FMI 3 in one of SSP 2.0. The object follows the given path,
    or that of the scene; nothing has to be set in the tool. The verdict of the certificate, a proof that the inputs
    hold at all times of the path, is printed on the error stream. Without --targets the FMUs have libraries for all
    platforms if the package ziglang is installed, else for this machine. For the rotary crane with feedback use
    crane-fmu ssp.
    """
    require_package("jinja2")
    scene = path.along(subject.chosen(), subject.model)
    file = results.output or Path(f"{scene.name}.ssp")
    with PatientProgress("exporting") as shown:
        told = certified.line(scene, subject.model, shown.describe)  # first: an interruption then leaves no file
        export_ssp(
            scene, file, fmi=component.fmi or 2, model=subject.model, targets=platforms.targets,
            host=component.host(), about=component.told(), progress=shown.describe,
        )  # fmt: skip
    print(f"{file}: trajectory, inverse model and plant of {scene.name}")
    print(*told, sep="\n", end="\n" * len(told), file=sys.stderr)
