"""The user page of an FMU: one text, written as ``docs/fmu*.md`` and as the page behind a tool's Help button.

Its tables of variables are those of the FMU's own model description.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import fmpy
from jinja2 import Environment, StrictUndefined
from markdown_it import MarkdownIt

from crane_fmu.build.estimates import amplification
from crane_fmu.catalogue import CRANE_PLANT, LOAD_TRAJECTORY, ORDERS, ROTARY_CRANE, FmuKind

_LOCAL_LINK = re.compile(r"\[([^\]]+)\]\((?!https?:)[^)]+\)")
_TEMPLATES = Path(__file__).parent / "resources"

_BAD_STEP = (
    "a step that is not positive, NaN, or longer than an hour",
    "at t = 0 s the communication step is -0.1 s, it must be above 0 s and at most 3600 s",
)
_TIME_BACK = (
    "time goes back",
    "the communication point t = 0 s lies behind the FMU's time 0.1 s; to repeat a step restore the FMU's state first",
)
REFUSALS: Mapping[str, tuple[tuple[str, str], ...]] = {
    ROTARY_CRANE.name: (
        ("an input is NaN or infinite", "at t = 0 s the input load.jerk[2] is nan, not a finite number"),
        (
            "the load falls as fast as it would without a rope, or faster",
            "at t = 0 s the rope goes slack: g + z'' is -0.19 m/s2, it must stay above 0 m/s2",
        ),
        (
            "the load is at the girder's height or above",
            "at t = 0 s the load is not below the girder: the load's depth below the girder is -1 m,"
            " it must stay above 0 m",
        ),
        (
            "the trolley is on the axis, where `phi` is undefined",
            "at t = 0 s the trolley reaches the slewing axis: the trolley's distance from the slewing axis is 0 m,"
            " it must stay above 0.001 m",
        ),
        _BAD_STEP,
        _TIME_BACK,
        (
            "time is skipped",
            "the communication point t = 0.5 s lies ahead of the FMU's time 0 s;"
            " to repeat a step restore the FMU's state first",
        ),
        (
            "a step before the initialization",
            "doStep needs a finished initialization, but the FMU is instantiated",
        ),
        ("a parameter outside its range", "load_mass = -1 kg is outside its range [0.001, 1e+09] kg"),
        (
            "a needlessly small `internal_step`",
            "an internal_step of 1e-09 s divides the communication step of 0.1 s into more than 100000 steps",
        ),
        (
            "the path moves while connected derivatives stay exactly zero, for a second step",
            "at t = 0.2 s the load's position changes, but its velocity and acceleration and jerk and snap stay zero:"
            " connect what is missing, or set connected = position to have it estimated",
        ),
        (
            "a step so large, or a path so far away, that the trolley would come out behind the axis",
            "rotary crane, points, projected, backward-euler: at t = 20 s s is -5 m, on another branch of the equations"
            " than the one wanted; a smaller step keeps to its own",
        ),
    ),
    CRANE_PLANT.name: (
        ("an input is NaN or infinite", "at t = 0 s the input F is nan, not a finite number"),
        (
            "the rope would have to push",
            "at t = 0.1 s the rope goes slack: its tension is -819.9 N, it must stay above 0 N",
        ),
        (
            "inputs beyond reason",
            "the step from t = 0 s to 0.1 s has no finite result: the inputs are too large, or internal_step is",
        ),
        (
            "a start that no crane can take",
            "at t = 0 s the load is not below the girder: the load's depth below the girder is -1 m,"
            " it must stay above 0 m",
        ),
        _BAD_STEP,
        ("a parameter outside its range", "mass_error = -2 is outside its range [-0.9, 10]"),
    ),
    LOAD_TRAJECTORY.name: (
        ("a `ramp` for another profile", "a ramp belongs to the profile three-phase, not to degree9"),
        (
            "a `ramp` longer than half of the duration",
            "a path with a ramp of 11 s takes at least 22 s, but its duration is 20 s",
        ),
        ("`file` without a table", "the profile file needs a table, and the FMU was built without one"),
        ("a parameter that is not finite", "duration = nan s is not a finite number"),
        _TIME_BACK,
    ),
}
"""What each FMU refuses: situation, and the sentence for one example; the tests provoke them all."""

_STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse}td,th{border:1px solid #ccc;padding:.3em .6em;text-align:left;vertical-align:top}"
    "code{background:#f4f4f4;padding:0 .2em}pre{background:#f4f4f4;padding:.6em;line-height:1.2}"
)


def user_page(kind: FmuKind, fmu: bytes) -> str:
    """Return the page of an FMU as Markdown.

    Parameters
    ----------
    kind : FmuKind
        Which one.
    fmu : bytes
        Its archive, or that of the native one; all that is read is the model description.
    """
    described = fmpy.read_model_description(io.BytesIO(fmu), validate=False)
    environment = Environment(undefined=StrictUndefined, trim_blocks=True, autoescape=False, keep_trailing_newline=True)
    template = environment.from_string((_TEMPLATES / f"{kind.page}.j2").read_text(encoding="utf-8"))
    return template.render(
        table=lambda causality: _table(described.modelVariables, causality),
        refusals=REFUSALS[kind.name],
        amplifications=[(name, amplification(k)) for k, name in enumerate(ORDERS[:-1])],
    )


def documentation_page(kind: FmuKind, fmu: bytes) -> str:
    """Return the page as a complete HTML document."""
    alone = _LOCAL_LINK.sub(r"\1", user_page(kind, fmu))  # inside the FMU there are no other pages
    body = MarkdownIt("commonmark").enable("table").render(alone)
    head = f'<meta charset="utf-8"><title>{kind.file_name}</title><style>{_STYLE}</style>'
    return f'<!DOCTYPE html>\n<html lang="en">\n<head>{head}</head>\n<body>\n{body}</body>\n</html>\n'


def _table(variables: list[Any], causality: str) -> str:
    """Return the variables of one causality, those of `fmpy`, as a table."""
    third = {"input": "start", "output": "range", "parameter": "default, range, change"}[causality]
    rows = [
        f"| `{each.name}` | {each.unit or 'choice'} | {_extent(each)} | {_text(each)} |"
        for each in variables
        if each.causality == causality
    ]
    return "\n".join([f"| name | unit | {third} | |", "|---|---|---|---|", *rows])


def _text(variable: Any) -> str:
    """Return the description, of a choice with the numbers of its items."""
    items = variable.declaredType.items if variable.type == "Enumeration" else []
    described = variable.description.replace("|", r"\|")  # a bar would end the cell
    return ": ".join([described, *([", ".join(f"{e.value} {e.name}" for e in items)] if items else [])])


def _extent(variable: Any) -> str:
    """Start value, range and variability in a few characters."""
    low, high, start = (None if each is None else float(each) for each in (variable.min, variable.max, variable.start))
    if low is not None and high is not None:
        bounds = f"{low:g} to {high:g}"
    else:
        bounds = f">= {low:g}" if low is not None else f"<= {high:g}" if high is not None else ""
    change = variable.variability if variable.causality == "parameter" else ""
    begun = "" if start is None else f"{start:g}"
    if variable.type == "Enumeration" and start is not None:
        begun = f"`{variable.declaredType.items[int(start) - 1].name}`"
    return ", ".join(each for each in (begun, bounds, change) if each)
