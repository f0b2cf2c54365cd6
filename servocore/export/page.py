"""The page in an FMU that a tool's Help button opens."""

from __future__ import annotations

from servocore.export.native_model import NativeModel
from servocore.export.sources import rendered


def documentation(model: NativeModel, fmi: int, targets: tuple[str, ...]) -> bytes:
    """Return the page as HTML."""
    unproven = [name for name in targets if name.endswith("darwin")]
    return rendered("page.html.j2", model=model, fmi=fmi, targets=targets, unproven=unproven).encode()
