"""Values that may be missing or of another kind, where a test says that they are not."""

from __future__ import annotations

from typing import TypeVar

Value = TypeVar("Value")


def present(value: Value | None) -> Value:
    """Return the value; a missing one fails the test."""
    assert value is not None
    return value


def of_kind(kind: type[Value], value: object) -> Value:
    """Return the value; one of another kind fails the test."""
    assert isinstance(value, kind)
    return value
