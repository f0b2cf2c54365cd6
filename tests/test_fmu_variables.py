"""The one table of variables: numbers follow each other, and a kernel that means others does not compile."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import servocore as sc
from servocore.errors import InvalidSetting
from servocore.export.native_model import NativeModel
from servocore.export.plant_model import plant_model
from servocore.export.sources import fmu_sources
from servocore.export.variables import placed
from servocore.numerics.machine_code import c_compiler, compile_in


def plant() -> NativeModel:
    return plant_model(sc.scenes.mass_on_car())


def look_at(model: NativeModel, folder: Path) -> None:
    """Let the compiler read the kernel with a model's tables."""
    for name, text in fmu_sources(model, 2).items():
        (folder / name).write_text(text, encoding="utf-8")
    compile_in(folder, [*c_compiler(), "-std=c99", "-fsyntax-only", "fmi2.c"], "the kernel")


def test_numbers_follow_each_other_in_the_order_of_the_kernel_whatever_the_order_of_the_rows() -> None:
    variables = plant().variables
    assert placed(reversed(variables))[0].causality == "input"
    place = 0
    for each in variables:
        assert each.place == place
        place += each.size or 1
    kinds = [(each.causality, bool(each.role)) for each in variables]
    assert list(dict.fromkeys(kinds)) == [
        ("input", False), ("output", False), ("parameter", False), ("parameter", True),
    ]  # fmt: skip
    assert kinds == sorted(kinds, key=list(dict.fromkeys(kinds)).index)


@pytest.mark.usefixtures("compiler")
def test_a_kernel_compiles_with_its_tables(tmp_path: Path) -> None:
    look_at(plant(), tmp_path)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("role", ["GUST_START", "WIND", "MOTION", "OFFSETS"])
def test_a_parameter_that_the_kernel_looks_for_in_vain_does_not_compile(role: str, tmp_path: Path) -> None:
    model = plant()
    variables = tuple(replace(each, role="" if each.role == role else each.role) for each in model.variables)
    with pytest.raises(InvalidSetting, match=role):
        look_at(replace(model, variables=variables), tmp_path)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("role", ["WIND", "MOTION"])
def test_a_group_with_a_parameter_more_than_the_kernel_knows_does_not_compile(role: str, tmp_path: Path) -> None:
    model = plant()
    more = next(replace(each, name="one_more") for each in model.variables if each.role == role)
    with pytest.raises(InvalidSetting, match="CHECKED"):
        look_at(replace(model, variables=placed([*model.variables, more])), tmp_path)
