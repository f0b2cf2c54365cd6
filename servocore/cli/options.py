"""Options that several commands of ``servocore`` share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
    typer.Option("--reference", metavar="FILE.csv", help="Another path: its header is time and the outputs' names."),
]
LimitsFile = Annotated[Path | None, typer.Option("--limits", metavar="FILE.toml", help="More limits, one line each.")]
