"""Ctrl-C: raised where Python runs, and remembered where a library in another language swallows it.

This module imports nothing but the standard library: a command begins here, before its own imports take their time.
"""

from __future__ import annotations

import gc
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import FrameType, ModuleType
from typing import Any, TextIO, cast

INTERRUPTED = 130
"""Exit code of an interrupted command, as shells have it: 128 and the number of the signal."""

_pressed = threading.Event()


def was_interrupted() -> bool:
    """Return whether Ctrl-C was pressed since the command began."""
    return _pressed.is_set()


def stop_if_interrupted() -> None:
    """Raise `KeyboardInterrupt` if Ctrl-C was pressed and a library swallowed it."""
    if _pressed.is_set():
        raise KeyboardInterrupt


@contextmanager
def heeded_interruption() -> Iterator[None]:
    """Remember Ctrl-C inside; where it is ignored, as in the background of a shell, it stays so."""
    _pressed.clear()
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is not signal.default_int_handler:
        yield
        return

    errors, unraisable = sys.stderr, sys.unraisablehook

    def heed(number: int, frame: FrameType | None) -> None:
        _pressed.set()
        sys.stderr = cast("TextIO", _WithoutCasadi(errors))
        signal.default_int_handler(number, frame)

    def show_others(swallowed: sys.UnraisableHookArgs) -> None:
        if not isinstance(swallowed.exc_value, KeyboardInterrupt):  # as in a callback
            unraisable(swallowed)

    signal.signal(signal.SIGINT, heed)
    sys.unraisablehook = show_others
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        sys.stderr, sys.unraisablehook = errors, unraisable


def run_command_line(name: str, module: str) -> None:
    """Import a module and run its command line ``app``; Ctrl-C during the import ends in the same way as after it."""
    try:
        with heeded_interruption():
            app = _imported(module).app
            stop_if_interrupted()
            app(prog_name=name)
    except (Exception, KeyboardInterrupt) as error:  # an import may turn it into another error
        if not (was_interrupted() or isinstance(error, KeyboardInterrupt)):
            raise
        print(f"{name}: stopped", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _imported(name: str) -> ModuleType:
    """Import a module whose objects last as long as the process, among which nothing looks for garbage.

    That would take a fifth of the time of a short command: during the import, and at the end once more.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        module = import_module(name)
        gc.freeze()
        return module
    finally:
        if enabled:
            gc.enable()


class _WithoutCasadi:
    """The error stream without CasADi's warnings of Ctrl-C, whose lines come in pieces."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._skipping = stream, False

    def write(self, text: str) -> int:
        self._skipping |= text.startswith("CasADi - ")
        if not self._skipping:
            return self._stream.write(text)
        self._skipping = not text.endswith("\n")
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
