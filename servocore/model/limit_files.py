"""Limits from texts and files, as arguments of `Scene.with_limits`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from servocore.errors import InvalidModel, InvalidSetting
from servocore.model.limits import Bounds
from servocore.model.parameter_files import read_table


def limits_of_texts(texts: Iterable[str]) -> dict[str, Bounds]:
    """Return limits from texts such as ``F=60``, ``M_w=-104..-92`` or ``swing=5 deg``.

    Parameters
    ----------
    texts : iterable of str
        One per limit.

    Raises
    ------
    InvalidSetting
        If a text is not a limit, or a name is given twice.
    """
    by_name: dict[str, Bounds] = {}
    for text in texts:
        name, equals, bounds = (part.strip() for part in text.partition("="))
        lower, pair, upper = (side.strip() for side in bounds.partition(".."))
        if name in by_name:
            raise InvalidSetting(f"--limit gives {name} twice, the second time as {text!r}")
        if not (name and equals and bounds.strip(".")):
            raise InvalidSetting(
                f"--limit {text!r} is not NAME=NUMBER or NAME=LOW..HIGH, such as F=60, M_w=-104..-92, swing=5deg or"
                f" s.rate=1.2"
            )
        if ":" in bounds:
            raise InvalidSetting(f"--limit {text!r}: a range is written {name}={bounds.replace(':', '..', 1)}")
        by_name[name] = (lower or None, upper or None) if pair else lower
    return by_name


def limits_given(texts: Iterable[str] | None, file: str | Path | None) -> dict[str, Bounds]:
    """Return the limits of a file and of texts, which replace those of the file.

    Parameters
    ----------
    texts : iterable of str or None
        One per limit: ``F=60``, ``M_w=-104..-92``, ``swing=5 deg`` or ``s.rate=1.2``.
    file : str, Path or None
        TOML, see `read_limits`.

    Returns
    -------
    dict
        Arguments of `Scene.with_limits`.

    Raises
    ------
    InvalidModel, InvalidSetting
        If the file cannot be read or a limit is invalid.
    """
    return {**({} if file is None else read_limits(file)), **limits_of_texts(texts or ())}


def factors_of_texts(texts: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Return factors of parameters from texts such as ``load_mass=0.9..1.1``.

    Parameters
    ----------
    texts : iterable of str
        One per parameter.

    Returns
    -------
    dict of str to tuple of float
        Lower and upper factor by the name of the parameter.

    Raises
    ------
    InvalidSetting
        If a text is not a limit, or a name is given twice.
    """
    factors: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, _, both = (part.strip() for part in text.partition("="))
        low, _, high = both.partition("..")
        if name in factors:
            raise InvalidSetting(f"--robust gives {name} twice, the second time as {text!r}")
        try:
            factors[name] = (float(low), float(high))
        except ValueError:
            raise InvalidSetting(f"--robust {text!r} is not NAME=LOW..HIGH, such as load_mass=0.9..1.1") from None
    return factors


def read_limits(path: str | Path) -> dict[str, Bounds]:
    """Read limits from a TOML file: ``F = 60``, ``M_w = [-104, -92]``, ``swing = "5 deg"``, ``s.rate = 1.2``.

    Parameters
    ----------
    path : str or Path
        Names at top level, or in a table ``[limits]``.

    Returns
    -------
    dict
        Arguments of `Scene.with_limits`. Beside a limit of ``s``, that of its rate needs quotation marks,
        ``"s.rate" = 1.2``: in TOML ``s.rate`` is a key of a table ``s``.

    Raises
    ------
    InvalidModel
        If the file cannot be read or is not TOML, or a value is not a number, a text or a pair of these.
    """
    path = Path(path)
    try:
        table = read_table(path)
    except InvalidModel as error:
        if "overwrite" not in str(error):
            raise
        raise InvalidModel(
            f'{error}: a name is given twice, or one and its rate, which is then written "s.rate" = 1.2, in quotation'
            " marks"
        ) from None
    inner = table.get("limits")
    if isinstance(inner, Mapping) and len(table) == 1:
        table = dict(inner)
    limits: dict[str, Bounds] = {}
    for name, value in table.items():
        if isinstance(value, Mapping):  # in TOML s.rate is a table s
            limits |= {
                f"{name}.{derivative}": _bounds(path, f"{name}.{derivative}", inside)
                for derivative, inside in value.items()
            }
        else:
            limits[name] = _bounds(path, name, value)
    return limits


def _bounds(path: Path, name: str, value: object) -> Bounds:
    if isinstance(value, list) and len(value) == 2 and all(_is_bound(bound) for bound in value):
        return (value[0], value[1])
    if isinstance(value, float | int | str) and _is_bound(value):
        return value
    raise InvalidModel(
        f"{path}: the limit of {name} must be a number, a text with a unit or two of these, not {value!r}"
    )


def _is_bound(value: object) -> bool:
    return isinstance(value, int | float | str) and not isinstance(value, bool)
