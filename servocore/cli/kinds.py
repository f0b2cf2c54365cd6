"""Kinds of values on command lines: how a word is read, and what the right form looks like."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from servocore.errors import InvalidSetting
from servocore.model.parameter_files import read_table
from servocore.model.units import in_unit

if TYPE_CHECKING:
    ParamType = click.ParamType[Any]
else:
    ParamType = click.ParamType

_BETWEEN_NUMBERS = re.compile(r"[\s,;]+")


class Kind(ParamType):
    """A kind of value.

    Parameters
    ----------
    what : str
        What refusals call it: ``time``.
    example : str
        A word that is one.
    read : callable
        From the word to the value; raises `ValueError`, or `InvalidSetting` where it knows more to say.
    role : str, optional
        ``read`` or ``written`` of a file; ``numbers`` of a value that has as many words as numbers follow.
    """

    name = "value"

    def __init__(self, what: str, example: str, read: Callable[[str], Any], role: str = "") -> None:
        self.what, self.example, self.read, self.role = what, example, read, role

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:  # noqa: ARG002
        """Read a word, or refuse it with the right form."""
        if not isinstance(value, str):
            return value
        option = flag_of(param)
        right = f"write it as in {option} {self.example}".strip()
        try:
            return self.read(value)
        except InvalidSetting as error:
            raise InvalidSetting(f"{option}: {error}: {right}") from None
        except ValueError:
            raise InvalidSetting(f"{option} {value or repr(value)} is no {self.what}: {right}") from None


def flag_of(param: click.Parameter | None) -> str:
    """Return what an option is called on the command line, empty for an argument."""
    return max(param.opts, key=len) if isinstance(param, click.Option) else ""


def choice(kind: str, table: Mapping[str, Any]) -> Kind:
    """Return the kind of the names in a table; capitals and hyphens do not matter.

    Parameters
    ----------
    kind : str
        What the names are of: ``profile``.
    table : mapping
        Values by name.
    """
    plain = {_plain(name): value for name, value in table.items()}

    def read(name: str) -> Any:
        if _plain(name) not in plain:
            raise InvalidSetting(f"there is no {kind} {name!r}; there are {', '.join(table)}")
        return plain[_plain(name)]

    return Kind(kind, next(iter(table)), read)


def text(example: str) -> Kind:
    """Return the kind of words that a command looks at once it knows its scene, none of them empty."""
    return Kind("text", example, _written)


def quantity(option: str, text: str, unit: str, example: str) -> float:
    """Return a text such as ``5mm`` as a number in the unit that a scene has; raises `InvalidSetting` as `Kind`."""
    try:
        return in_unit(text, unit, option)
    except InvalidSetting as error:
        raise InvalidSetting(f"{error}: write it as in {option} {example}") from None


def _plain(name: str) -> str:
    return re.sub(r"[-_\s]", "", name).lower()


def _written(text: str) -> str:
    if not text:
        raise ValueError
    return text


def _file(text: str) -> Path:
    return Path(_written(text))


def _number(text: str) -> float:
    number = float(text)
    if math.isnan(number):
        raise ValueError
    return number


def _whole(least: int) -> Kind:
    """Return the kind of whole numbers from a least one on."""

    def read(text: str) -> int:
        if int(text) < least:
            raise ValueError
        return int(text)

    return Kind(f"whole number of {least} or more", "100", read)


def _time(text: str) -> float:
    return in_unit(text, "s", "the time")


def _step(text: str) -> float:
    step = _time(text)
    if step <= 0.0:
        raise InvalidSetting(f"the step must be a positive time, not {step:g} s")
    return step


def _point(text: str) -> tuple[float, ...]:
    return tuple(float(word) for word in _BETWEEN_NUMBERS.split(text.strip(" ,;")))


def _names(text: str) -> dict[str, object]:
    if text.endswith(".toml") and "=" not in text:
        return read_table(Path(text))
    ours, _, theirs = (part.strip() for part in text.partition("="))
    if not (ours and theirs):
        raise ValueError
    return {ours: theirs}


def _value(text: str) -> dict[str, float]:
    name, _, number = (part.strip() for part in text.rpartition("="))
    if not (name and math.isfinite(float(number))):
        raise ValueError
    return {name: float(number)}


NUMBER = Kind("number", "1e-3", _number)
COUNT, SEED = _whole(1), _whole(0)
TIME = Kind("time", "20", _time)
STEP = Kind("time", "0.1", _step)
NAMES = Kind("OURS=THEIRS, nor a file that ends in .toml", "F=trolley.force", _names)
VALUE = Kind("NAME=NUMBER", "start.swing=0.1", _value)
POINT = Kind("point", "5 0 -5", _point, "numbers")
FILE_READ = Kind("file name", "FILE", _file, "read")
FILE = Kind("file name", "FILE", _file, "written")
PICTURE = Kind("file name", "FILE.png", _file, "written")
FOLDER = Kind("folder name", "DIR", _file)
