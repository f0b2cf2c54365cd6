"""The user page of an FMU: ``docs/fmu*.md`` and the documentation in the FMU, behind a tool's Help button.

Its tables of variables are made from the model description of the FMU.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import fmpy
from jinja2 import Environment, StrictUndefined
from markdown_it import MarkdownIt

import servocore as sc
from crane_fmu.build.estimates import amplification
from crane_fmu.build.native import OF_PYTHONFMU, native_fmu
from crane_fmu.catalogue import ORDERS, FmuKind

_LOCAL_LINK = re.compile(r"\[([^\]]+)\]\((?!https?:)[^)]+\)")
_TEMPLATES = Path(__file__).parent / "resources"

_STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse}td,th{border:1px solid #ccc;padding:.3em .6em;text-align:left;vertical-align:top}"
    "code{background:#f4f4f4;padding:0 .2em}pre{background:#f4f4f4;padding:.6em;line-height:1.2}"
)


def user_page(kind: FmuKind, fmu: bytes | None = None) -> str:
    """Return the page of an FMU as Markdown.

    Parameters
    ----------
    kind : FmuKind
        Which one.
    fmu : bytes, optional
        Its archive, or that of the native FMU; only the model description is read. Without it nothing is compiled.

    Returns
    -------
    str
        The page.
    """
    fmu = fmu or native_fmu(kind, targets="none", host=OF_PYTHONFMU)
    described = fmpy.read_model_description(io.BytesIO(fmu), validate=False)
    environment = Environment(undefined=StrictUndefined, trim_blocks=True, autoescape=False, keep_trailing_newline=True)
    template = environment.from_string((_TEMPLATES / f"{kind.page}.j2").read_text(encoding="utf-8"))
    return template.render(
        table=lambda causality: _table(described.modelVariables, causality),
        verdict=lambda: _verdict(described.modelVariables),
        amplifications=[(name, amplification(k)) for k, name in enumerate(ORDERS[:-1])],
    )


def documentation_page(kind: FmuKind, fmu: bytes) -> str:
    """Return the page as a complete HTML document."""
    alone = _LOCAL_LINK.sub(r"\1", user_page(kind, fmu))  # inside the FMU there are no other pages
    body = MarkdownIt("commonmark").enable("table").render(alone)
    head = f'<meta charset="utf-8"><title>{kind.file_name}</title><style>{_STYLE}</style>'
    return f'<!DOCTYPE html>\n<html lang="en">\n<head>{head}</head>\n<body>\n{body}</body>\n</html>\n'


def _verdict(variables: list[Any]) -> str:
    """Return the verdict of the certificate of the default crane on its default path."""
    crane = sc.scenes.rotary_crane()
    own = {each.name: float(each.start) for each in variables if each.name in crane.parameter_values()}
    return sc.certify(crane.with_parameters(**own)).verdict


def _table(variables: list[Any], causality: str) -> str:
    """Return the variables of one causality as a table in Markdown."""
    third = {"input": "start", "output": "range", "parameter": "default, range, change"}[causality]
    rows = []
    for each in variables:
        if each.causality == causality:
            items = each.declaredType.items if each.type == "Enumeration" else []
            numbers = [", ".join(f"{item.value} {item.name}" for item in items)] if items else []
            text = ": ".join([each.description.replace("|", r"\|"), *numbers])  # a bar would end the cell
            rows.append(f"| `{each.name}` | {each.unit or 'choice'} | {_extent(each)} | {text} |")
    return "\n".join([f"| name | unit | {third} | |", "|---|---|---|---|", *rows])


def _extent(variable: Any) -> str:
    """Return start value, range and variability as a short text."""
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
