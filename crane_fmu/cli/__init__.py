"""The command ``crane-fmu``."""

from crane_fmu.cli.commands import app, main

__all__ = ["app", "main"]
