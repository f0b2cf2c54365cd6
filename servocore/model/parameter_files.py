"""Parameters, limits and drives of a scene from TOML files."""

from __future__ import annotations

import warnings
from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from servocore.errors import InvalidModel, InvalidSetting, ServocoreWarning
from servocore.model.drives import Drive, place_of_input
from servocore.model.limits import Bounds
from servocore.model.scene import Scene
from servocore.model.symbols import Parameter


def read_parameters(path: str | Path, scene: Scene, more: Iterable[Parameter] = ()) -> dict[str, float]:
    """Read parameter values of a scene from a file: names at top level, each optional, SI units.

    Parameters
    ----------
    path : str or Path
        A TOML file, such as ``load_mass = 80.0`` or ``M_b.ratio = 120``; names, units and bounds are the scene's.
    scene : Scene
        The scene.
    more : sequence of Parameter
        Further parameters that the file may set.

    Returns
    -------
    dict of str to float
        The values in the file, for `Scene.with_parameters`.

    Raises
    ------
    InvalidModel
        If the file cannot be read or is not TOML, or a key is unknown, is not a number or leaves its bounds;
        the message names the file and the key.
    """
    path = Path(path)
    declared = {parameter.name: parameter for parameter in (*scene.model().parameters.declared, *more)}
    values: dict[str, float] = {}
    for key, value in _by_name(read_table(path), declared):
        if key not in declared and key in scene.effects.parameters:
            warnings.warn(
                f"{path}: {key} is not used: it belongs to an effect that this model leaves out",
                ServocoreWarning,
                stacklevel=2,
            )
            continue
        if key not in declared:
            raise InvalidModel(f"{path}: no parameter is called {key!r}; there are {', '.join(declared)}")
        if isinstance(value, bool) or not isinstance(value, int | float):
            kind = {bool: "a boolean", str: "a text", dict: "a table", list: "a list"}.get(type(value), "a date")
            raise InvalidModel(f"{path}: parameter {key} must be a number, not {kind}")
        try:
            values[key] = declared[key].check(value)
        except InvalidModel as error:
            raise InvalidModel(f"{path}: {error}") from None
    return values


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
    return {name: _bounds(path, name, value) for name, value in _by_name(table)}


def _by_name(table: Mapping[str, Any], known: Container[str] = ()) -> Iterator[tuple[str, Any]]:
    """Yield names and values: in TOML s.rate is a table s, unless that is known itself."""
    for name, value in table.items():
        if isinstance(value, Mapping) and value and name not in known:
            yield from ((f"{name}.{k}", each) for k, each in _by_name(value))
        else:
            yield name, value


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


def read_drives(path: str | Path, scene: Scene) -> dict[str, Drive]:
    """Read drives of a scene from a TOML file, as `Scene.with_drives` takes them.

    Parameters
    ----------
    path : str or Path
        A table for each input, such as ``[M_b]`` or ``[elbow.torque]``, with ``ratio = 120`` and
        ``motor_inertia = "0.012 kg m^2"``; a number without unit is in SI units.
    scene : Scene
        The scene, without these drives.

    Returns
    -------
    dict of str to Drive
        By the names of inputs.

    Raises
    ------
    InvalidModel
        If the file cannot be read or is not TOML, an input or a value is unknown, or a value has the wrong unit or is
        outside its range; the message names file, input and value.
    """
    path, known, drives = Path(path), [each.name for each in fields(Drive)], dict[str, Drive]()
    for key, value in _by_name(read_table(path)):
        name, _, datum = key.rpartition(".")
        if key in known:
            place = f"write {key} in the table of its input, as in [M_b] with lines such as ratio = 42.1"
            raise InvalidModel(f"{path}: {key} is no drive: {place}")
        table = name if name and value != {} else key  # a number at the top level or a table without lines is no drive
        try:
            place_of_input(scene.model(), table)
        except InvalidModel as error:
            raise InvalidModel(f"{path}: {error}") from None
        if table == key:
            raise InvalidModel(f"{path}: {key} is no drive: write a table [{key}] with lines such as ratio = 42.1")
        if datum not in known:
            raise InvalidModel(f"{path}: [{name}] has no {datum}; a drive has {', '.join(known)}")
        try:
            drives[name] = replace(drives.get(name, Drive()), **{datum: value})
        except (InvalidModel, InvalidSetting) as error:
            raise InvalidModel(f"{path}: [{name}]: {error}") from None
    if not drives:
        raise InvalidModel(f"{path} has no drive: write a table for each input, [M_b] with lines such as ratio = 42.1")
    return drives


def read_table(path: Path) -> dict[str, object]:
    """Return the contents of a TOML file; raises `InvalidModel` if it cannot be read."""
    import tomllib  # noqa: PLC0415 - few programs read such files

    path = Path(path)
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InvalidModel(f"{path} cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise InvalidModel(f"{path} is not a TOML file: it is not UTF-8 text") from None
    except tomllib.TOMLDecodeError as error:
        raise InvalidModel(f"{path} is not a TOML file: {error}") from None
    except (ValueError, RecursionError) as error:  # dates that do not exist, tables nested too deeply
        raise InvalidModel(f"{path} is not a TOML file that can be read: {error}") from None
