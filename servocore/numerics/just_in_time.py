"""Just-in-time compilation: functions become machine code in the background, where that pays."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

import casadi as ca

from servocore.numerics.generated_code import MANY
from servocore.numerics.machine_code import BACKGROUND, Build, build_of, compiled, library_of, loaded

Holder = TypeVar("Holder", bound=Any)


def in_machine_code(holder: Holder, names: tuple[str, ...], of_what: str) -> Holder:
    """Return a dataclass with some of its functions as machine code, built now; `of_what` is for messages.

    Raises
    ------
    InvalidSetting
        If there is no C compiler, or it does not compile.
    """
    functions: dict[str, ca.Function] = {name: getattr(holder, name) for name in names}
    made: Holder = replace(holder, **compiled(functions, of_what))
    return made


@dataclass(eq=False)
class JustInTime(Generic[Holder]):
    """A dataclass some functions of which are machine code as soon as that is ready.

    Parameters
    ----------
    interpreted : dataclass
        With the functions as they are.
    names : tuple of str
        Which of its attributes are to become machine code.
    of_what : str
        What they belong to, for messages.
    """

    interpreted: Holder
    names: tuple[str, ...]
    of_what: str
    _calls: int = 0
    _build: Build | None = None
    _made: Holder | None = field(default=None)
    _given_up: bool = False

    def best(self, count: int) -> Holder:
        """Return it as machine code if that is there, and as it is if not; asked again, or for many, it is built."""
        self._calls += 1
        if self._made is not None or self._given_up or (self._calls < 2 and count < MANY):
            return self.interpreted if self._made is None else self._made
        functions: dict[str, ca.Function] = {name: getattr(self.interpreted, name) for name in self.names}
        asked = self._build is not None
        self._build = self._build or build_of(functions, self.of_what)
        if asked and BACKGROUND.pending(self._build):
            return self.interpreted
        library = library_of(self._build)
        if library is not None:
            with suppress(RuntimeError):  # a library that cannot be loaded
                self._made = replace(self.interpreted, **loaded(library, functions))
        self._given_up = self._made is None and (asked or library is not None)
        if not asked and library is None:
            BACKGROUND.ask(self._build)
        return self.interpreted if self._made is None else self._made
