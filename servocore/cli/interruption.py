"""Ctrl-C: raised where Python runs, and remembered where a library in another language swallows it.

This module imports nothing but the standard library: a command begins here, before its own imports take their time.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import FrameType
from typing import Any, TextIO, cast

INTERRUPTED = 130
"""Exit code of a command that was stopped, as shells have it: 128 and the number of the signal."""

_asked = threading.Event()


def was_asked() -> bool:
    """Return whether Ctrl-C was pressed while the present command runs."""
    return _asked.is_set()


def stop_if_asked() -> None:
    """Raise `KeyboardInterrupt` if Ctrl-C was pressed and whoever ran then went on regardless."""
    if _asked.is_set():
        raise KeyboardInterrupt


@contextmanager
def heeded_interruption() -> Iterator[None]:
    """Remember Ctrl-C inside; where it is ignored, as in the background of a shell, it stays so."""
    _asked.clear()
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is not signal.default_int_handler:
        yield
        return

    errors, unraisable = sys.stderr, sys.unraisablehook

    def heed(number: int, frame: FrameType | None) -> None:
        _asked.set()
        sys.stderr = cast("TextIO", _WithoutCasadi(errors))
        signal.default_int_handler(number, frame)

    def tell_of_others(swallowed: sys.UnraisableHookArgs) -> None:
        if not isinstance(swallowed.exc_value, KeyboardInterrupt):  # as in a callback: `stop_if_asked` comes to it
            unraisable(swallowed)

    signal.signal(signal.SIGINT, heed)
    sys.unraisablehook = tell_of_others
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        sys.stderr, sys.unraisablehook = errors, unraisable


def run_command_line(name: str, module: str) -> None:
    """Import a module and run its command line ``app``; Ctrl-C in between ends with the same sentence as behind it.

    Parameters
    ----------
    name : str
        What the command is called.
    module : str
        Where its ``app`` is.
    """
    try:
        with heeded_interruption():
            app = import_module(module).app
            stop_if_asked()
            app(prog_name=name)
    except (Exception, KeyboardInterrupt) as error:  # an import may make another error of it
        if not (was_asked() or isinstance(error, KeyboardInterrupt)):
            raise
        print(f"{name}: stopped", file=sys.stderr)
        sys.exit(INTERRUPTED)


class _WithoutCasadi:
    """The error stream without CasADi's lines, which come in pieces: it warns of Ctrl-C, which is told once."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._left_out = stream, False

    def write(self, text: str) -> int:
        self._left_out |= text.startswith("CasADi - ")
        if not self._left_out:
            return self._stream.write(text)
        self._left_out = not text.endswith("\n")
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
