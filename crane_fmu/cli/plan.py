"""The fastest motion of the crane's load within limits: the command ``crane-fmu plan``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import servocore as sc
from crane_fmu.cli.options import (
    CRANE,
    LINE,
    RESULTS,
    End,
    Limits,
    LimitsFile,
    OutputFile,
    ParametersFile,
    PlotFile,
    ReferenceFile,
    Start,
    Tolerance,
    WaypointsFile,
)
from crane_fmu.feedforward import COLUMNS, MOST_ROWS, table
from crane_fmu.files import path_in_file
from servocore.cli.console import PatientProgress, deliver
from servocore.files import require_picture, require_places


@dataclass(frozen=True)
class Plan:
    """What is to be planned.

    Attributes
    ----------
    way : reference or sequence of points
        The curve of a path, or start and end (m).
    limits : mapping
        As `servocore.Scene.with_limits` takes them.
    robust : mapping of str to pair
        Factors of parameters at which the limits are kept as well.
    free : Space or None
        What is kept clear of, where the way between start and end is free as well.
    step : float or None
        Largest time between rows in s; a 200th of the duration without it.
    """

    way: Any
    limits: Mapping[str, Any]
    robust: Mapping[str, tuple[float, float]]
    free: sc.Space | None = None
    step: float | None = None


def planned(
    scene: sc.Scene, wanted: Plan, progress: Callable[[str], None] | None = None
) -> tuple[sc.Reference, sc.Solution, sc.PlanReport]:
    """Return path, inputs and motion of the fastest law of a crane, in equal rows, and what is known about it.

    Raises
    ------
    ServocoreError
        If there is no such law, or something wanted makes no sense.
    """
    if wanted.step is not None and not (np.isfinite(wanted.step) and wanted.step > 0.0):
        raise sc.InvalidSetting(f"the step must be a positive time, not {wanted.step:g} s")
    path, report = sc.fastest(
        scene, wanted.way, wanted.limits, free=wanted.free, robust=wanted.robust, progress=progress
    )
    rows = 200.0 if wanted.step is None else np.ceil(path.duration / wanted.step)
    if rows > MOST_ROWS:
        raise sc.InvalidSetting(f"a step of {wanted.step:g} s makes more than {MOST_ROWS:g} rows: take a larger step")
    bounded = scene.with_reference(path).with_limits(**wanted.limits)
    return path, sc.solve(bounded, step=path.duration / rows), report


Robust = Annotated[
    list[str] | None,
    typer.Option("--robust", metavar="NAME=LOW..HIGH", rich_help_panel=CRANE,
                 help="Keep the limits for these factors of a parameter, too: load_mass=0.9..1.1."),
]  # fmt: skip
Free = Annotated[
    bool, typer.Option("--free", rich_help_panel=LINE, help="Let the plan choose the way between --from and --to, too.")
]
KeepOut = Annotated[
    list[str] | None,
    typer.Option("--keep-out", metavar="BODY", rich_help_panel=LINE,
                 help="With --free: 'sphere X Y Z RADIUS' or 'box X Y Z HALF HALF HALF' (m) that load and rope keep"
                 " clear of, as many as there are."),
]  # fmt: skip
Parts = Annotated[
    str | None,
    typer.Option("--parts", metavar="LIST", rich_help_panel=LINE,
                 help="With --keep-out: what keeps clear, of load,rope,bridge. Default: load,rope."),
]  # fmt: skip
LargestStep = Annotated[
    float | None,
    typer.Option("--step", metavar="H", rich_help_panel=CRANE,
                 help="Largest time between rows (s). Default: duration/200."),
]  # fmt: skip
PathFile = Annotated[
    Path | None,
    typer.Option("--path", metavar="FILE.csv", rich_help_panel=RESULTS,
                 help="Write the path with its derivatives as well, for --reference of feedforward, drive and ssp."),
]  # fmt: skip
EXAMPLES = """[bold]Examples[/bold]

[cyan]crane-fmu plan --from 5 0 -5 --to -2 2 -2 --limit M_b=1000 --limit F=60 --limit swing=5deg -o plan.csv[/cyan]

The same path for the other commands, such as ssp, whose LoadTrajectory.fmu plays it:

[cyan]crane-fmu plan --from 5 0 -5 --to -2 2 -2 --limit F=60 -o plan.csv --path way.csv[/cyan]

[cyan]crane-fmu ssp --reference way.csv -o system[/cyan]
"""


def plan_motion(
    reference: ReferenceFile = None,
    waypoints: WaypointsFile = None,
    tolerance: Tolerance = None,
    start: Start = None,
    end: End = None,
    parameters: ParametersFile = None,
    limit: Limits = None,
    limits: LimitsFile = None,
    robust: Robust = None,
    free: Free = False,
    keep_out: KeepOut = None,
    parts: Parts = None,
    step: LargestStep = None,
    output: OutputFile = None,
    path_file: PathFile = None,
    plot: PlotFile = None,
) -> None:
    """Find the fastest motion of the load along a line, or the curve of a path in a file, within limits.

    The table is that of feedforward with the swing angle behind it. With --output, how good the plan is and how it is
    known that it keeps the limits is printed. With --free only start and end are given.
    """
    files, points = (sum(each is not None for each in given) for given in ((reference, waypoints), (start, end)))
    if (files, points) not in ((1, 0), (0, 2)):
        raise sc.InvalidSetting("the way is given either by --reference or --waypoints, or by --from and --to")
    read = path_in_file(reference, waypoints, tolerance)
    if keep_out and not free:
        raise sc.InvalidSetting("--keep-out belongs to --free")
    if parts is not None and not keep_out:
        raise sc.InvalidSetting("--parts belongs to --keep-out")
    require_places(
        {"--output": output, "--path": path_file, "--plot": plot}, [reference, waypoints, parameters, limits]
    )
    require_picture(plot)
    scene = sc.scenes.rotary_crane()
    if parameters is not None:
        scene = scene.with_parameters(**sc.read_parameters(parameters, scene))
    way: Any = (start, end) if read is None else read()
    space = sc.Space.of_texts(keep_out or (), 3, parts) if free else None
    wanted = Plan(way, sc.limits_given(limit, limits), sc.factors_of_texts(robust or ()), space, step)
    contents: dict[Path, str | bytes] = {}
    with PatientProgress("planning") as progress:
        path, solution, report = planned(scene, wanted, progress.describe)
        if path_file is not None:
            contents[path_file] = sc.csv_of(path)
        if plot is not None:
            from crane_fmu.report.style import picture  # noqa: PLC0415
            from crane_fmu.report.trajectories import inputs_and_motion  # noqa: PLC0415

            contents[plot] = picture(inputs_and_motion(solution), plot.suffix.lower(), solution.route)
    deliver(table(solution, (*COLUMNS, "swing")), output, contents, report)
