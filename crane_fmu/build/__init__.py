"""Making FMUs: archive, model description, pages, the library for native hosts, the system, cross-check files."""

from crane_fmu.build.fmu import build_fmu, page_of
from crane_fmu.build.ssp import STEP, SystemOptions, build_ssp

__all__ = ["STEP", "SystemOptions", "build_fmu", "build_ssp", "page_of"]
