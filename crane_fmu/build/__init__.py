"""Making FMUs: archive, model description, pages, the library for native hosts, the system, cross-check files."""

from crane_fmu.build.fmu import build_fmu
from crane_fmu.build.page import user_page
from crane_fmu.build.ssp import STEP, SystemOptions, build_ssp

__all__ = ["STEP", "SystemOptions", "build_fmu", "build_ssp", "user_page"]
