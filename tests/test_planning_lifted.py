"""Plans for systems whose motion no formula gives from the path: it is part of the plan, held by the equations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from outside.systems import elbow_arm
from problems import car_chain, changed
from test_planning import fastest_alone

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.planning.tasks import corner_problems, curve_of, with_a_formula

ARM = elbow_arm()
WAY = [(1.2, 0.6), (1.0, 0.9)]
TORQUES = {"T_1": 0.9, "T_2": 0.25}


def exact(path: sc.Reference) -> Mapping[str, Array]:
    return replace(ARM, scene=ARM.scene.with_reference(path), order=2).exact(np.linspace(0.0, path.duration, 4001))


@pytest.mark.parametrize("compared", [True, False])
def test_torques_of_an_arm_keep_their_limits_by_its_closed_form(compared: bool) -> None:
    plan = sc.fastest if compared else fastest_alone
    path, report = plan(ARM.scene, WAY, TORQUES, intervals=20 if compared else 10)
    peaks = {name: np.abs(exact(path)[name]).max() for name in TORQUES}
    assert all(peaks[name] <= bound for name, bound in TORQUES.items())
    assert max(peaks[name] / bound for name, bound in TORQUES.items()) > 0.99
    assert report.violation == 0.0
    assert report.duration < min(report.degree9, report.three_phase)


def test_a_rate_of_what_stands_last_in_the_equations_is_limited() -> None:
    limits = {"T_1": 9.0, "T_1.rate": 2.0, "T_2": 9.0}
    path, _ = fastest_alone(ARM.scene, WAY, limits, intervals=10, smooth=1)
    steepest = np.abs(np.diff(exact(path)["T_1"]) / (path.duration / 4000)).max()
    assert 1.9 < steepest <= 2.0


def test_a_place_out_of_reach_is_named() -> None:
    with pytest.raises(sc.InvalidReference, match=r"no motion is found that rests at \(1\.698, 0\.6\)"):
        sc.fastest(ARM.scene, [(1.2, 0.6), (2.4, 0.6)], TORQUES)


def hardening_chain(masses: int = 3) -> sc.MechanicalSystem:
    """Masses on springs that grow stiffer, driven at one end and tracked at the other: three are of index 7."""
    springs = masses - 1
    cars = car_chain([1.0] * masses, [400.0] * springs, [0.0] * springs)
    stretched = [cars.q[k] - cars.q[k + 1] for k in range(springs)]
    potential = sum(200.0 * each**2 + 1000.0 * each**4 for each in stretched)
    return changed(cars, name="hardening chain", potential=potential)


@pytest.mark.parametrize(("masses", "compared"), [(3, True), (2, False)])
def test_a_chain_of_high_index_is_planned_without_a_formula(masses: int, compared: bool) -> None:
    plan = sc.fastest if compared else fastest_alone
    model = partial(hardening_chain, masses)
    scene = sc.Scene("chain", {"only": model}, sc.rest_to_rest((0.0,), (1.0,), 3.0, sc.DEGREE13))
    path, report = plan(scene, [(0.0,), (1.0,)], {"F": 20.0}, intervals=10)
    peak = np.abs(sc.ExactInversion(scene.with_reference(path))(np.linspace(0.0, path.duration, 2001))).max()
    assert path.smoothness == 2 * masses
    assert 0.97 * 20.0 < peak <= 20.0
    assert report.duration >= 2.0 * np.sqrt(masses / 20.0)  # momentum
    assert report.duration < report.degree9


def test_another_model_that_has_a_formula_is_planned_for_if_its_limits_are_the_same() -> None:
    crane = sc.scenes.gantry_crane()
    stronger = replace(crane.model("points"), input_matrix=2 * crane.model("points").input_matrix)
    curve = curve_of([(0, 0, -4), (4, 2, -3)], 3, "cranes")
    for points, same in ((crane.model("points"), True), (stronger, False)):
        models: dict[str, Callable[[], sc.MechanicalSystem]] = {"points": partial(replace, points)}
        models["generalized"] = crane.models["generalized"]
        scene = sc.Scene("cranes", models, crane.reference).with_limits(F_x=200.0)
        corners = corner_problems(scene, "generalized", {})
        assert (with_a_formula(scene, corners, {}, curve) is not corners) == same
