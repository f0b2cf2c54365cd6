"""Making FMUs: archive, model description, pages, the library for native hosts, the system, cross-check files."""

from crane_fmu.build.fmu import build_fmu, main

__all__ = ["build_fmu", "main"]
