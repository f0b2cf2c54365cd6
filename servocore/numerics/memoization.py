"""What is made once: the one way in which results are kept beyond the value that they belong to."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import ParamSpec, TypeVar, cast

Settings = ParamSpec("Settings")
Made = TypeVar("Made")

_MOST = 256  # of one kind: the ones that were not used for longest go


def made_once(make: Callable[Settings, Made], most: int = _MOST) -> Callable[Settings, Made]:
    """Keep what a function makes: asked again with the same arguments, it returns the same object.

    Compiling takes longer than solving, and many solves share a system. Arguments are hashable; systems and compiled
    functions are the same if they are identical. Of what one function makes, the `most` that were used last are kept.
    """
    return cast("Callable[Settings, Made]", lru_cache(maxsize=most)(make))
