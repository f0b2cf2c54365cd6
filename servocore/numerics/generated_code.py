"""C source that this package generates, compiled to machine code where that pays."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import casadi as ca

from servocore.numerics.machine_code import BACKGROUND, Build, automatic, built, library_of

MANY = 10_000
"""Instants from which on machine code is worth being made for a first call."""

_SECOND = 2  # call from which on it is worth a look
_MOST_OPERATIONS = 30_000  # of all expressions together: beyond, compilers take minutes


class GeneratedCode(ABC):
    """What has a source in C, and evaluates by CasADi's interpreter until that is compiled.

    Parameters
    ----------
    functions : sequence of casadi.Function
        What is written as C; that of expressions can be.
    native : bool or None
        Whether as machine code: True makes it now, False never; with None it is used if it was made before, and made
        in the background when there is enough to do.
    of_what : str
        For messages.
    again : bool
        Whether what it is for was evaluated before.

    Raises
    ------
    InvalidSetting
        If there is no C compiler for `native`, or it does not compile.
    """

    def __init__(
        self, functions: Sequence[ca.Function], native: bool | None, of_what: str, again: bool = False
    ) -> None:
        self._of_what = of_what
        self._run: Any = None
        self._build: Build | None = None
        self._calls = int(again)
        self._asked = False
        self._settled = native is False or not _short(functions)
        if native and not self._settled:
            self._require()

    @abstractmethod
    def _source(self) -> str | None:
        """Return the source; None if an operation has no counterpart."""

    @abstractmethod
    def _load(self, library: Any) -> None:
        """Set what runs from a library."""

    def ready(self, count: int, called: bool = False) -> bool:
        """Whether machine code is there for so many instants, of which a call (is it one?) brings it nearer."""
        self._calls += called
        if not self._settled:
            self._look(count)
        return self._run is not None

    def _require(self) -> None:
        source = self._source()
        self._settled = True
        if source is not None:
            self._load(built(Build(source, self._of_what, True)))

    def _look(self, count: int) -> None:
        """Take machine code that is there; ask for it where there is much to do."""
        if self._calls < _SECOND and count < MANY:
            return  # to write the source takes longer than to evaluate once
        if self._build is None:
            source = self._source() if automatic() else None
            if source is None:
                self._settled = True
                return
            self._build = Build(source, self._of_what, True)
        elif self._asked and BACKGROUND.pending(self._build):
            return
        if not self._asked or not BACKGROUND.pending(self._build):
            library = library_of(self._build)
            if library is not None:
                with suppress(OSError):
                    self._load(library)
            self._settled = library is not None or self._asked
        if not self._settled:
            self._asked = True
            BACKGROUND.ask(self._build)


def _short(functions: Sequence[ca.Function]) -> bool:
    expressions = all(function.is_a("SXFunction") for function in functions)
    return expressions and sum(function.n_instructions() for function in functions) <= _MOST_OPERATIONS
