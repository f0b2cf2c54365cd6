"""States as JSON knows them: a host may save what a slave remembers, and restore it in another process."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np


def _plain(value: Any) -> Any:
    if isinstance(value, PlainState):
        return value.to_plain()
    return value.tolist() if isinstance(value, np.ndarray) else value


_READ: Mapping[Any, Callable[[Any], Any]] = {
    "Array": lambda value: np.array(value, dtype=float),
    "float": float,
    "bool": bool,
}


@dataclass(frozen=True, eq=False)
class PlainState:
    """A state that is never changed in place; its fields are numbers, flags and arrays, annotated as such."""

    def to_plain(self) -> dict[str, Any]:
        """Return plain numbers and lists."""
        return {field.name: _plain(getattr(self, field.name)) for field in fields(self)}

    def at(self, time: float) -> Self:
        """Return the same by another clock, for what has a time."""
        return replace(self, time=time)  # type: ignore[call-arg]  # a field of subclasses

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Self:
        """Undo `to_plain`."""
        return cls(**{field.name: _READ[field.type](plain[field.name]) for field in fields(cls)})
