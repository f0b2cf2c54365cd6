"""Options that several commands of ``servocore`` share, and what reads them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from servocore.errors import InvalidSetting

SceneName = Annotated[
    str,
    typer.Argument(metavar="SCENE", help="A scene of the library, or module:function of your own.", show_default=False),
]
Model = Annotated[
    str | None, typer.Option("--model", metavar="NAME", help="Model of the scene. Default: its smallest.")
]
Parameters = Annotated[
    Path | None,
    typer.Option(
        "--parameters", metavar="FILE.toml",
        help="Other data in SI units, one line each, such as load_mass = 80.0; what is left out keeps its default.",
    ),
]  # fmt: skip
ReferenceFile = Annotated[
    Path | None,
    typer.Option("--reference", metavar="FILE.csv", help="Another path, sampled: its header is time and the outputs'"
                 " names, optionally followed by their derivatives, as vx,vy,vz."),
]  # fmt: skip
Tolerance = Annotated[
    float | None,
    typer.Option("--tolerance", metavar="METRES", help="How far the path may stay away from rounded or noisy samples."),
]
Waypoints = Annotated[
    Path | None,
    typer.Option("--waypoints", metavar="FILE.csv", help="Points with times, which a smooth path joins from rest to"
                 " rest."),
]  # fmt: skip
Step = Annotated[
    float | None,
    typer.Option("--step", metavar="H", help="Time between rows (s); divides the duration. Default: duration/200."),
]
LimitsFile = Annotated[Path | None, typer.Option("--limits", metavar="FILE.toml", help="More limits, one line each.")]
Start = Annotated[
    str | None, typer.Option("--from", metavar="X Y ...", help="Start: as many numbers as the scene has outputs.")
]
End = Annotated[
    str | None, typer.Option("--to", metavar="X Y ...", help="End: as many numbers as the scene has outputs.")
]
LimitTexts = Annotated[
    list[str] | None,
    typer.Option(
        "--limit",
        metavar="NAME=VALUE",
        help="Keep a limit: F=60, M_w=-104..-92, swing=5deg, s.rate=1.2; may be repeated.",
    ),
]
Output = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="FILE.csv", help="Where the table goes. Default: the standard output."),
]

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?,?|[-+]?(?:nan|inf)")
_POINTS = ("--from", "--to", "--by")


class PointsCommand(TyperCommand):
    """A command whose points have as many numbers as stand there: ``--from 5 0 -5``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the numbers of a point together before they are read."""
        joined: list[str] = []
        for each in args:
            last = joined[-1] if joined else ""
            if _NUMBER.fullmatch(each) and last in _POINTS:
                joined[-1] = f"{last}={each}"
            elif _NUMBER.fullmatch(each) and last.partition("=")[0] in _POINTS:
                joined[-1] = f"{last} {each}"
            else:
                joined.append(each)
        found: list[str] = super().parse_args(ctx, joined)
        return found


def point(option: str, text: str, names: Sequence[str]) -> list[float]:
    """Return the numbers of a point; raises `InvalidSetting` unless there is one for every name."""
    try:
        coordinates = [float(name) for name in text.replace(",", " ").split()]
    except ValueError:
        coordinates = []
    if len(coordinates) != len(names):
        raise InvalidSetting(f"{option} {text}: it needs {len(names)} numbers, {', '.join(names)}")
    return coordinates
