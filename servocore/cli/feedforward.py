"""The command ``servocore feedforward``: the inputs of any scene along a path, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

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
    ReferenceFile,
    SceneName,
    Start,
    Step,
    Tolerance,
    Waypoints,
    point,
)
from servocore.cli.run_summary import Columns, Verbose, chosen_columns, column_names, details, summary, tell, timed
from servocore.errors import InvalidSetting
from servocore.files import csv_pieces, require_places
from servocore.model.limit_files import limits_given
from servocore.model.scene import Scene
from servocore.planning.durations import shortest_duration_told
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.profiles import DEGREE9, DEGREE13, TIME_LAWS, Profile, polynomial
from servocore.references.rest_to_rest import rest_to_rest
from servocore.solvers.solve import solve

EXAMPLES = """[bold]Examples[/bold]

[cyan]servocore feedforward overhead_crane --from 0 -4 --to 5 -4 --duration 6 -o inputs.csv[/cyan]

[cyan]servocore feedforward rotary_crane --waypoints cycle.csv --limit F=60 --columns M_b,F,swing[/cyan]
"""

_MOST_ROWS = 1e7

Duration = Annotated[float | None, typer.Option("--duration", metavar="T", help="Time of the motion (s).")]
ProfileName = Annotated[
    str | None,
    typer.Option("--profile", metavar="NAME", help=f"Time law of a line: {', '.join(TIME_LAWS)}. Default: what the"
                 " scene needs."),
]  # fmt: skip


def feed_forward(
    scene: SceneName,
    reference: ReferenceFile = None,
    tolerance: Tolerance = None,
    waypoints: Waypoints = None,
    start: Start = None,
    end: End = None,
    duration: Duration = None,
    profile: ProfileName = None,
    parameters: Parameters = None,
    model: Model = None,
    step: Step = None,
    limit: LimitTexts = None,
    limits: LimitsFile = None,
    columns: Columns = None,
    output: Output = None,
    verbose: Verbose = False,
) -> None:
    """Compute the inputs that make a scene's outputs follow a path, as a table.

    The path is a file of samples (--reference) or of waypoints (--waypoints), a
    line from rest to rest (--from, --to, --duration), or else the scene's own.
    The inputs are those of the route that the analysis recommends. Peaks, rest,
    and how far the inputs are from right are told on the error stream.
    """
    subject = chosen(scene, parameters)
    require_places({"--output": output}, [parameters, limits, reference, waypoints])
    line = {"--from": start, "--to": end, "--duration": duration, "--profile": profile}
    path = _path(subject, model, GivenPath(reference, waypoints, tolerance), line)
    bounded = subject.with_limits(**limits_given(limit, limits))
    moved = bounded if path is None else bounded.with_reference(path)
    system = subject.model(model)
    names = chosen_columns(columns, system, column_names(system))
    if step is not None and step > 0.0 and moved.reference.duration / step > _MOST_ROWS:
        raise InvalidSetting(f"a step of {step:g} s makes more than {_MOST_ROWS:g} rows: take a larger step")
    with PatientProgress("computing the inputs") as progress:
        with shortest_duration_told(moved, model), timed() as seconds:
            solution = solve(moved, step=step, model=model, progress=progress)
        told = summary(solution) + (details(solution, seconds) if verbose else [])
    deliver(csv_pieces(["time", *names], [solution.t, *[solution[name] for name in names]]), output, {})
    tell(told)


def _path(scene: Scene, model: str | None, file: GivenPath, line: dict[str, str | float | None]) -> Reference | None:
    """Return the path that options describe, None where they describe none; raises `InvalidSetting` for two."""
    given = [name for name, value in line.items() if value is not None]
    file.option(given)  # refuses a line beside a file
    if not given:
        return file.path(scene, model)
    missing = [name for name in ("--from", "--to", "--duration") if name not in given]
    if missing:
        raise InvalidSetting(f"a straight line also needs {' and '.join(missing)}")
    return _line(line, path_columns(scene, model)[0], Problem.of(scene, model).array.reference_order)


def _line(line: dict[str, str | float | None], names: Sequence[str], rest_order: int) -> Reference:
    first, last = (point(option, str(line[option]), names) for option in ("--from", "--to"))
    name, duration = line["--profile"], line["--duration"]
    assert isinstance(duration, float)
    if name is None:
        smooth: list[Profile] = [profile for profile in (DEGREE9, DEGREE13) if profile.smoothness >= rest_order]
        law = smooth[0] if smooth else polynomial(2 * rest_order + 1)
    elif name in TIME_LAWS:
        law = TIME_LAWS[str(name)]
    else:
        raise InvalidSetting(f"there is no profile {name!r}; there are {', '.join(TIME_LAWS)}")
    return rest_to_rest(first, last, duration, profile=law)
