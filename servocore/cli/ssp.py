"""The command ``servocore ssp``: trajectory, inverse model and plant of a scene as one system."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from servocore.cli.command import option
from servocore.cli.console import PatientProgress
from servocore.cli.kinds import FILE_READ
from servocore.cli.options import Certified, GivenPath, Platforms, Subject, output
from servocore.errors import require_package
from servocore.export.about import About
from servocore.export.scene_system import export_ssp

EXAMPLES = ("overhead_crane -o crane.ssp", "cars --from 1 --to 3 --duration 4 -o cars.ssp")


@dataclass(frozen=True)
class Results:
    """The file, and what its FMUs tell of their maker."""

    title = "Results"

    output: Path | None = output("FILE.ssp", "The system to write. Default: SCENE.ssp.")
    about: Path | None = option(
        "--about", kind=FILE_READ, metavar="FILE.toml",
        help="Version, author, licence, icon and more of the FMU's maker, by the keys of servocore.About.",
    )  # fmt: skip


def export_system(
    subject: Subject, path: GivenPath, results: Results, platforms: Platforms, certified: Certified
) -> None:
    """Export trajectory, inverse model and plant of a scene as FMUs that are connected: feedforward in one file.

    The system is of SSP 1.0, its FMUs are native and of FMI 2. The object follows the given path, or that of the scene;
    nothing has to be set in the tool. The verdict of the certificate, a proof that the inputs hold at all times of the
    path, is printed on the error stream. Without --targets the FMUs have libraries for all platforms if the package
    ziglang is installed, else for this machine. For the rotary crane with feedback use crane-fmu ssp.
    """
    require_package("jinja2")
    scene = path.along(subject.chosen(), subject.model)
    about = About.from_toml(results.about) if results.about is not None else None
    file = results.output or Path(f"{scene.name}.ssp")
    with PatientProgress("exporting") as shown:
        export_ssp(scene, file, model=subject.model, targets=platforms.targets, about=about, progress=shown.describe)
        shown.describe("proving the inputs")
        told = certified.line(scene, subject.model)
    print(f"{file}: trajectory, inverse model and plant of {scene.name}")
    print(*told, sep="\n", end="\n" * len(told), file=sys.stderr)
