"""The page in an FMU that a tool's Help button opens."""

from __future__ import annotations

from servocore.export.inverse_model import InverseModel
from servocore.export.sources import rendered


def documentation(model: InverseModel, fmi: int, targets: tuple[str, ...]) -> bytes:
    """Return the page as HTML."""
    mathematics = model.mathematics
    return rendered(
        "page.html.j2",
        model=model,
        fmi=fmi,
        targets=targets,
        integrated=mathematics.state_size > 0 and bool(model.method),
        unproven=[name for name in targets if name.endswith("darwin")],
    ).encode()
