"""Just-in-time compilation of interpreted functions where the work is worth it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from pathlib import Path

    from servocore.numerics.machine_code import Build

# The compiler's modules are imported on use: a program that solves once needs none.

MANY = 10_000
"""Number of instants from which on a first call is worth a compilation."""

NAME, LANES = "sc_run", 8
"""Name of a function of many instants in its library, and the least number of instants that it takes."""

_SECOND = 2  # call from which on a compilation is worth it

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
    """Machine code that is compiled in the background, as soon as the work is worth it.

    Parameters
    ----------
    make : callable
        () -> the build; None if it cannot be written as C, or is too long.
    load : callable
        Library -> the loaded function.
    native : bool or None
        True compiles at once, False never. None takes a library from the cache, and compiles in the background if the
        work is worth it.
    again : bool
        Whether the function was evaluated before.

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
        """Return machine code for so many instants if it is compiled; with `called`, count a call."""
        if self._use.pays(count, called) and not self._settled:
            self._obtain()
        return self._loaded

    def _obtain(self) -> None:
        """Load machine code from the cache, or start its compilation in the background."""
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
            self._settled = library is not None or not BACKGROUND.start(self._build)


Holder = TypeVar("Holder")


def in_machine_code(holder: Holder, names: tuple[str, ...], of_what: str, native: bool | None) -> JustInTime[Holder]:
    """Return an object with some of its functions as machine code; `of_what` names it in messages, see `JustInTime`."""

    def make() -> Build:
        from servocore.numerics.machine_code import build_of  # noqa: PLC0415

        return build_of({name: getattr(holder, name) for name in names}, of_what)

    def load(library: Path) -> Holder:
        from servocore.numerics.machine_code import loaded  # noqa: PLC0415

        made = copy(holder)
        vars(made).update({name: loaded(library, name) for name in names})
        return made

    return JustInTime(make, load, native)
