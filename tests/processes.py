"""Python and other programs in processes of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def python(
    *words: object, folder: Path | None = None, seconds: float = 600.0, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run Python with these words in a process of its own."""
    command, variables = [sys.executable, *map(str, words)], os.environ | environment
    return subprocess.run(
        command, capture_output=True, text=True, timeout=seconds, check=False, cwd=folder, env=variables
    )


def in_bare_environment(
    *command: object, folder: Path | None = None, given: str | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run a program that finds other programs, and nothing else of this process's environment."""
    words, variables = list(map(str, command)), {"PATH": os.defpath} | environment
    return subprocess.run(
        words, input=given, capture_output=True, text=True, timeout=600, check=False, cwd=folder, env=variables
    )
