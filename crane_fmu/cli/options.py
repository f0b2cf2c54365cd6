"""Options that several commands of ``crane-fmu`` share."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

import servocore as sc
from crane_fmu import catalogue
from servocore.files import PICTURES

Point = tuple[float, float, float]
"""Coordinates of the load, m."""

LINE, CRANE, RESULTS = "Path: a straight line", "Crane and computation", "Results"
"""Panels of the help."""

_file = partial(typer.Option, rich_help_panel="Path: a file")
_line = partial(typer.Option, rich_help_panel=LINE)
_crane = partial(typer.Option, rich_help_panel=CRANE)
_results = partial(typer.Option, rich_help_panel=RESULTS)
_PARAMETERS = ", ".join(sc.scenes.rotary_crane().parameter_values())

ReferenceFile = Annotated[
    Path | None,
    _file("--reference", metavar="FILE.csv",
          help="Positions of the load over time: header time,x,y,z, optionally followed by vx,vy,vz, then"
          " ax,ay,az, then jx,jy,jz, then sx,sy,sz (s, m, m/s, ...)."),
]  # fmt: skip
WaypointsFile = Annotated[
    Path | None,
    _file("--waypoints", metavar="FILE.csv",
          help="Points with times, joined from rest to rest: header time,x,y,z, optionally followed by vx,vy,vz, which"
          " may be empty, and stop, 1 where the load rests on its way."),
]  # fmt: skip
Tolerance = Annotated[
    float | None,
    _file("--tolerance", metavar="METRES",
          help="How far the path may stay away from the positions in the file, for rounded or noisy ones."),
]  # fmt: skip
Start = Annotated[Point | None, _line("--from", metavar="X Y Z", help="Start (m); z < 0 is below the girder.")]
End = Annotated[Point | None, _line("--to", metavar="X Y Z", help="End (m).")]
Duration = Annotated[float | None, _line("--duration", metavar="T", help="Time of the motion (s).")]
ProfileName = Annotated[
    str | None,
    _line("--profile", metavar="NAME",
          help=f"Time law: {', '.join(catalogue.PROFILES)}. Default: {next(iter(catalogue.PROFILES))}."),
]  # fmt: skip
Ramp = Annotated[
    float | None,
    _line("--ramp", metavar="TAU0",
          help=f"Time to accelerate (s), only for {catalogue.THREE_PHASE}. Default: duration/4."),
]  # fmt: skip
ParametersFile = Annotated[
    Path | None,
    _crane("--parameters", metavar="FILE.toml", help=f"Any of {_PARAMETERS} (SI units)."),
]
ModelName = Annotated[str, _crane("--model", metavar="NAME", help=f"One of {', '.join(catalogue.MODELS)}.")]
FormulationName = Annotated[
    str, _crane("--formulation", metavar="NAME", help=f"One of {', '.join(catalogue.FORMULATIONS)}.")
]
MethodName = Annotated[str, _crane("--method", metavar="NAME", help=f"One of {', '.join(catalogue.METHODS)}.")]
Step = Annotated[
    float | None,
    _crane("--step", metavar="H", help="Step (s); divides the duration. Default: duration/200."),
]
DriveStep = Annotated[
    float | None,
    _crane("--step", metavar="H",
           help="Communication step (s); divides the duration. Default: 0.01, or a little less to divide it."),
]  # fmt: skip
RelativeTolerance = Annotated[
    float | None,
    _crane("--rtol", metavar="R", help="In place of a step: error of the inputs relative to their peaks."),
]
AbsoluteTolerance = Annotated[
    float | None,
    _crane("--atol", metavar="A", help="In place of a step: error of the inputs in their own units."),
]
OutputStep = Annotated[
    float | None,
    _crane("--output-step", metavar="H",
           help="With --rtol or --atol: time between rows (s); divides the duration. Default: duration/200."),
]  # fmt: skip
Limits = Annotated[
    list[str] | None,
    _crane("--limit", metavar="NAME=VALUE",
           help="A limit that the motion must keep, any number of times:"
           " F=60, M_w=-104..-92, swing=5deg, s.rate=1.2."),
]  # fmt: skip
LimitsFile = Annotated[
    Path | None,
    _crane("--limits", metavar="FILE.toml", help='More of them: F = 60, M_w = [-104, -92], swing = "5 deg".'),
]
OutputFile = Annotated[
    Path | None,
    _results("--output", "-o", metavar="FILE.csv",
             help="Where the table goes. Default: the standard output stream."),
]  # fmt: skip
PlotFile = Annotated[
    Path | None,
    _results("--plot", metavar="FILE.png",
             help=f"Draw inputs and motion; {', '.join(PICTURES)} are known."),
]  # fmt: skip
