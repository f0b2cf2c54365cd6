"""The user page of an FMU: ``docs/fmu*.md`` and the documentation in the FMU, behind a tool's Help button.

Its tables are made from the variables of the exported model.
"""

from __future__ import annotations

import re
from pathlib import Path

from markdown_it import MarkdownIt

import servocore as sc
from crane_fmu.build.estimates import amplification
from crane_fmu.build.native import OF_PYTHONFMU, native_model
from crane_fmu.catalogue import ORDERS, FmuKind, crane_with
from servocore.export.native_model import NativeModel
from servocore.export.sources import rendered
from servocore.export.variables import Causality, listed

_LOCAL_LINK = re.compile(r"\[([^\]]+)\]\((?!https?:)[^)]+\)")
TEMPLATES = Path(__file__).parent / "resources"

_STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse}td,th{border:1px solid #ccc;padding:.3em .6em;text-align:left;vertical-align:top}"
    "code{background:#f4f4f4;padding:0 .2em}pre{background:#f4f4f4;padding:.6em;line-height:1.2}"
)


def user_page(kind: FmuKind, model: NativeModel | None = None) -> str:
    """Return the page of an FMU as Markdown.

    Parameters
    ----------
    kind : FmuKind
        Which one.
    model : NativeModel, optional
        That of its library; when not given that with the default values.

    Returns
    -------
    str
        The page.
    """
    described = model or native_model(kind, host=OF_PYTHONFMU)
    return rendered(
        f"{kind.page}.j2",
        TEMPLATES,
        table=lambda causality: _table(described, causality),
        verdict=lambda: _verdict(described),
        amplifications=[(name, amplification(k)) for k, name in enumerate(ORDERS[:-1])],
    )


def documentation_page(kind: FmuKind, page: str) -> str:
    """Return the user page of an FMU as a complete HTML document."""
    alone = _LOCAL_LINK.sub(r"\1", page)  # inside the FMU there are no other pages
    body = MarkdownIt("commonmark").enable("table").render(alone)
    head = f'<meta charset="utf-8"><title>{kind.file_name}</title><style>{_STYLE}</style>'
    return f'<!DOCTYPE html>\n<html lang="en">\n<head>{head}</head>\n<body>\n{body}</body>\n</html>\n'


def _verdict(model: NativeModel) -> str:
    """Return the verdict of the certificate of the default crane on its default path."""
    return sc.certify(crane_with({each.name: each.starts[0] for each in model.of("parameter")})).verdict


def _table(model: NativeModel, causality: Causality) -> str:
    """Return the variables of one causality as a table in Markdown."""
    third = {"input": "start", "output": "range", "parameter": "default, range, change"}[causality]
    rows = [f"| name | unit | {third} | |", "|---|---|---|---|"]
    for each in listed(model.of(causality), 2):
        change = each.variability if causality == "parameter" else ""
        extent = filter(None, (*(f"{start:g}" for start in each.starts), each.range, change))
        rows.append(_row(each.name, each.unit, ", ".join(extent), each.description))
    for choice in model.choices if causality == "parameter" else ():
        begun = f"`{choice.items[choice.start - 1][0]}`"
        items = ", ".join(f"{k} {name}" for k, (name, _) in enumerate(choice.items, start=1))
        rows.append(_row(choice.name, "choice", f"{begun}, {choice.variability}", f"{choice.description}: {items}"))
    return "\n".join(rows)


def _row(name: str, unit: str, extent: str, text: str) -> str:
    escaped = text.replace("|", r"\|")  # a bar would end the cell
    return f"| `{name}` | {unit} | {extent} | {escaped} |"
