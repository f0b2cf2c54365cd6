"""Ctrl-C: raised where Python runs, and remembered where a library in another language swallows it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

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

    def heed(number: int, frame: FrameType | None) -> None:
        _asked.set()
        signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, heed)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
