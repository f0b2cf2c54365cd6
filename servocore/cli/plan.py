"""The command ``plan``: the time-optimal trajectory along a path within limits, as a table."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from servocore.cli.command import option
from servocore.cli.console import PatientProgress, deliver
from servocore.cli.kinds import FILE, POINT, RANGE, once, text
from servocore.cli.options import Certified, GivenLimits, GivenPath, Rows, Subject, Table
from servocore.cli.run_summary import chosen_columns, table_pieces
from servocore.errors import InvalidSetting
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
"""Options that a plan does not offer: it computes duration and time law."""

_ROWS = 200


@dataclass(frozen=True)
class Freedom:
    """Freedom of a plan, and the variations for which it must keep the limits."""

    title = "Plan"

    via: tuple[tuple[float, ...], ...] = option(
        "--via", kind=POINT, metavar="X Y ...", default=(), help="Lead the path through this point."
    )
    robust: tuple[Mapping[str, tuple[float, float]], ...] = option(
        "--robust", kind=RANGE, metavar="NAME=LOW..HIGH", default=(),
        help="Keep the limits for these factors of a parameter, too: load_mass=0.9..1.1.",
    )  # fmt: skip
    free: bool = option("--free", help="Optimize the path between --from and --to, too.")
    keep_out: tuple[str, ...] = option(
        "--keep-out", kind=text("'sphere 1 2 -3 0.5'"), metavar="BODY", default=(),
        help="With --free: 'sphere X Y Z RADIUS' or 'box X Y Z HALF HALF HALF' (m) for load and rope.",
    )  # fmt: skip
    clearance_of: str | None = option(
        "--clearance-of", kind=text("load,rope"), metavar="LIST",
        help="With --keep-out: parts that keep clear, of load,rope,bridge. Default: load,rope.",
    )  # fmt: skip
    path: Path | None = option(
        "--write-path", kind=FILE, metavar="FILE.csv",
        help="Write the path with its derivatives as well, for --reference of other commands.",
    )  # fmt: skip

    def space(self, dimension: int) -> Space | None:
        """Return the obstacles of a free path, None unless it is free; refuse options that lack another."""
        if self.keep_out and not self.free:
            raise InvalidSetting("--keep-out belongs to --free")
        if self.clearance_of is not None and not self.keep_out:
            raise InvalidSetting("--clearance-of belongs to --keep-out")
        return Space.of_texts(self.keep_out, dimension, self.clearance_of) if self.free else None


def plan_motion(
    subject: Subject,
    path: GivenPath,
    limits: GivenLimits,
    freedom: Freedom,
    rows: Rows,
    table: Table,
    certified: Certified,
) -> None:
    """Plan the time-optimal trajectory along a path within limits.

    The path is a line (--from, --to), a smooth curve through more points (--via), or the geometry of a path in a file
    (--reference, --waypoints). The motion starts and ends at rest, and the inputs have no jumps. The table is that of
    feedforward with all observables. With --output a report is printed: duration, distance from the optimum, and how
    the limits were verified.
    """
    scene, bounds = subject.chosen(), limits.bounds()
    written = len(PREFIXES) - 1
    if freedom.path is not None and (needed := Problem.of(scene, subject.model).array.reference_order) > written:
        raise InvalidSetting(
            f"--write-path: a file holds {written} derivatives of a path, but the inputs of {scene.name} depend on"
            f" {needed}"
        )
    way = _way(scene, subject.model, path, freedom.via)
    space = freedom.space(len(scene.model(subject.model).outputs))
    factors = once("--robust", freedom.robust)
    names = chosen_columns(table.columns, scene, subject.model, more=True)
    with PatientProgress("planning") as progress:
        found, report = fastest(
            scene, way, bounds, free=space, robust=factors, model=subject.model, certify=not certified.no_certify,
            progress=progress.describe,
        )  # fmt: skip
        rows.require(found.duration)
        count = _ROWS if rows.step is None else math.ceil(found.duration / rows.step * (1.0 - 1e-12))
        bounded = scene.with_limits(**bounds)
        solution = solve(bounded.with_reference(found), step=found.duration / count, model=subject.model)
        contents = table.picture(lambda pictures: pictures.plan_figure(bounded, found, report))
    if freedom.path is not None:
        contents[freedom.path] = path_to_csv(found, [quantity.name for quantity in scene.model(subject.model).outputs])
    deliver(table_pieces(solution, names), table.output, contents, report)
    if table.output is None:
        print(f"  limits: {report.limits.evidence}", file=sys.stderr)


def _way(scene: Scene, model: str | None, path: GivenPath, via: Sequence[tuple[float, ...]]) -> Reference | np.ndarray:
    """Return the path to plan along; raises `InvalidSetting` if options give none, or two."""
    given = [*path.options(), *(["--via"] if via else [])]
    if path.reference is None and path.waypoints is None:
        if not {"--from", "--to"} <= set(given):
            raise InvalidSetting("no path is given: use --from and --to, --reference, or --waypoints")
        return np.array(path.points(scene, model, via))
    if via:
        raise InvalidSetting(f"a path is given either by {given[0]} or by --via, not by both")
    found = path.path(scene, model)
    assert found is not None
    return found
