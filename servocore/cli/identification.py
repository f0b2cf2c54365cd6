"""The commands ``servocore identify`` and ``servocore excite``: parameters from logs, and paths that show them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from servocore.cli.command import option
from servocore.cli.console import PatientProgress, table_console
from servocore.cli.kinds import FILE, FILE_READ, NUMBER, SEED, TIME, quantity, text
from servocore.cli.options import GivenLimits, GivenPath, Subject, output
from servocore.effects.position_loops import PositionLoops
from servocore.errors import InvalidSetting
from servocore.files import write_together
from servocore.identification.excitation import excitation
from servocore.identification.identify import UNCERTAINTY, identify
from servocore.identification.page import identified_page
from servocore.model.scene import Scene
from servocore.references.csv_file import path_to_csv

EXAMPLES = (
    "rotary_crane log.csv --estimate load_mass,trolley_mass,*_friction --effects friction --output crane.toml",
    "overhead_crane a.csv b.csv --estimate load_mass --uncertainty 10% --job job.csv --page identified.html",
)
EXCITE_EXAMPLES = ("rotary_crane --estimate load_mass,bridge_inertia --limit F=60 --limit M_b=1000 -o path.csv",)


@dataclass(frozen=True)
class Estimated:
    """Parameters to be identified."""

    title = "Identification"

    estimate: str | None = option(
        "--estimate", kind=text("load_mass,*_friction"), metavar="NAMES",
        help="Parameters to be identified, separated by commas; * stands for any letters.",
    )  # fmt: skip
    effects: str | None = option(
        "--effects", kind=text("friction"), metavar="NAMES",
        help="Effects that the model has beside those of the scene, separated by commas.",
    )  # fmt: skip
    uncertainty: str | None = option(
        "--uncertainty", kind=text("20%"), metavar="SHARE",
        help=f"Relative standard uncertainty of the scene's values. Default: {UNCERTAINTY:.0%}.",
    )  # fmt: skip

    def names(self) -> list[str]:
        """Return the parameters or patterns; raises `InvalidSetting` without any."""
        if self.estimate is None:
            raise InvalidSetting("--estimate says which parameters: write it as in --estimate load_mass,*_friction")
        return _split(self.estimate)

    def believed(self) -> float:
        """Return the uncertainty as a fraction."""
        return UNCERTAINTY if self.uncertainty is None else quantity("--uncertainty", self.uncertainty, "1", "20%")


@dataclass(frozen=True)
class Logs:
    """Logs, jobs and results."""

    title = "Logs"

    logs: tuple[Path, ...] = option(
        kind=FILE_READ, metavar="LOG.csv...", default=(),
        help="Tables with the columns time, the inputs and measured positions by name, units in brackets: phi [deg].",
    )  # fmt: skip
    job: tuple[Path, ...] = option(
        "--job", kind=FILE_READ, metavar="PATH.csv", default=(),
        help="A path that the load shall follow: states how far it will go off.",
    )  # fmt: skip
    bandwidth: float = option(
        "--bandwidth", kind=NUMBER, metavar="W", default=PositionLoops().bandwidth,
        help="Bandwidth of the drives' position loops on jobs (rad/s). Default: 6.",
    )  # fmt: skip
    output: Path | None = output("FILE.toml", "Parameters for --parameters of all commands; covariance beside it.")
    page: Path | None = option("--page", kind=FILE, metavar="FILE.html", help="Write a page with figures.")


@dataclass(frozen=True)
class Excited:
    """The path of an excitation."""

    title = "Path"

    duration: float = option("--duration", kind=TIME, metavar="T", default=20.0, help="Duration (s). Default: 20.")
    seed: int = option("--seed", kind=SEED, metavar="N", default=0, help="Seed of the random search. Default: 0.")
    output: Path | None = output("PATH.csv", "The path to write, for --reference of other commands.")


def identify_scene(subject: Subject, logs: Logs, estimated: Estimated) -> None:
    """Identify parameters of a scene from logs of its drives, with standard errors.

    Maximum likelihood on the flat output: biases and delays of the inputs are estimated too, and what the scene has
    counts as one more measurement with its uncertainty. The verdict says whether the model explains the logs, which
    combinations of parameters they do not show, and how far the load will go off the jobs.
    """
    if not logs.logs:
        raise InvalidSetting("identify needs a log: write it as in servocore identify rotary_crane log.csv")
    scene = _with_effects(subject, estimated)
    jobs = [GivenPath(reference=each).along(scene).reference for each in logs.job]
    with PatientProgress("identifying"):
        found = identify(
            scene, list(logs.logs), estimated.names(), believed=estimated.believed(), jobs=jobs,
            loops=PositionLoops(logs.bandwidth),
        )  # fmt: skip
        shown = str(found)
        contents: dict[Path, str | bytes] = {}
        if logs.output is not None:
            contents[logs.output] = found.parameter_file()
            contents[logs.output.with_suffix(".covariance.csv")] = found.covariance_file()
        if logs.page is not None:
            contents[logs.page] = identified_page(found)
    write_together(contents)
    table_console().print(shown, markup=False, highlight=False, soft_wrap=True)


def excite_scene(subject: Subject, limits: GivenLimits, estimated: Estimated, excited: Excited) -> None:
    """Find a path within limits whose log shows parameters best.

    The path starts and ends at rest; the limits are certified between instants, as of plans. The table compares
    predicted standard errors with those of the scene's own path.
    """
    scene = _with_effects(subject, estimated)
    with PatientProgress("searching"):
        path, report = excitation(
            scene, estimated.names(), limits.bounds(), duration=excited.duration, believed=estimated.believed(),
            seed=excited.seed,
        )  # fmt: skip
    if excited.output is not None:
        columns = [each.name for each in scene.model().outputs]
        write_together({excited.output: path_to_csv(path, columns)})
    table_console().print(str(report), markup=False, highlight=False, soft_wrap=True)


def _split(names: str) -> list[str]:
    return [name.strip() for name in names.split(",") if name.strip()]


def _with_effects(subject: Subject, estimated: Estimated) -> Scene:
    """Return the scene of a command with effects, and with the parameters of both."""
    scene, effects = subject.driven(), _split(estimated.effects or "")
    scene = scene.with_effects(*effects) if effects else scene
    return scene.with_parameters(**subject.changes(scene))
