"""Kinds of values on command lines: how a word is read, and an example of the right form."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from servocore.errors import InvalidSetting
from servocore.model.limits import Bounds
from servocore.model.parameter_files import read_table
from servocore.numerics.units import in_unit

if TYPE_CHECKING:
    ParamType = click.ParamType[Any]
else:
    ParamType = click.ParamType

Value = TypeVar("Value")

_BETWEEN_NUMBERS = re.compile(r"[\s,;]+")


class Kind(ParamType):
    """A kind of value.

    Parameters
    ----------
    what : str
        Its name in refusals: ``time``.
    example : str
        A valid word.
    read : callable
        From the word to the value; raises `ValueError`, or `InvalidSetting` with the reason.
    role : str, optional
        ``read`` or ``written`` for a file, ``folder``; ``numbers`` for a value of as many words as numbers follow.
    """

    name = "value"

    def __init__(self, what: str, example: str, read: Callable[[str], Any], role: str = "") -> None:
        self.what, self.example, self.read, self.role = what, example, read, role

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:  # noqa: ARG002
        """Read a word, or refuse it with the right form."""
        if not isinstance(value, str):
            return value
        option = flag_of(param)
        where = f"{option}: " if option else ""  # an argument has no name
        right = f"write it as in {option} {self.example}".strip()
        try:
            return self.read(value)
        except InvalidSetting as error:
            raise InvalidSetting(f"{where}{error}: {right}") from None
        except ValueError:
            raise InvalidSetting(f"{option} {value or repr(value)} is no {self.what}: {right}") from None


def flag_of(param: click.Parameter | None) -> str:
    """Return the long name of an option, empty for an argument."""
    return max(param.opts, key=len) if isinstance(param, click.Option) else ""


def choice(kind: str, table: Mapping[str, Any]) -> Kind:
    """Return the kind of the names in a table, such as ``profile``; capitals and hyphens do not matter."""
    plain = {_plain(name): value for name, value in table.items()}

    def read(name: str) -> Any:
        if _plain(name) not in plain:
            raise InvalidSetting(f"there is no {kind} {name!r}; there are {', '.join(table)}")
        return plain[_plain(name)]

    return Kind(kind, next(iter(table)), read)


def text(example: str) -> Kind:
    """Return the kind of words, none of them empty, that a command reads once the scene is known."""
    return Kind("text", example, _written)


def quantity(option: str, text: str, unit: str, example: str) -> float:
    """Return a text such as ``5mm`` as a number in the unit of the scene; raises `InvalidSetting` as `Kind` does."""
    try:
        return in_unit(text, unit, option)
    except InvalidSetting as error:
        raise InvalidSetting(f"{error}: write it as in {option} {example}") from None


def once(option: str, given: Iterable[Mapping[str, Value]]) -> dict[str, Value]:
    """Return the values of a repeated option by name; raises `InvalidSetting` if a name is given twice."""
    merged: dict[str, Value] = {}
    for each in given:
        if twice := merged.keys() & each.keys():
            raise InvalidSetting(f"{option} gives {twice.pop()} twice")
        merged.update(each)
    return merged


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
    return dict([_assigned(text)])


def _assigned(text: str) -> tuple[str, str]:
    name, _, value = (part.strip() for part in text.rpartition("="))
    if not (name and value):
        raise ValueError
    return name, value


def _value(text: str) -> dict[str, float]:
    name, number = _assigned(text)
    if not math.isfinite(float(number)):
        raise ValueError
    return {name: float(number)}


def _stiffness(text: str) -> dict[str, float]:
    name, equals, number = text.rpartition("=")
    if not float(number) > 0.0 or bool(equals) != bool(name):
        raise ValueError
    return {name: float(number)}


def _limit(text: str) -> dict[str, Bounds]:
    name, value = _assigned(text)
    low, pair, high = (side.strip() for side in value.partition(".."))
    if not (low or high):
        raise ValueError
    if ":" in value:
        raise InvalidSetting(f"a range is written {name}={value.replace(':', '..', 1)}")
    return {name: (low or None, high or None) if pair else low}


def _range(text: str) -> dict[str, tuple[float, float]]:
    name, value = _assigned(text)
    low, _, high = value.partition("..")
    if not -math.inf < float(low) <= float(high) < math.inf:
        raise InvalidSetting(f"the range {value} of {name} is not finite, or does not run from LOW to HIGH")
    return {name: (float(low), float(high))}


def _counted_range(text: str) -> dict[str, tuple[float, float, int | None]]:
    bounds, colon, count = text.partition(":")
    ((name, (low, high)),) = _range(bounds).items()
    if colon and int(count) < 1:
        raise InvalidSetting(f"the range of {name} needs a count of at least 1")
    return {name: (low, high, int(count) if colon else None)}


NUMBER = Kind("number", "1e-3", _number)
COUNT, SEED = _whole(1), _whole(0)
TIME = Kind("time", "20", _time)
STEP = Kind("time", "0.1", _step)
NAMES = Kind("OURS=THEIRS, nor a file that ends in .toml", "F=trolley.force", _names)
LIMIT = Kind("NAME=NUMBER or NAME=LOW..HIGH", "F=60", _limit)
RANGE = Kind("NAME=LOW..HIGH", "load_mass=0.9..1.1", _range)
COUNTED_RANGE = Kind("NAME=LOW..HIGH:COUNT", "load_mass=50..150:100", _counted_range)
STIFFNESS = Kind("stiffness, nor JOINT=STIFFNESS", "1e4", _stiffness)
VALUE = Kind("NAME=NUMBER", "start.swing=0.1", _value)
POINT = Kind("point", "5 0 -5", _point, "numbers")
FILE_READ = Kind("file name", "FILE", _file, "read")
FILE = Kind("file name", "FILE", _file, "written")
PICTURE = Kind("file name", "FILE.png", _file, "written")
FOLDER = Kind("folder name", "DIR", _file, "folder")
