"""What there is, by name: formulations, methods, profiles, models of the crane, and the FMUs with their variables.

The command line, the FMUs, their pages and their checks read the same tables. The first name of each is the default.
"""

from crane_fmu.catalogue.choices import FORMULATIONS, METHODS, MODELS, chosen
from crane_fmu.catalogue.fmu_kinds import (
    CRANE_PLANT,
    KINDS,
    LOAD_TRAJECTORY,
    NO_STARTS,
    ROTARY_CRANE,
    FmuKind,
    Starts,
    at_rest,
)
from crane_fmu.slave.straight_lines import PROFILES, THREE_PHASE

__all__ = [
    "CRANE_PLANT",
    "FORMULATIONS",
    "KINDS",
    "LOAD_TRAJECTORY",
    "METHODS",
    "MODELS",
    "NO_STARTS",
    "PROFILES",
    "ROTARY_CRANE",
    "THREE_PHASE",
    "FmuKind",
    "Starts",
    "at_rest",
    "chosen",
]
