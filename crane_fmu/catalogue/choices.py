"""Formulations, methods, time laws and models that users choose by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import servocore as sc
from servocore.cli.choices import FORMULATIONS, METHODS

__all__ = ["FORMULATIONS", "METHODS", "MODELS", "PROFILES", "chosen"]

MODELS = tuple(sc.scenes.rotary_crane().models)
"""Models of the crane; the first, and smallest, is the default."""

PROFILES = sc.TIME_LAWS
"""Time laws of a straight line; the first is the default."""

Choice = TypeVar("Choice")


def chosen(table: Mapping[str, Choice], name: str, kind: str) -> Choice:
    """Look a name up; raises `InvalidSetting` with the names there are.

    Parameters
    ----------
    table : mapping of str to Choice
        What there is to choose from.
    name : str
        The name that a user gave.
    kind : str
        What messages call its kind.

    Returns
    -------
    Choice
        Its entry.
    """
    if name not in table:
        raise sc.InvalidSetting(f"there is no {kind} {name!r}; there are {', '.join(table)}")
    return table[name]
