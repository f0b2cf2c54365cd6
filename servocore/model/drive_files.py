"""Drives from a TOML file: a table for each input, with the data of its data sheet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

from servocore.errors import InvalidModel, InvalidSetting
from servocore.model.drives import Drive
from servocore.model.parameter_files import read_table


def read_drives(path: str | Path) -> dict[str, Drive]:
    """Read drives from a TOML file, as `Scene.with_drives` takes them.

    Parameters
    ----------
    path : str or Path
        A table for each input, such as ``[M_b]``, with ``ratio = 120`` and ``motor_inertia = "0.012 kg m^2"``; a
        number without unit is in SI units.

    Returns
    -------
    dict of str to Drive
        By the names of inputs.

    Raises
    ------
    InvalidModel
        If the file cannot be read or is not TOML, or a value is unknown, has the wrong unit or is outside its range;
        the message names file, input and value.
    """
    path, known = Path(path), [each.name for each in fields(Drive)]
    drives = {}
    for name, data in read_table(path).items():
        if not isinstance(data, Mapping):
            raise InvalidModel(f"{path}: {name} is no drive: write a table [{name}] with lines such as ratio = 42.1")
        if wrong := [key for key in data if key not in known]:
            raise InvalidModel(f"{path}: [{name}] has no {', '.join(wrong)}; a drive has {', '.join(known)}")
        try:
            drives[name] = Drive(**data)
        except (InvalidModel, InvalidSetting) as error:
            raise InvalidModel(f"{path}: [{name}]: {error}") from None
    return drives
