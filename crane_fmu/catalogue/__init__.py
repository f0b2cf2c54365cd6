"""What there is, by name: formulations, methods, time laws, models of the crane, and the FMUs.

The command line, the FMUs, their pages and their checks read the same tables. The first name of each is the default.
"""

from crane_fmu.catalogue.choices import FORMULATIONS, METHODS, MODELS, PROFILES, chosen
from crane_fmu.catalogue.fmu_kinds import (
    CRANE_PLANT,
    FROM_FILE,
    KINDS,
    LOAD_TRAJECTORY,
    NO_STARTS,
    ROTARY_CRANE,
    FmuKind,
    Starts,
    at_rest,
)
from crane_fmu.catalogue.names import DIMENSION, FEEDBACK_INPUTS, ORDERS, PATH_INPUTS, components

__all__ = [
    "CRANE_PLANT",
    "DIMENSION",
    "FEEDBACK_INPUTS",
    "FORMULATIONS",
    "FROM_FILE",
    "KINDS",
    "LOAD_TRAJECTORY",
    "METHODS",
    "MODELS",
    "NO_STARTS",
    "ORDERS",
    "PATH_INPUTS",
    "PROFILES",
    "ROTARY_CRANE",
    "FmuKind",
    "Starts",
    "at_rest",
    "chosen",
    "components",
]
