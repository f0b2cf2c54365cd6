"""Reference paths gamma(t): values that answer with exact derivatives at any times."""

from servocore.references.base import Reference
from servocore.references.csv_file import csv_of, from_csv, waypoints_from_csv
from servocore.references.periodic import figure_of_eight, periodic
from servocore.references.profiles import DEGREE3, DEGREE5, DEGREE7, DEGREE9, DEGREE13, Profile, three_phase
from servocore.references.rest_to_rest import rest_to_rest
from servocore.references.splines import sampled, through

__all__ = [
    "DEGREE3",
    "DEGREE5",
    "DEGREE7",
    "DEGREE9",
    "DEGREE13",
    "Profile",
    "Reference",
    "csv_of",
    "figure_of_eight",
    "from_csv",
    "periodic",
    "rest_to_rest",
    "sampled",
    "three_phase",
    "through",
    "waypoints_from_csv",
]
