"""Studies of a scene along its path: the commands ``servocore effects``, ``drives`` and ``sensitivities``.

Tracking errors by neglected physical effects; the duty of every motor and its margins; sensitivities of inputs and
load to the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from servocore.cli.command import option
from servocore.cli.console import PatientProgress, table_console
from servocore.cli.kinds import FILE, NUMBER, quantity, text
from servocore.cli.options import GivenPath, Rows, Subject, Table
from servocore.effects.position_loops import PositionLoops
from servocore.effects.report import aligned
from servocore.effects.study import effects
from servocore.errors import InvalidSetting
from servocore.files import write_together
from servocore.model.limits import RunQuantity
from servocore.model.parameter_files import read_parameters
from servocore.numerics.units import behind, unit_of
from servocore.planning.sensitivities import Sensitivities, sensitivities
from servocore.solvers.solve import solve

EFFECTS_EXAMPLES = (
    "rotary_crane",
    "overhead_crane --deviation 20mm --bandwidth 3 --parameters crane.toml",
    "gantry_crane --open-loop --simulate --markdown effects.md",
)
DRIVES_EXAMPLES = ("overhead_crane --drives drives.toml --from 0 -6 --to 6 -4 --duration 45",)
SENSITIVITIES_EXAMPLES = ("rotary_crane", "overhead_crane --wrt load_mass --output by_mass.csv --plot by_mass.png")
FIXED: dict[str, object] = {"columns": None, "verbose": False}


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


def show_drives(subject: Subject, path: GivenPath, rows: Rows) -> None:
    """Print the duty of every drive along a path: peak, effective (rms) value, limit of the data sheet, margin.

    The effective torque counts from the first to the last row, pauses of a cycle included if the path has them. A
    negative margin means that the motor is too small for this motion (exit code 0).
    """
    scene = path.along(subject.chosen(), subject.model)
    if not scene.drives:
        raise InvalidSetting(f"{scene.name} has no drives: name the file of their data with --drives FILE.toml")
    rows.require(scene.reference.duration)
    with PatientProgress("solving"):
        solution = solve(scene, step=rows.step, model=subject.model)
    table = [("drive", "quantity", "value", "at", "limit", "margin")]
    for name, drive in scene.drives.items():
        speed, most = map(max, zip(*(drive.torque_speed or [(None, 1.0)]), strict=True))
        limits = {"motor_speed": speed, "power": drive.rated_power, "rms_torque": drive.rated_torque}
        for channel in (each for each in solution.channels if each.name.startswith(f"{name}.")):
            kind, unit, values = channel.name.removeprefix(f"{name}."), channel.unit, solution[channel.name]
            which, k, limit = "", -1, limits.get(kind)
            full = limit
            if kind == "torque_reserve":
                which, k, limit, full = ", least", int(values.argmin()), 0.0, -most
            elif not isinstance(channel, RunQuantity):
                values = np.abs(values)
                which, k = ", peak", int(values.argmax())
            time = f"{solution.t[k]:.4g} s" if which else ""
            bound = ("", "") if limit is None else (f"{limit:.4g} {unit}", f"{100 * (limit - values[k]) / full:.0f} %")
            table.append((name, f"{kind.replace('_', ' ')}{which}", f"{values[k]:.4g} {unit}", time, *bound))
    table_console().print(aligned(table), markup=False, highlight=False, soft_wrap=True)


@dataclass(frozen=True)
class ByParameters:
    """Parameters to differentiate by."""

    title = "Sensitivities"

    wrt: tuple[str, ...] = option(
        "--wrt", kind=text("load_mass"), metavar="NAME", default=(),
        help="Differentiate by this parameter. Default: all.",
    )  # fmt: skip


def show_sensitivities(subject: Subject, path: GivenPath, by: ByParameters, rows: Rows, results: Table) -> None:
    """Compute the sensitivities of inputs and load to the parameters.

    The derivatives are exact. The table shows the largest effect of one per cent more of each parameter: on the inputs
    for the prescribed path, and on the position of the load (drift) under unchanged inputs. With --output all
    derivatives over time are written to a file.
    """
    moved = path.along(subject.chosen(), subject.model)
    rows.require(moved.reference.duration)
    with PatientProgress("differentiating"):
        found = sensitivities(moved, tuple(dict.fromkeys(by.wrt)) or None, step=rows.step, model=subject.model)
        contents = results.picture(lambda pictures: pictures.sensitivities_figure(found))
    write_together(contents if results.output is None else {**contents, results.output: found.table()})
    table = f"{_effects_of_one_per_cent(found)}\nLargest effect of one per cent more of a parameter."
    table_console().print(table, markup=False, highlight=False, soft_wrap=True)


def _effects_of_one_per_cent(result: Sensitivities) -> str:
    """Return the largest effect of one per cent more of each parameter on each quantity, as a table."""
    rows = [("parameter", *(each.name for each in result.quantities))]
    for name, size in zip(result.parameters, result.sizes, strict=True):
        changes = [result[each.name, name] * size / 100.0 for each in result.quantities]
        largest = [change[np.abs(change).argmax()] for change in changes]
        rows.append((name, *(f"{x:.3g}{behind(of.unit)}" for x, of in zip(largest, result.quantities, strict=True))))
    return aligned(rows)
