"""The command ``servocore view``: a scene as a live page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from servocore.cli.chosen_scene import GivenPath, chosen
from servocore.cli.console import PatientProgress
from servocore.cli.options import (
    LimitsFile,
    LimitTexts,
    Model,
    Parameters,
    ReferenceFile,
    SceneName,
    Step,
    Tolerance,
    Waypoints,
)
from servocore.files import require_places, write_together
from servocore.model.limit_files import limits_given
from servocore.solvers.solve import solve
from servocore.view.page import live_part, page_text, require_page

EXAMPLES = """[bold]Examples[/bold]

[cyan]servocore view rotary_crane[/cyan]

[cyan]servocore view my_module:my_scene -o mine.html --reference cycle.csv --limit F=60[/cyan]
"""

Output = Annotated[
    Path | None, typer.Option("-o", "--output", metavar="FILE.html", help="The page to write. Default: SCENE.html.")
]


def view_scene(
    scene: SceneName,
    output: Output = None,
    reference: ReferenceFile = None,
    tolerance: Tolerance = None,
    waypoints: Waypoints = None,
    parameters: Parameters = None,
    model: Model = None,
    step: Step = None,
    limit: LimitTexts = None,
    limits: LimitsFile = None,
) -> None:
    """Write a scene as a live page: one HTML file that opens without a server.

    It shows the system in space and moving, and its inputs over time. Sliders for
    data, duration, start and target compute everything again while one drags, and
    limits light up when exceeded. Scenes with internal dynamics are shown as solved.
    """
    subject = GivenPath(reference, waypoints, tolerance).along(chosen(scene, parameters), model)
    file = require_page(output or f"{subject.name}.html")
    require_places({"--output": file}, [parameters, reference, waypoints, limits])
    shown = subject.with_limits(**limits_given(limit, limits))
    with PatientProgress("solving"):
        solution = solve(subject, step=step, model=model)
        part = live_part(solution, scene=shown, model=model)
        write_together({file: page_text(solution, part)})
    print(f"{file}: {subject.name}, {f'as solved: {part.why}' if part.why else 'live'}")
