"""What every slave needs so that nothing it is asked can end its host: guarded callbacks, sentences, refusals."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from threading import RLock
from typing import Any, TypeVar, cast

from pythonfmu.enums import Fmi2Status
from pythonfmu.fmi2slave import Fmi2Slave

from servocore import ServocoreError

ONE_AT_A_TIME = RLock()
"""Hold it to compute: instances share compiled functions and their memory, and a host may run each in a thread."""

Callback = TypeVar("Callback", bound=Callable[..., Any])


def guarded(fallback: Callable[..., Any]) -> Callable[[Callback], Callback]:
    """Let a callback log whatever is raised in it and return `fallback` of its arguments instead."""

    def decorate(method: Callback) -> Callback:
        @wraps(method)
        def call(self: GuardedSlave, *args: Any, **kwargs: Any) -> Any:
            try:
                return method(self, *args, **kwargs)
            except BaseException as error:  # also KeyboardInterrupt: the host would crash on it
                self.report_error(method.__name__, error)
                return fallback(*args, **kwargs)

        return cast("Callback", call)

    return decorate


def nothing(*_: Any) -> None:
    """Return None, whatever the arguments."""


class GuardedSlave(Fmi2Slave):  # type: ignore[misc]  # PythonFMU has no types
    """A slave whose variables are Reals and Enumerations, and which tells the host what went wrong."""

    def report_error(self, callback: str, error: BaseException) -> None:
        """Log an exception; one of servocore's is a sentence for the user, any other is a defect."""
        expected = isinstance(error, ServocoreError)
        sentence = str(error) if expected else f"internal error in {callback}: {type(error).__name__}: {error}"
        self.log(sentence, Fmi2Status.discard if expected else Fmi2Status.error)

    def log(
        self, msg: str, status: Fmi2Status = Fmi2Status.ok, category: str | None = None, debug: None = None
    ) -> None:
        """Tell the host; its logger takes a format, as `printf` does, so percent signs of a text are doubled."""
        super().log(msg.replace("%", "%%"), status, category, debug)

    # The table has no texts and no booleans; PythonFMU's own methods raise, which would end the host.

    @guarded(nothing)
    def set_string(self, vrs: list[int], _: list[str]) -> None:
        """Refuse to set."""
        self._refuse(vrs)

    set_boolean = set_string

    @guarded(lambda vrs: [""] * len(vrs))
    def get_string(self, vrs: list[int]) -> list[str]:
        """Refuse, with empty texts."""
        self._refuse(vrs)
        return [""] * len(vrs)

    @guarded(lambda vrs: [False] * len(vrs))
    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Refuse, with False."""
        self._refuse(vrs)
        return [False] * len(vrs)

    def _refuse(self, vrs: list[int]) -> None:
        if vrs:
            self.log("the FMU has no String and no Boolean variables; the call is ignored", Fmi2Status.warning)
