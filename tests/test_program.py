"""`Program` names its worst equation, and paths keep limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from problems import METHODS, scene

import servocore as sc
from servocore.checks.before_run import require_feasible

CRANE = scene("rotary_crane")


@pytest.mark.parametrize("method", [each.method for each in METHODS], ids=lambda method: method.name)
def test_the_worst_equation_of_a_step_is_one_of_its_equations(method: sc.Method) -> None:
    """Also where a step has several stages, each with all equations."""
    several = sc.Stepper(CRANE, sc.Projected(), method, 0.1)
    program, state = several.program, np.full(several.program.state_size, 0.3)
    for k in range(6):
        jets = np.random.default_rng(k).normal(size=(len(program.nodes), program.start_order + 1, 3))
        assert program.worst_equation(state, jets, 0.1, several.parameters) in program.equations
    jets[0] = np.nan
    assert program.worst_equation(state, jets, 0.1, several.parameters) in program.equations


@pytest.mark.parametrize("margin", [0.0, -1.0, float("nan")])
def test_a_margin_that_is_not_positive_breaks_the_limit_of_a_path(margin: float) -> None:
    def scene_with(value: float) -> sc.Scene:
        gap = sc.Limit("the gap", "m", 0.5, "they touch", lambda gamma, _: 0.5 + value + 0.0 * gamma[0, 0])
        return replace(CRANE, limits=(*CRANE.limits, gap))

    require_feasible(sc.Problem.of(scene_with(1e-9)))
    with pytest.raises(sc.InvalidReference, match=r"at t = 0 s they touch: the gap is .* m, it must stay above 0.5 m"):
        require_feasible(sc.Problem.of(scene_with(margin)))
