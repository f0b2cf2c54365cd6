"""Memoization: the only cache of results besides `cached_property`."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import ParamSpec, TypeVar, cast

Settings = ParamSpec("Settings")
Made = TypeVar("Made")

_MOST = 256  # results per function; beyond, those not used for longest are dropped


def made_once(make: Callable[Settings, Made], most: int = _MOST) -> Callable[Settings, Made]:
    """Memoize a function: with equal arguments it returns the same object.

    Compiling takes longer than solving, and many solves share a system. Arguments are hashable; systems and compiled
    functions are equal if they are the same object. The `most` results that were used last are kept.
    """
    return cast("Callable[Settings, Made]", lru_cache(maxsize=most)(make))
