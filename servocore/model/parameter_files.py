"""Parameters of a scene from a TOML file: their names at top level, each optional, SI units."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path

from servocore.errors import InvalidModel, ServocoreWarning
from servocore.model.scene import Scene
from servocore.model.symbols import Parameter


def read_parameters(path: str | Path, scene: Scene, more: Iterable[Parameter] = ()) -> dict[str, float]:
    """Read parameter values of a scene from a file.

    Parameters
    ----------
    path : str or Path
        A TOML file, such as ``load_mass = 80.0``; names, units and bounds are the scene's.
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
    for key, value in read_table(path).items():
        if key not in declared and key in scene.effects.parameters:
            warnings.warn(
                f"{path}: {key} is not used: it belongs to an effect that this model leaves out",
                ServocoreWarning,
                stacklevel=2,
            )
            continue
        if key not in declared:
            raise InvalidModel(f"{path}: no parameter is called {key!r}; there are {', '.join(declared)}")
        values[key] = _number(path, key, value)
        try:
            declared[key].check(values[key])
        except InvalidModel as error:
            raise InvalidModel(f"{path}: {error}") from None
    return values


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


def _number(path: Path, key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        kind = {bool: "a boolean", str: "a text", dict: "a table", list: "a list"}.get(type(value), "a date")
        raise InvalidModel(f"{path}: parameter {key} must be a number, not {kind}")
    try:
        return float(value)
    except OverflowError:
        raise InvalidModel(f"{path}: parameter {key} is too large for a number in double precision") from None
