"""Machine code computes what the interpreter computes, all bits but of angles, and says when it cannot be had."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import servocore as sc
from servocore.numerics import machine_code

CRANE = sc.scenes.overhead_crane()


def fresh() -> sc.Scene:
    """Return the crane with a model of its own, for which nothing was compiled before."""
    system = replace(CRANE.model(), name="overhead crane, fresh")
    return replace(CRANE, models={"fresh": lambda: system})


@pytest.mark.parametrize(
    ("scene", "formulation", "method"),
    [(sc.scenes.cars(), sc.Reduced(), sc.BackwardEuler()), (CRANE, sc.Projected(), sc.BackwardEuler()),
     (CRANE, sc.Projected(), sc.RadauIIA(2)), (sc.scenes.mass_on_car(), sc.Reduced(), sc.BDF(2))],
    ids=["exact inversion", "backward Euler", "Radau", "internal dynamics"],
)  # fmt: skip
def test_machine_code_gives_the_same_bits(scene: sc.Scene, formulation: sc.Formulation, method: sc.Method) -> None:
    interpreted, compiled = (sc.solve(scene, formulation, method, native=each) for each in (False, True))
    np.testing.assert_array_equal(compiled.values, interpreted.values)
    assert compiled.statistics == interpreted.statistics


def test_a_program_is_compiled_once() -> None:
    stepper = sc.Stepper(CRANE, sc.Reduced(), sc.BackwardEuler(), 0.1, native=True)
    assert sc.Stepper(CRANE, sc.Reduced(), sc.BackwardEuler(), 0.2, native=True).program is stepper.program


def test_without_a_compiler_machine_code_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "")
    monkeypatch.setattr(machine_code, "COMPILERS", ("no-such-compiler",))
    with pytest.raises(sc.InvalidSetting, match=r"machine code needs a C compiler: .* none of no-such-compiler"):
        sc.solve(fresh(), native=True)


def test_a_compiler_that_fails_is_named_with_its_reason(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    broken = tmp_path / "brokencc"
    broken.write_text("#!/bin/sh\necho 'no space left' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    with pytest.raises(sc.InvalidSetting, match=r"brokencc does not compile overhead crane.*: no space left"):
        sc.solve(fresh(), native=True)


def test_without_checks_the_numbers_are_the_same_and_limits_are_not_looked_at() -> None:
    checked, bare = (sc.solve(CRANE, sc.Reduced(), checks=each) for each in (True, False))
    np.testing.assert_array_equal(bare.values, checked.values)
    # So fast that the rope goes slack: the equations then lead to another branch, which is refused all the same.
    jerked = sc.scenes.rotary_crane().with_reference(sc.rest_to_rest((5.0, 0.0, -1.0), (5.0, 1.0, -0.2), 0.4))
    with pytest.raises(sc.InvalidReference, match="the rope goes slack"):
        sc.solve(jerked, sc.Reduced())
    with pytest.raises(sc.IntegrationFailed):
        sc.solve(jerked, sc.Reduced(), checks=False)
