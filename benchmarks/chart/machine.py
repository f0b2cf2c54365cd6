"""What the study ran on: processor, system and versions, without names of machines or places."""

from __future__ import annotations

import datetime
import importlib.metadata
import os
import platform
from collections.abc import Iterable
from pathlib import Path


def processor() -> str:
    """Return the model of the processor, with its clock where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    found: dict[str, str] = {}
    for line in lines:
        key, _, value = line.partition(":")
        found.setdefault(key.strip(), value.strip())
    name = found.get("model name") or platform.machine()
    family = ", ".join(f"{key} {found[key]}" for key in ("cpu family", "model") if key in found)
    return f"{name} ({family})" if family else name


def version(distribution: str) -> str:
    """Return the version of an installed distribution, or that it is not there."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def facts(distributions: Iterable[str]) -> list[tuple[str, str]]:
    """List what was used, by name."""
    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    listed = [
        ("Date", today),
        ("Processor", processor()),
        ("Processors used", f"1 of {os.cpu_count()}"),
        ("System", f"{platform.system()} {platform.machine()}"),
        ("Python", platform.python_version()),
    ]
    return [*listed, *((name, version(name)) for name in dict.fromkeys(("servocore", "casadi", "numpy", "scipy",
                                                                        *distributions)))]  # fmt: skip
