"""The FMUs of the crane's system have the same variables whether they are native or have Python inside."""

from __future__ import annotations

from typing import Any

import fmpy
import pytest
from fmu_host import fmu_file
from native_fmu import native_file

pytestmark = pytest.mark.usefixtures("compiler")
METHODS = {"internal_step", "model", "formulation"}
"""Of the ways in which the FMU with Python solves an instant: the native one has the exact one alone."""
KINDS: dict[str, tuple[str, set[str]]] = {
    "RotaryCrane": ("rotary_crane loop", METHODS),
    "CranePlant": ("rotary_crane plant", set()),
    "LoadTrajectory": ("rotary_crane trajectory", set()),
}


def variables(file: Any) -> dict[str, tuple[str | None, ...]]:
    """Return type, causality, variability and unit of all variables, and whether and how they are initialized."""
    return {
        each.name: (each.type, each.causality, each.variability, each.unit, each.initial)
        for each in fmpy.read_model_description(str(file)).modelVariables
    }


@pytest.mark.parametrize("name", KINDS)
def test_native_variables_are_those_of_the_fmu_with_python(name: str) -> None:
    of_native, only_python = KINDS[name]
    python, native = variables(fmu_file(name)), variables(native_file(of_native, 2))
    assert python.keys() - native.keys() == only_python
    assert native.keys() <= python.keys()
    for each in python.keys() & native.keys():
        assert native[each] == python[each], each


@pytest.mark.parametrize("name", ["gravity", "winch_radius"])
def test_what_would_move_coordinates_at_once_is_fixed(name: str) -> None:
    """A crane that has another radius of the winch has another length of rope."""
    for file in ("rotary_crane loop", "rotary_crane plant", "overhead_crane"):
        for fmi in (2, 3):
            found = {
                each.name: each for each in fmpy.read_model_description(str(native_file(file, fmi))).modelVariables
            }
            assert found[name].variability == "fixed"
            assert found["load_mass"].variability == "tunable"
