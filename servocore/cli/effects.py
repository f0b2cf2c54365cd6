"""The command ``servocore effects``: which physical effects a scene may leave out, as table, page and verdict."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from servocore.cli.chosen_scene import chosen_scene
from servocore.cli.command import option
from servocore.cli.console import PatientProgress, table_console
from servocore.cli.kinds import FILE, NUMBER, quantity, text
from servocore.cli.options import GivenPath, Subject
from servocore.effects.position_loops import PositionLoops
from servocore.effects.study import effects
from servocore.errors import InvalidSetting
from servocore.files import write_together
from servocore.model.parameter_files import read_parameters

EXAMPLES = (
    "rotary_crane",
    "overhead_crane --deviation 20mm --bandwidth 3 --parameters crane.toml",
    "gantry_crane --open-loop --simulate --markdown effects.md",
)


@dataclass(frozen=True)
class Question:
    """What is asked of effects."""

    title = "Effects"

    deviation: str = option(
        "--deviation", kind=text("5mm"), metavar="LENGTH", default="5mm",
        help="How far the load may be off its path, with its unit. Default: 5mm.",
    )  # fmt: skip
    bandwidth: float | None = option(
        "--bandwidth", kind=NUMBER, metavar="W", help="Bandwidth of the drives' position loops (rad/s). Default: 6."
    )
    open_loop: bool = option("--open-loop", help="Inputs alone drive the plant, without position loops.")
    simulate: bool = option("--simulate", help="Simulate every plant, instead of those hard to estimate.")
    markdown: Path | None = option("--markdown", kind=FILE, metavar="FILE.md", help="Write the table as a page too.")

    def loops(self) -> PositionLoops | None:
        """Return the position loops of the plant, None without any; raises `InvalidSetting` where options conflict."""
        if self.open_loop and self.bandwidth is not None:
            raise InvalidSetting("--open-loop excludes --bandwidth: there are no position loops")
        if self.open_loop:
            return None
        return PositionLoops() if self.bandwidth is None else PositionLoops(self.bandwidth)

    def allowed(self, unit: str) -> float:
        """Return the deviation in a unit; a bare number is refused, since few who write 5 mean metres."""
        try:
            float(self.deviation)
        except ValueError:
            return quantity("--deviation", self.deviation, unit, "5mm")
        raise InvalidSetting(f"--deviation {self.deviation} is without its unit: write it as in --deviation 5mm")


def show_effects(subject: Subject, path: GivenPath, question: Question) -> None:
    """Say which physical effects a scene may leave out, and what that costs.

    Each row is an effect that the scene lacks, or has and may do without: how far off its path the load goes where the
    inputs of the model without it drive a plant with it. Errors are estimated from the inputs of both models, or
    simulated where that is weak. The file of parameters may hold those of effects too.
    """
    if path.tolerance is not None and path.reference is None:
        raise InvalidSetting(
            "--tolerance belongs to --reference; how far the load may be off its path is --deviation, as in"
            f" --deviation {path.tolerance}"
        )
    scene, loops = chosen_scene(subject.scene), question.loops()
    declared = scene.effects.parameters
    file = subject.parameters
    given = {} if file is None else read_parameters(file, scene, declared.values())
    own = scene.model().parameters.names
    scene = scene.with_parameters(**{name: value for name, value in given.items() if name in own})
    moved = path.along(scene)
    allowed = question.allowed(moved.model().outputs[0].unit)
    with PatientProgress("estimating"):
        found = effects(
            moved,
            loops=loops,
            tolerance=allowed,
            parameters={name: value for name, value in given.items() if name not in own},
            simulate=question.simulate,
        )
    if question.markdown is not None:
        write_together({question.markdown: f"# What {moved.name} may leave out\n\n{found.markdown()}"})
    table_console().print(str(found), markup=False, highlight=False, soft_wrap=True)
