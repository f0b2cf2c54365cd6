"""Just-in-time compilation: what is interpreted becomes machine code where that pays."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from pathlib import Path

    from servocore.numerics.machine_code import Build

# Compilers are imported where one is needed: a program that solves once needs none.

MANY = 10_000
"""Instants from which on machine code is worth being made for a first call."""

NAME, LANES = "sc_run", 8
"""What a function of many instants is called in its library, and how many of them it takes at once, at least."""

_SECOND = 2  # call from which on it is worth a look

Loaded = TypeVar("Loaded")


@dataclass
class Use:
    """Counter of calls that decides whether machine code is worth its compilation."""

    calls: int = 0

    def pays(self, count: int, called: bool = True) -> bool:
        """Count a call if this is one; return whether the calls, or so many instants, are worth a compilation."""
        self.calls += called
        return self.calls >= _SECOND or count >= MANY


class JustInTime(Generic[Loaded]):
    """Machine code that is there as soon as it is worth being made.

    Parameters
    ----------
    make : callable
        () -> what is to be built; None if it cannot be written as C, or is too long.
    load : callable
        Library -> what runs from it.
    native : bool or None
        True makes it now, False never; with None it is used if it was made before, and made in the background when
        there is enough to do.
    again : bool
        Whether what it is for was evaluated before.

    Raises
    ------
    InvalidSetting
        If there is no C compiler for `native`, or it does not compile.
    """

    def __init__(
        self,
        make: Callable[[], Build | None],
        load: Callable[[Path], Loaded],
        native: bool | None = None,
        again: bool = False,
    ) -> None:
        self._make, self._load, self._use = make, load, Use(int(again))
        self._build: Build | None = None
        self._loaded: Loaded | None = None
        self._settled = native is not None
        build = make() if native else None
        if build is not None:
            from servocore.numerics.machine_code import built  # noqa: PLC0415

            self._loaded = load(built(build))

    def best(self, count: int, called: bool = True) -> Loaded | None:
        """Return machine code for so many instants if it is there; a call (is this one?) brings it nearer."""
        if self._use.pays(count, called) and not self._settled:
            self._look()
        return self._loaded

    def _look(self) -> None:
        """Take machine code that is there; have it built if it is not."""
        from servocore.numerics.machine_code import BACKGROUND, automatic, library_of  # noqa: PLC0415

        if self._build is None:
            self._build = self._make() if automatic() else None
        if self._build is None:
            self._settled = True
        elif not BACKGROUND.pending(self._build):
            library = library_of(self._build)
            if library is not None:
                with suppress(OSError, RuntimeError):  # a library that cannot be loaded
                    self._loaded = self._load(library)
            self._settled = library is not None or not BACKGROUND.ask(self._build)


Holder = TypeVar("Holder")


def in_machine_code(holder: Holder, names: tuple[str, ...], of_what: str, native: bool | None) -> JustInTime[Holder]:
    """Return a value with some of its functions as machine code; `of_what` is for messages, see `JustInTime`."""

    def make() -> Build:
        from servocore.numerics.machine_code import build_of  # noqa: PLC0415

        return build_of({name: getattr(holder, name) for name in names}, of_what)

    def load(library: Path) -> Holder:
        from servocore.numerics.machine_code import loaded  # noqa: PLC0415

        made = copy(holder)
        vars(made).update({name: loaded(library, name) for name in names})
        return made

    return JustInTime(make, load, native)
