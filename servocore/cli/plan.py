"""The command ``servocore plan``: the fastest law along a way within limits, as a table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from servocore.cli.chosen_scene import GivenPath, chosen, path_columns
from servocore.cli.console import PatientProgress, deliver
from servocore.cli.options import (
    End,
    LimitsFile,
    LimitTexts,
    Model,
    Output,
    Parameters,
    SceneName,
    Start,
    Tolerance,
    Waypoints,
    point,
)
from servocore.cli.run_summary import column_names
from servocore.errors import InvalidSetting
from servocore.files import PICTURES, csv_text, require_picture, require_places
from servocore.model.limit_files import factors_of_texts, limits_given
from servocore.model.limits import Bounds
from servocore.model.scene import Scene
from servocore.planning.fastest import fastest
from servocore.planning.space import Space
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.csv_file import csv_of
from servocore.references.csv_table import PREFIXES
from servocore.solution import Solution
from servocore.solvers.solve import solve

EXAMPLES = """[bold]Examples[/bold]

[cyan]servocore plan rotary_crane --from 5 0 -5 --to -2 2 -2 --limit M_b=1000
--limit F=60 --limit swing=5deg -o plan.csv[/cyan]

[cyan]servocore plan overhead_crane --from 0 -4 --to 5 -4 --limit F=200
--robust load_mass=0.9..1.1 --plot plan.png[/cyan]
"""

_ROWS = 200
_MOST_ROWS = 1e7


Between = Annotated[
    list[str] | None, typer.Option("--by", metavar="X Y ...", help="Lead the path through this point; may be repeated.")
]
ReferenceFile = Annotated[
    Path | None,
    typer.Option(
        "--reference",
        metavar="FILE.csv",
        help="The curve of this path: its header is time and the outputs' names. Its times do not count.",
    ),
]
Robust = Annotated[
    list[str] | None,
    typer.Option(
        "--robust",
        metavar="NAME=LOW..HIGH",
        help="Keep the limits for these factors of a parameter, too: load_mass=0.9..1.1.",
    ),
]
Free = Annotated[bool, typer.Option("--free", help="Let the plan choose the way between --from and --to, too.")]
KeepOut = Annotated[
    list[str] | None,
    typer.Option(
        "--keep-out",
        metavar="BODY",
        help="With --free: 'sphere X Y Z RADIUS' or 'box X Y Z HALF HALF HALF' (m) for load and rope, as many as there"
        " are.",
    ),
]
Parts = Annotated[
    str | None,
    typer.Option(
        "--parts",
        metavar="LIST",
        help="With --keep-out: what keeps clear, of load,rope,bridge. Default: load,rope.",
    ),
]
Step = Annotated[
    float | None, typer.Option("--step", metavar="H", help=f"Largest time between rows (s). Default: duration/{_ROWS}.")
]
PathFile = Annotated[
    Path | None,
    typer.Option(
        "--path",
        metavar="FILE.csv",
        help="Write the path with its derivatives as well, for --reference of crane-fmu and its LoadTrajectory.fmu.",
    ),
]
Plot = Annotated[
    Path | None,
    typer.Option("--plot", metavar="FILE.png", help=f"Draw what is limited; {', '.join(PICTURES)} are known."),
]


def plan_scene(
    scene: SceneName,
    start: Start = None,
    end: End = None,
    between: Between = None,
    reference: ReferenceFile = None,
    tolerance: Tolerance = None,
    waypoints: Waypoints = None,
    limit: LimitTexts = None,
    limits: LimitsFile = None,
    parameters: Parameters = None,
    model: Model = None,
    robust: Robust = None,
    free: Free = False,
    keep_out: KeepOut = None,
    parts: Parts = None,
    step: Step = None,
    output: Output = None,
    path_file: PathFile = None,
    plot: Plot = None,
) -> None:
    """Find the fastest law along a way that keeps all limits, and write it as a table.

    The way is a line (--from, --to), a smooth curve through more points (--by),
    or the curve of a path in a file (--reference, --waypoints). Everything starts and ends at
    rest, inputs without a jump. The table has one row every --step: time,
    inputs, what the model reports, the path. How good the plan is, and how it is
    known that it keeps the limits, is printed when the table goes into a file.
    """
    subject, file = chosen(scene, parameters), GivenPath(reference, waypoints, tolerance)
    require_places(
        {"--output": output, "--path": path_file, "--plot": plot}, [parameters, limits, reference, waypoints]
    )
    require_picture(plot)
    if path_file is not None:
        _require_a_path_file(subject, model)
    if step is not None and not (math.isfinite(step) and step > 0.0):
        raise InvalidSetting(f"--step must be a positive time, not {step:g} s")
    bounds = limits_given(limit, limits)
    points = [("--from", start), *(("--by", point) for point in between or ()), ("--to", end)]
    way = _way(subject, model, [(option, text) for option, text in points if text], file)
    space = _keep_clear(free, keep_out, parts, len(subject.model(model).outputs))
    ranges = factors_of_texts(robust or ())
    with PatientProgress("planning") as progress:
        path, report = fastest(subject, way, bounds, free=space, robust=ranges, model=model, progress=progress.describe)
        solution = planned_motion(subject, path, bounds, step, model)
        contents: dict[Path, str | bytes] = {}
        if plot is not None:
            from servocore.cli.plan_figure import plan_figure  # noqa: PLC0415 - slow to import

            contents[plot] = plan_figure(subject.with_limits(**bounds), path, report, plot.suffix[1:].lower())
    if path_file is not None:
        contents[path_file] = csv_of(path, [quantity.name for quantity in subject.model(model).outputs])
    deliver(_table(subject, solution, model), output, contents, report)


def _keep_clear(free: bool, keep_out: Sequence[str] | None, parts: str | None, dimension: int) -> Space | None:
    """Return what a free way keeps clear of; None unless it is free.

    Raises
    ------
    InvalidSetting
        If one option lacks another, or there is no such body or part.
    """
    if keep_out and not free:
        raise InvalidSetting("--keep-out belongs to --free")
    if parts is not None and not keep_out:
        raise InvalidSetting("--parts belongs to --keep-out")
    return Space.of_texts(keep_out or (), dimension, parts) if free else None


def _require_a_path_file(scene: Scene, model: str | None) -> None:
    """Refuse to write a path whose file would lack derivatives that the scene's inputs hold."""
    needed, written = Problem.of(scene, model).array.reference_order, len(PREFIXES) - 1
    if needed > written:
        raise InvalidSetting(
            f"--path: a file holds {written} derivatives of a path, but {scene.name} needs {needed}, or its inputs are"
            " wrong"
        )


def planned_motion(
    scene: Scene, path: Reference, bounds: Mapping[str, Bounds], step: float | None, model: str | None = None
) -> Solution:
    """Return inputs and motion of a plan, in equal rows that are no more than a step apart."""
    if step is not None and path.duration / step > _MOST_ROWS:
        raise InvalidSetting(f"a step of {step:g} s makes more than {_MOST_ROWS:g} rows: take a larger step")
    rows = _ROWS if step is None else math.ceil(path.duration / step * (1.0 - 1e-12))
    return solve(scene.with_reference(path).with_limits(**bounds), step=path.duration / rows, model=model)


def _way(scene: Scene, model: str | None, points: Sequence[tuple[str, str]], file: GivenPath) -> Reference | np.ndarray:
    """Return the way that options describe; raises `InvalidSetting` if they describe none, or two."""
    option = file.option()
    if option and points:
        raise InvalidSetting(f"a way is given either by {option} or by --from and --to, not by both")
    path = file.path(scene, model)
    if path is not None:
        return path
    if not {"--from", "--to"} <= {option for option, _ in points}:
        raise InvalidSetting("no way is given: use --from and --to, --reference, or --waypoints")
    names, _ = path_columns(scene, model)
    return np.array([point(option, text, names) for option, text in points])


def _table(scene: Scene, solution: Solution, model: str | None) -> str:
    """Return time, inputs, what the model reports and the outputs as a CSV file."""
    names = column_names(scene.model(model))
    return csv_text(["time", *names], [solution.t, *[solution[name] for name in names]])
