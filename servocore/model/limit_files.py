"""Limits from files, as `Scene.with_limits` takes them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from servocore.errors import InvalidModel
from servocore.model.limits import Bounds
from servocore.model.parameter_files import read_table


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
