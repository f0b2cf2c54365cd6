"""The command ``view``: a scene as a live page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from servocore.cli.console import PatientProgress
from servocore.cli.options import GivenLimits, GivenPath, Rows, Subject, output
from servocore.files import require_places, write_together
from servocore.solvers.solve import solve
from servocore.view.page import live_part, page_text, require_page

EXAMPLES = ("rotary_crane", "my_module:my_scene -o mine.html --reference cycle.csv --limit F=60")


@dataclass(frozen=True)
class Page:
    """The page to write."""

    title = "Results"

    output: Path | None = output("FILE.html", "The page to write. Default: SCENE.html.")


def view_scene(subject: Subject, path: GivenPath, limits: GivenLimits, rows: Rows, page: Page) -> None:
    """Write a scene as a live page: one HTML file that opens without a server.

    It shows the motion of the system in space, and its inputs over time. Sliders for parameters, duration, start and
    target recompute the motion while they are dragged; exceeded limits are highlighted. For scenes with internal
    dynamics the page shows the solution without sliders.
    """
    scene = subject.chosen()
    file = require_page(page.output or f"{scene.name}.html")
    require_places({"--output": file})
    moved = path.along(scene, subject.model)
    shown = moved.with_limits(**limits.bounds())
    with PatientProgress("solving"):
        rows.require(moved.reference.duration)
        solution = solve(moved, step=rows.step, model=subject.model)
        part = live_part(solution, scene=shown, model=subject.model)
        write_together({file: page_text(solution, part)})
    print(f"{file}: {scene.name}, {f'as solved: {part.why}' if part.why else 'live'}")
