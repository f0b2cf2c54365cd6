"""The command ``plan``: the fastest law along a way within limits, as a table."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from servocore.cli.command import option
from servocore.cli.console import PatientProgress, deliver
from servocore.cli.kinds import FILE, text
from servocore.cli.options import GivenLimits, GivenPath, Rows, Subject, Table
from servocore.cli.run_summary import chosen_columns, table_pieces
from servocore.errors import InvalidSetting
from servocore.model.limit_files import factors_of_texts
from servocore.model.scene import Scene
from servocore.planning.fastest import fastest
from servocore.planning.space import Space
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.csv_file import path_to_csv
from servocore.references.csv_table import PREFIXES
from servocore.solvers.solve import solve

EXAMPLES = (
    "overhead_crane --from 0 -4 --to 5 -4 --limit F=200 --robust load_mass=0.9..1.1 --plot plan.png",
    "rotary_crane --from 5 0 -5 --to -2 2 -2 --limit F=60 --limit swing=5deg -o plan.csv --write-path way.csv",
)

FIXED: dict[str, object] = {"duration": None, "profile": None, "ramp": None, "verbose": False}
"""A plan finds its duration and its law."""

_ROWS = 200


@dataclass(frozen=True)
class Freedom:
    """What a plan may choose, and what it must keep for."""

    title = "Plan"

    robust: tuple[str, ...] = option(
        "--robust", kind=text("load_mass=0.9..1.1"), metavar="NAME=LOW..HIGH", default=(),
        help="Keep the limits for these factors of a parameter, too: load_mass=0.9..1.1.",
    )  # fmt: skip
    free: bool = option("--free", help="Let the plan choose the way between --from and --to, too.")
    keep_out: tuple[str, ...] = option(
        "--keep-out", kind=text("'sphere 1 2 -3 0.5'"), metavar="BODY", default=(),
        help="With --free: 'sphere X Y Z RADIUS' or 'box X Y Z HALF HALF HALF' (m) for load and rope.",
    )  # fmt: skip
    clearance_of: str | None = option(
        "--clearance-of", kind=text("load,rope"), metavar="LIST",
        help="With --keep-out: what keeps clear, of load,rope,bridge. Default: load,rope.",
    )  # fmt: skip
    path: Path | None = option(
        "--write-path", kind=FILE, metavar="FILE.csv",
        help="Write the path with its derivatives as well, for --reference of other commands.",
    )  # fmt: skip

    def space(self, dimension: int) -> Space | None:
        """Return what a free way keeps clear of; None unless it is free.

        Raises
        ------
        InvalidSetting
            If one option lacks another, or there is no such body or part.
        """
        if self.keep_out and not self.free:
            raise InvalidSetting("--keep-out belongs to --free")
        if self.clearance_of is not None and not self.keep_out:
            raise InvalidSetting("--clearance-of belongs to --keep-out")
        return Space.of_texts(self.keep_out, dimension, self.clearance_of) if self.free else None


def plan_motion(
    subject: Subject, path: GivenPath, limits: GivenLimits, freedom: Freedom, rows: Rows, table: Table
) -> None:
    """Find the fastest law along a way that keeps all limits, and write it as a table.

    The way is a line (--from, --to), a smooth curve through more points (--via), or the curve of a path in a file
    (--reference, --waypoints). Everything starts and ends at rest, inputs without a jump. The table is that of
    feedforward, and holds all that the model reports. How good the plan is, and how it is known that it keeps the
    limits, is printed when the table goes into a file.
    """
    scene, bounds = subject.chosen(), limits.bounds()
    if freedom.path is not None:
        _require_a_path_file(scene, subject.model)
    way = _way(scene, subject.model, path)
    space = freedom.space(len(scene.model(subject.model).outputs))
    ranges = factors_of_texts(freedom.robust)
    names = chosen_columns(table.columns, scene, subject.model, more=True)
    with PatientProgress("planning") as progress:
        found, report = fastest(
            scene, way, bounds, free=space, robust=ranges, model=subject.model, progress=progress.describe
        )
        rows.require(found.duration)
        count = _ROWS if rows.step is None else math.ceil(found.duration / rows.step * (1.0 - 1e-12))
        bounded = scene.with_limits(**bounds)
        solution = solve(bounded.with_reference(found), step=found.duration / count, model=subject.model)
        contents = table.picture(lambda pictures: pictures.plan_figure(bounded, found, report))
    if freedom.path is not None:
        contents[freedom.path] = path_to_csv(found, [quantity.name for quantity in scene.model(subject.model).outputs])
    deliver(table_pieces(solution, names), table.output, contents, report)


def _require_a_path_file(scene: Scene, model: str | None) -> None:
    """Refuse to write a path whose file would lack derivatives that the scene's inputs hold."""
    needed, written = Problem.of(scene, model).array.reference_order, len(PREFIXES) - 1
    if needed > written:
        raise InvalidSetting(
            f"--write-path: a file holds {written} derivatives of a path, and {scene.name} needs {needed}, or inputs"
            " are wrong"
        )


def _way(scene: Scene, model: str | None, path: GivenPath) -> Reference | np.ndarray:
    """Return the way that options describe; raises `InvalidSetting` if they describe none, or two."""
    given = path.options()
    if path.reference is not None or path.waypoints is not None:
        found = path.path(scene, model)
        assert found is not None
        return found
    if not {"--from", "--to"} <= set(given):
        raise InvalidSetting("no way is given: use --from and --to, --reference, or --waypoints")
    return np.array(path.points(scene, model))
