"""How long a law must take: what refusals for a broken limit end with."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from servocore.errors import LimitBroken, ServocoreError
from servocore.model.scene import Scene


@contextmanager
def told_how_long(scene: Scene, model: str | None = None) -> Iterator[None]:
    """Let a refusal for a broken limit say how long the law of the scene's path must take to keep all of them."""
    try:
        yield
    except LimitBroken as error:
        raise LimitBroken(f"{error}; {_how_long(scene, model)}") from None


def _how_long(scene: Scene, model: str | None) -> str:
    from servocore.planning.durations import shortest_duration  # noqa: PLC0415 - planning is for refusals only

    try:
        shortest = shortest_duration(scene, model)
    except LimitBroken:
        return "no duration helps, for a limit is broken even at rest somewhere on that path"
    except ServocoreError:
        return "no duration is known at which it is kept"
    return f"the shortest duration at which the same law keeps all limits is {shortest:.10g} s"
