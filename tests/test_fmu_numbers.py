"""What the FMU computes: equal to `solve`, first order to the closed form, right at every kind of step."""

from __future__ import annotations

import numpy as np
import pytest
from fmu_host import OUTPUTS, Host, follow

import servocore as sc

CRANE = sc.scenes.rotary_crane()
MODELS = tuple(CRANE.models)


def test_a_step_that_newton_cannot_solve_is_refused_with_its_times_and_the_worst_equation() -> None:
    """Index 5 on five coordinates fails at this step in `solve` as well; round-off decides where."""
    route = {"model": "generalized", "formulation": "original"}
    with pytest.raises(sc.IntegrationFailed):
        sc.solve(CRANE, sc.Original(), sc.BackwardEuler(), step=0.1, model=route["model"])
    t = np.arange(201.0) * 0.1
    jets = CRANE.reference.jet(t, 4)
    with Host() as host:
        host.set(**route, input_time="end").start(jets[0])
        k = next(k for k in range(200) if not host.tell(jets[k + 1]).step(t[k], t[k + 1] - t[k]))
        assert np.isfinite(host.outputs()).all()
        assert not host.step(t[k], t[k + 1] - t[k])
    assert host.messages[0] == host.messages[1]
    assert f"from t = {t[k]:g} s to {t[k + 1]:g} s was not solved; the worst equation is the" in host.messages[0]


EVEN, VARYING = (1.0,), (1.0, 1.0, 0.5, 2.0, 1.0, 0.7)


@pytest.mark.parametrize("pattern", [EVEN, VARYING], ids=["even", "varying"])
@pytest.mark.parametrize("at", ["start", "end"])
@pytest.mark.parametrize("formulation", ["projected", "original"])
def test_the_error_falls_in_proportion_to_the_step(formulation: str, at: str, pattern: tuple[float, ...]) -> None:
    """Without the rebuilt history M_b would be off by its whole size after every change of the step."""
    errors = []
    for step in (0.05, 0.025, 0.0125):
        t = step * np.concatenate([[0.0], np.cumsum(np.tile(pattern, round(20 / (step * sum(pattern)))))])
        t = t[t < 20.0]
        with Host() as host:
            found = follow(host.set(formulation=formulation), CRANE.reference.jet(t, 4), t, at=at)
        exact = CRANE.exact(t)
        errors.append(max(np.abs(found[name] - exact[name]).max() / np.abs(exact[name]).max() for name in ("M_b", "F")))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (abs(orders - 1.0) < 0.1).all(), errors


def test_steps_of_a_nanosecond_stay_as_exact_as_the_start() -> None:
    """A host takes such steps around events; differences over them would be round-off."""
    t = np.concatenate([np.arange(50, 60) * 0.1, 5.9 + np.arange(1, 4) * 1e-9, np.arange(60, 70) * 0.1])
    with Host() as host:
        found = follow(host.set(formulation="projected"), CRANE.reference.jet(t, 4), t, at="end")
    exact = CRANE.exact(t)
    tiny = slice(10, 13)
    for name in OUTPUTS:
        assert abs(found[name][tiny] - exact[name][tiny]).max() < 1e-9 * abs(exact[name]).max()
    assert abs(found["M_b"][14:] - exact["M_b"][14:]).max() < 0.3 * abs(exact["M_b"]).max()


def test_a_start_in_motion_is_forgotten_after_one_step() -> None:
    t = 5.0 + np.arange(20.0) * 0.01
    with Host() as host:
        found = follow(host.set(formulation="projected"), CRANE.reference.jet(t, 4), t, at="end")
    error = np.abs(found["M_b"] - CRANE.exact(t)["M_b"]) / np.abs(CRANE.exact(np.arange(0, 20, 0.1))["M_b"]).max()
    assert error[0] < 1e-12
    assert error[2:].max() < 0.05


def test_outputs_follow_inputs_during_the_initialization() -> None:
    with Host() as host:
        host.fmu.setupExperiment(startTime=0.0)
        host.fmu.enterInitializationMode()
        assert host["tension"] == pytest.approx(981.0)
        host.set(load_mass=50.0)
        assert host["tension"] == pytest.approx(490.5)


def test_inputs_that_come_only_after_the_initialization_are_taken_for_the_start() -> None:
    jets = CRANE.reference.jet(np.array([7.0, 7.1]), 4)
    with Host() as late, Host() as early:
        early.start(jets[0], 7.0)
        late.start(None, 7.0)
        for host in (late, early):
            host.tell(jets[0])
            assert host.step(7.0, 0.1)
        assert late.outputs().tolist() == early.outputs().tolist()


def test_the_bridge_angle_counts_full_turns() -> None:
    """Three turns in thirty seconds, each step crossing no more than a few degrees."""
    t = np.arange(0.0, 30.0, 0.05)
    rate = 2 * np.pi / 10
    turns = [
        5.0 * rate**k * np.array([np.cos(rate * t + k * np.pi / 2), np.sin(rate * t + k * np.pi / 2)]) for k in range(5)
    ]
    jets = np.zeros((len(t), 5, 3))
    jets[:, :, :2] = np.array(turns).transpose(2, 0, 1)
    jets[:, 0, 2] = -5.0
    for model in MODELS:
        with Host() as host:
            found = follow(host.set(model=model), jets, t, at="end")
        np.testing.assert_allclose(found["phi"], rate * t, atol=1e-9)


@pytest.mark.parametrize("name", ["bridge_inertia", "trolley_mass", "load_mass", "winch_inertia"])
@pytest.mark.parametrize("model", MODELS)
def test_tunable_parameters_take_effect_at_the_next_step(model: str, name: str) -> None:
    heavier = CRANE.with_parameters(**{name: 2.0 * CRANE.parameter_values()[name]})
    t = np.arange(201.0) * 0.1
    wanted = sc.solve(heavier, sc.Projected(), sc.BackwardEuler(), step=0.1, model=model)
    jets = CRANE.reference.jet(t, 4)
    with Host() as host:
        host.set(model=model, formulation="projected", input_time="end").start(jets[0])
        for k in range(1, 120):
            if k == 80:
                host.set(**{name: heavier.parameter_values()[name]})
            host.tell(jets[k])
            assert host.step(t[k - 1], t[k] - t[k - 1])
            if k >= 82:
                for output, value in zip(OUTPUTS, host.outputs(), strict=True):
                    assert value == pytest.approx(wanted[output][k], abs=1e-8 * np.abs(wanted[output]).max())
