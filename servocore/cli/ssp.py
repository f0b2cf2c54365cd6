"""The command ``servocore ssp``: trajectory, inverse model and plant of a scene as one system."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from servocore.cli.console import PatientProgress
from servocore.cli.export import Component
from servocore.cli.options import Certified, GivenPath, Platforms, Subject, output
from servocore.errors import require_package
from servocore.export.fmu import export_ssp

EXAMPLES = ("overhead_crane -o crane.ssp", "cars --from 1 --to 3 --duration 4 -o cars.ssp")


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
        export_ssp(
            scene, file, fmi=component.fmi or 2, model=subject.model, targets=platforms.targets,
            host=component.host(), about=component.told(), progress=shown.describe,
        )  # fmt: skip
        shown.describe("proving the inputs")
        told = certified.line(scene, subject.model)
    print(f"{file}: trajectory, inverse model and plant of {scene.name}")
    print(*told, sep="\n", end="\n" * len(told), file=sys.stderr)
