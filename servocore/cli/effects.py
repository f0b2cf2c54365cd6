"""The command ``servocore effects``: the tracking errors by neglected physical effects, as table, page and verdict."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from servocore.cli.command import option
from servocore.cli.console import PatientProgress, table_console
from servocore.cli.kinds import FILE, NUMBER, quantity, text
from servocore.cli.options import GivenPath, Subject
from servocore.effects.position_loops import PositionLoops
from servocore.effects.study import effects
from servocore.errors import InvalidSetting
from servocore.files import write_together
from servocore.model.parameter_files import read_parameters
from servocore.model.units import unit_of

EXAMPLES = (
    "rotary_crane",
    "overhead_crane --deviation 20mm --bandwidth 3 --parameters crane.toml",
    "gantry_crane --open-loop --simulate --markdown effects.md",
)


@dataclass(frozen=True)
class Question:
    """Allowed tracking error, and the plant."""

    title = "Effects"

    deviation: str = option(
        "--deviation", kind=text("5mm"), metavar="LENGTH", default="5mm",
        help="Allowed tracking error of the load, with its unit. Default: 5mm.",
    )  # fmt: skip
    bandwidth: float | None = option(
        "--bandwidth", kind=NUMBER, metavar="W", help="Bandwidth of the drives' position loops (rad/s). Default: 6."
    )
    open_loop: bool = option("--open-loop", help="Drive the plant by the inputs alone, without position loops.")
    simulate: bool = option("--simulate", help="Simulate every plant, not only those whose error is hard to estimate.")
    markdown: Path | None = option("--markdown", kind=FILE, metavar="FILE.md", help="Write the table as a page too.")

    def loops(self) -> PositionLoops | None:
        """Return the position loops of the plant, None without any; raises `InvalidSetting` where options conflict."""
        if self.open_loop and self.bandwidth is not None:
            raise InvalidSetting("--open-loop excludes --bandwidth: there are no position loops")
        if self.open_loop:
            return None
        return PositionLoops() if self.bandwidth is None else PositionLoops(self.bandwidth)

    def allowed(self, unit: str) -> float:
        """Return the deviation in a unit; a bare number is refused, since 5 rarely means 5 m."""
        if not unit_of(self.deviation):
            raise InvalidSetting(f"--deviation {self.deviation} has no unit: write it as in --deviation 5mm")
        return quantity("--deviation", self.deviation, unit, "5mm")


def show_effects(subject: Subject, path: GivenPath, question: Question) -> None:
    """Estimate the tracking errors by neglected physical effects, and which may be neglected.

    Each row is an effect that the model neglects or includes: the tracking error of the load where the inputs of the
    model without it drive a plant with it. Errors are estimated from the inputs of both models, or simulated where
    the estimate is unreliable. The file of parameters may hold those of effects too.
    """
    if path.tolerance is not None and path.reference is None:
        raise InvalidSetting(
            "--tolerance belongs to --reference; the allowed tracking error is --deviation, as in"
            f" --deviation {path.tolerance}"
        )
    scene, loops = subject.driven(), question.loops()
    declared = scene.effects.parameters
    given = {} if subject.parameters is None else read_parameters(subject.parameters, scene, declared.values())
    own = scene.model().parameters.names
    scene = scene.with_parameters(**{name: value for name, value in given.items() if name in own})
    moved = path.along(scene)
    # A scene without effects is refused for that, whatever the unit of its outputs.
    allowed = question.allowed(moved.model().outputs[0].unit) if declared else 1.0
    with PatientProgress("estimating"):
        found = effects(
            moved,
            loops=loops,
            tolerance=allowed,
            parameters={name: value for name, value in given.items() if name not in own},
            simulate=question.simulate,
        )
    if question.markdown is not None:
        write_together({question.markdown: f"# Effects that {moved.name} may neglect\n\n{found.markdown()}"})
    table_console().print(str(found), markup=False, highlight=False, soft_wrap=True)
