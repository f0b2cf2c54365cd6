"""Write the parameters of all scenes and of their effects, and default paths: ``python docs/write_parameters.py``."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import servocore as sc
from servocore.references.rest_to_rest import RestToRest

FILE = Path(__file__).with_name("parameters.csv")
HEADINGS = ("scene", "parameter", "default", "unit", "lower bound", "upper bound", "description")


def table() -> str:
    """Return the table as CSV: of each scene a row for the default path and one for each parameter, of effects last."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADINGS)
    for name, make in sc.scenes.REGISTRY.items():
        scene = make()
        path = scene.reference
        assert isinstance(path, RestToRest)
        text_of_path = f"from {path.start} to {path.end} in {path.duration} s"
        writer.writerow((name, "default path", "", "", "", "", text_of_path))
        groups = (scene.model().parameters.declared, *(effect.parameters for effect in scene.effects.declared))
        for each in {each.name: each for group in groups for each in group}.values():
            values = (each.default, each.unit, each.lower, each.upper, each.description)
            writer.writerow((name, each.name, *values))
    return text.getvalue()


if __name__ == "__main__":
    FILE.write_text(table(), encoding="utf-8")
