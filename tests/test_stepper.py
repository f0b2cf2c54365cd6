"""`Stepper`: what a step promises beyond the inherited suite: consistent starts, histories, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.strategies import DataObject
from problems import MODELS, as_scene, driven_pendulum, jets_near_home, polynomial_path, scene
from suite import perturbations

import servocore as sc

CRANE = scene("rotary_crane")


def crane_stepper(
    method: sc.Method | None = None,
    step: float = 0.1,
    formulation: sc.Reduced | None = None,
    crane: sc.Scene = CRANE,
    model: str | None = None,
) -> sc.Stepper:
    return sc.Stepper(crane, formulation or sc.Projected(), method or sc.BackwardEuler(), step, model)


@pytest.mark.parametrize(("name", "model"), MODELS)
@settings(max_examples=8)
@given(data=st.data())
def test_a_start_on_a_moving_path_is_consistent_in_every_equation(name: str, model: str, data: DataObject) -> None:
    """Positions, velocities, constraints and residuals: zero to rounding, wherever the path moves and accelerates."""
    stepper = sc.Stepper(scene(name), sc.Reduced(), sc.BackwardEuler(), 0.1, model)
    m = len(stepper.system.outputs)
    jet = jets_near_home(stepper.system, data.draw(perturbations(m)))[: stepper.start_order + 1]
    state, report = stepper.start(jet)
    assert report.converged
    assert report.residual < 1e-9
    _, violations = stepper.program.observe(state, jet.T, stepper.parameters)
    np.testing.assert_allclose(np.asarray(violations), 0.0, atol=1e-11)
    values = stepper.values(state, jet)
    for k, each in enumerate(stepper.system.outputs):
        assert values[each.name] == pytest.approx(jet[0, k], abs=1e-12)


def test_a_start_without_solution_says_so_and_holds_nan() -> None:
    stepper = crane_stepper()
    jet = CRANE.reference.jet(0.0, stepper.start_order)
    jet[0] = np.nan
    state, report = stepper.start(jet)
    assert not report.converged
    assert np.isnan(state).any()


def test_a_step_that_fails_says_so_and_leaves_the_old_state_usable() -> None:
    stepper = crane_stepper()
    jets = CRANE.reference.jet(np.array([4.0, 4.1]), stepper.start_order)
    state, _ = stepper.start(jets[0])
    broken = jets[1].copy()
    broken[2] = np.nan
    after, report = stepper.advance(state, broken)
    assert not report.converged
    assert not np.isfinite(after).all()
    assert stepper.advance(state, jets[1])[1].converged


def test_a_report_counts_iterations_and_the_residual() -> None:
    stepper = crane_stepper()
    jets = CRANE.reference.jet(np.array([9.0, 9.1]), stepper.start_order)
    state, _ = stepper.start(jets[0])
    _, report = stepper.advance(state, jets[1])
    assert 2 <= report.newton_iterations <= 5
    assert report.factorizations >= report.newton_iterations
    assert report.residual < 1e-12


def test_two_steppers_of_equal_settings_share_one_program_and_parameters_do_not_matter_for_it() -> None:
    heavier = CRANE.with_parameters(load_mass=200.0)
    assert crane_stepper().program is crane_stepper(crane=heavier, step=0.05).program
    assert crane_stepper(crane=heavier).parameters[2] == 200.0


def test_the_state_of_a_multistep_method_holds_its_history() -> None:
    sizes = [crane_stepper(sc.BDF(k)).program.state_size for k in (1, 2, 3, 4)]
    assert sizes == [(k + 1) * sizes[0] // 2 for k in (1, 2, 3, 4)]


def test_pointwise_forms_take_no_notice_of_method_step_and_past() -> None:
    """Without internal dynamics a step is a start: whatever the state was."""
    jets = CRANE.reference.jet(np.array([3.0, 8.0]), 6)
    found = []
    for method, step in ((sc.BackwardEuler(), 0.1), (sc.BDF(3), 0.7), (sc.RadauIIA(3), 1e-3)):
        stepper = crane_stepper(method, step, sc.Reduced())
        assert stepper.nodes == (1.0,)
        state, _ = stepper.start(jets[0])
        after, _ = stepper.advance(state, jets[1])
        np.testing.assert_array_equal(after, stepper.start(jets[1])[0])
        found.append(stepper.values(after, jets[1])["M_b"])
    assert found[0] == found[1] == found[2]


def test_an_angle_is_reported_by_its_coordinate_or_by_its_observable_once() -> None:
    stepper = crane_stepper(model="bodies")
    names = [channel.name for channel in stepper.program.channels]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("step", [0.0, -0.1, float("nan"), float("inf")])
def test_a_step_size_that_makes_no_sense_is_refused(step: float) -> None:
    with pytest.raises(sc.InvalidSetting, match="the step must be positive and finite"):
        crane_stepper(step=step)


def test_steps_may_go_on_beyond_the_end_of_the_path_at_rest() -> None:
    """As an FMU does whose run is longer than its path."""
    stepper = crane_stepper()
    t = 19.5 + 0.1 * np.arange(20)
    jets = CRANE.reference.jet(t, stepper.start_order)
    state, _ = stepper.start(jets[0])
    for jet in jets[1:]:
        state, report = stepper.advance(state, jet)
        assert report.converged
    values = stepper.values(state, jets[-1])
    assert values["M_b"] == pytest.approx(0.0, abs=1e-8)
    assert values["F"] == pytest.approx(0.0, abs=1e-8)
    assert values["M_w"] == pytest.approx(-98.1, abs=1e-9)


def test_an_inconsistent_start_disturbs_backward_euler_for_two_steps_and_no_longer() -> None:
    """A position error d shows as 2 M d/h^2 and is forgotten: docs/stability, section 3."""
    path = polynomial_path([[0.2], [0.5], [-0.7]])
    free = as_scene(driven_pendulum(), path, parameters={"g": 0.0})
    stepper = sc.Stepper(free, sc.Original(), sc.BackwardEuler(), 0.1)
    jets = path.jet(0.1 * np.arange(6), stepper.start_order)
    errors = []
    for disturbance in (0.0, 1e-4):
        state, _ = stepper.start(jets[0])
        state = state + disturbance * (np.arange(len(state)) == 0)
        torques = []
        for jet in jets[1:]:
            state, _ = stepper.advance(state, jet)
            torques.append(stepper.values(state, jet)["torque"])
        errors.append(torques)
    spike = np.abs(np.subtract(errors[0], errors[1]))
    assert spike[0] == pytest.approx(4.5 * 1e-4 / 0.01, rel=1e-6)
    assert spike[1] == pytest.approx(4.5 * 1e-4 / 0.01, rel=1e-6)
    np.testing.assert_allclose(spike[2:], 0.0, atol=1e-9)
