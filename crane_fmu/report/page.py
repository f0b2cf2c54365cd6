"""The page: text, tables and figures in one self-contained HTML file."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

import jinja2
from markupsafe import Markup, escape
from matplotlib.figure import Figure

import servocore as sc
from crane_fmu.report.figures import picture

MEANINGS = {
    "bridge_inertia": ("J_b", "moment of inertia of bridge, trolley and winch about the slewing axis at s = 0"),
    "trolley_mass": ("m_t", "mass of trolley and winch"),
    "load_mass": ("m", "mass of the load"),
    "winch_inertia": ("J_w", "moment of inertia of the winch about its own axis"),
    "winch_radius": ("r_w", "radius of the winch"),
    "gravity": ("g", "acceleration of free fall"),
}
"""Symbol and meaning of every parameter of the crane."""
UNITS = {"kg.m2": "kg m²", "m/s2": "m/s²", "N.m": "N m"}


@dataclass(frozen=True, eq=False)
class Illustration:
    """A figure of the report.

    Attributes
    ----------
    name : str
        Name of its files, without suffix.
    title : str
        A few words.
    by : str
        Form and method of the results; written into the drawing as well.
    caption : str
        Explanation below the figure.
    figure : Figure
        The drawing.
    """

    name: str
    title: str
    by: str
    caption: str
    figure: Figure

    def files(self) -> dict[str, bytes]:
        """Return the picture as the content of files by name."""
        return {self.name + suffix: picture(self.figure, suffix, self.by) for suffix in (".png", ".svg")}


@dataclass(frozen=True)
class Table:
    """A table of the report: title, form and method, headings, rows of formatted texts, and a note."""

    title: str
    by: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


Part = str | Table | Illustration
"""A part of a section; a text is a paragraph."""


@dataclass(frozen=True)
class Fact:
    """A headline number of the page, its meaning, and whether it belongs to the scheme of the paper."""

    value: str
    meaning: str
    of_paper: bool = False


def page(
    title: str,
    facts: Sequence[Fact],
    live: sc.LivePart,
    sections: Mapping[str, Sequence[Part]],
    drawings: Mapping[str, bytes],
) -> str:
    """Return the HTML of the report.

    Parameters
    ----------
    title : str
        Heading of the page.
    facts : sequence of Fact
        Headline numbers.
    live : LivePart
        The interactive part; follows the first section.
    sections : mapping of str to sequence of Part
        Content by heading; tables and illustrations are numbered in this order.
    drawings : mapping of str to bytes
        Content of the pictures' files by name, as `Illustration.files` returns it.
    """
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    environment.filters["formula"] = formula
    environment.filters["base64"] = lambda data: b64encode(data).decode()
    template = environment.from_string(files(__package__).joinpath("template.html").read_text(encoding="utf-8"))
    return template.render(
        title=title, facts=facts, live=live, sections=sections, drawings=drawings, version=sc.__version__
    )


def parameter_table(scene: sc.Scene) -> Table:
    """Return the crane's data."""
    values = scene.parameter_values()
    rows = [
        (symbol, f"{values[parameter.name]:g} {UNITS.get(parameter.unit, parameter.unit)}", parameter.name, meaning)
        for parameter in scene.model().parameters.declared
        for symbol, meaning in (MEANINGS[parameter.name],)
    ]
    return Table(
        "Data of the crane, a declared assumption",
        "input data",
        ("symbol", "value", "parameter", "meaning"),
        tuple(rows),
        "These values were chosen for this report; they are not those of a printed table. "
        "Any of them can be replaced by a file (crane-fmu feedforward --parameters).",
    )


_SYMBOL = re.compile(
    r"\b(?P<indexed>[A-Za-z])_(?P<index>[a-z])\b"
    r"|\bF\b|φ|^[a-z]$"  # the trolley force; the bridge angle; a symbol alone in its cell
    r"|(?<=position )s\b|(?<=length )l\b|(?<=s\()t(?=\))"
    r"|\b[a-z](?= = |\(t\)| \((?:s|m)\)| is the step)"
)


def formula(text: str) -> Markup:
    """Escape a text and set its symbols in italics, those such as ``M_b`` with their index below the line."""

    def drawn(found: re.Match[str]) -> str:
        if found["index"]:
            return f"<i>{found['indexed']}</i><sub>{found['index']}</sub>"
        return f"<i>{found[0]}</i>"

    return Markup(_SYMBOL.sub(drawn, str(escape(text))))


ROUNDING = 1e-9
"""Smaller numbers are round-off, and have one digit."""

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float, digits: int = 3) -> str:
    """Return a number in a few digits, a small one as 1.2·10⁻⁵."""
    if value == 0.0 or abs(value) >= 1e-3:
        return f"{value:.{digits}g}"
    digits = 1 if abs(value) < ROUNDING else min(digits, 2)
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa}·10{str(int(exponent)).translate(_RAISED)}"
