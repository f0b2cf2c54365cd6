"""`solve`: grids, refusals with reasons, failures with reasons, and chunks that do not show."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import as_scene, car_chain, polynomial_path, problem, scene, solved

import servocore as sc
from servocore.references.base import time_grid
from servocore.references.rest_to_rest import RestToRest
from servocore.solvers.runs import CHUNK

CRANE = scene("rotary_crane")


def solve(
    crane: sc.Scene = CRANE,
    formulation: sc.Original | None = None,
    method: sc.Method | None = None,
    **settings_: Any,
) -> sc.Solution:
    return sc.solve(crane, formulation or sc.Projected(), method or sc.BackwardEuler(), **settings_)


# The grid ------------------------------------------------------------------------------------------------------------


def test_the_grid_goes_from_start_to_end_in_equal_steps() -> None:
    late = CRANE.with_reference(sc.rest_to_rest((5, 0, -5), (-2, 2, -2), 20.0, start_time=100.0))
    found = solve(late, step=0.1)
    assert found.t[0] == 100.0
    assert found.t[-1] == 120.0
    assert len(found.t) == 201
    np.testing.assert_allclose(np.diff(found.t), 0.1, rtol=1e-9)


@settings(max_examples=50)
@given(duration=st.floats(0.5, 1e4), count=st.integers(1, 10_000))
def test_any_duration_divided_by_a_whole_number_is_a_step(duration: float, count: int) -> None:
    path = polynomial_path([[0.0], [1.0]], duration)
    t = time_grid(path, duration / count)
    assert len(t) == count + 1
    assert (t[0], t[-1]) == (0.0, duration)
    np.testing.assert_allclose(np.diff(t), duration / count, rtol=1e-9)


def test_the_default_step_is_a_two_hundredth_of_the_duration() -> None:
    assert len(solve().t) == 201


def test_a_path_that_starts_later_gives_the_same_inputs_later() -> None:
    now = solved(problem("rotary_crane", "points"), 200)
    later = solve(CRANE.with_reference(sc.rest_to_rest((5, 0, -5), (-2, 2, -2), 20.0, start_time=-7.0)), step=0.1)
    for name in ("M_b", "F", "M_w", "phi"):
        np.testing.assert_allclose(later[name], now[name], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("step", [0.0, -0.1, float("nan"), float("inf"), -float("inf")])
def test_a_step_that_is_not_positive_and_finite_is_refused(step: float) -> None:
    with pytest.raises(sc.InvalidSetting, match="the step must be positive and finite, not"):
        solve(step=step)


def test_a_step_longer_than_the_path_is_refused() -> None:
    with pytest.raises(sc.InvalidSetting, match="step of 21 s is larger than the duration of 20 s"):
        solve(step=21.0)


@pytest.mark.parametrize(
    ("step", "nearest"),
    [(0.3, "0.2985074627 s and 0.303030303 s"), (11.0, "10 s and 20 s"), (0.1 + 1e-5, "0.1 s and 0.1005025126 s")],
)
def test_a_step_that_does_not_divide_the_duration_is_refused_with_the_nearest_that_do(
    step: float, nearest: str
) -> None:
    with pytest.raises(
        sc.InvalidSetting, match=f"does not divide the duration of 20 s; the nearest that do are {nearest}"
    ):
        solve(step=step)


def test_the_nearest_steps_named_in_a_refusal_are_accepted() -> None:
    for step in (0.2985074627, 0.303030303):
        assert len(solve(step=step).t) in (67, 68)


# Loops ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("steps", [CHUNK - 1, CHUNK, CHUNK + 1, 2 * CHUNK + 7])
def test_chunks_of_the_compiled_loop_do_not_show(steps: int) -> None:
    """Whatever the number of steps, the result is that of stepping by hand."""
    step = 20.0 / steps
    found = solve(step=step)
    stepper = sc.Stepper(CRANE, sc.Projected(), sc.BackwardEuler(), step)
    jets = CRANE.reference.jet(found.t, stepper.start_order)
    state, _ = stepper.start(jets[0])
    torque = [stepper.values(state, jets[0])["M_b"]]
    for jet in jets[1:]:
        state, _ = stepper.advance(state, jet)
        torque.append(stepper.values(state, jet)["M_b"])
    np.testing.assert_allclose(found["M_b"], torque, rtol=1e-13, atol=1e-9)
    assert found.statistics.steps == steps


def test_progress_is_told_after_every_chunk_and_ends_with_all_steps() -> None:
    told = []
    solve(step=20.0 / 1200, progress=lambda done, total: told.append((done, total)))
    assert told == [(400, 1200), (800, 1200), (1200, 1200)]


def test_instants_without_internal_dynamics_are_interpreted_in_chunks_that_do_not_show() -> None:
    """One evaluation of them all takes twice the memory and time, and says nothing on the way."""
    told: list[tuple[int, int]] = []
    found = sc.solve(CRANE, step=20.0 / 5000, native=False, progress=lambda done, total: told.append((done, total)))
    assert told == [(2047, 5000), (4095, 5000), (5000, 5000)]
    np.testing.assert_allclose(found["M_b"][::25], sc.solve(CRANE, native=False)["M_b"], rtol=1e-13, atol=1e-11)


def test_a_single_step_is_a_run() -> None:
    scene = CRANE.with_reference(path((5, 0, -5), (4.5, 0.5, -4)))
    found = solve(scene, step=20.0)
    assert found.t.tolist() == [0.0, 20.0]
    np.testing.assert_allclose(found["s"], scene.exact(found.t)["s"], rtol=1e-12)


def test_a_step_so_large_that_it_lands_on_another_branch_is_refused() -> None:
    with pytest.raises(sc.IntegrationFailed, match=r"at t = 20 s s is -2\.8\S* m, on another branch"):
        solve(step=20.0)


def test_solving_twice_gives_the_same_digits() -> None:
    np.testing.assert_array_equal(solve(step=0.1).values, solved(problem("rotary_crane", "points"), 200).values)


# Refusals ------------------------------------------------------------------------------------------------------------


def path(
    start: tuple[float, float, float] = (5.0, 0.0, -5.0),
    end: tuple[float, float, float] = (-2.0, 2.0, -2.0),
    duration: float = 20.0,
    **more: Any,
) -> RestToRest:
    return sc.rest_to_rest(start, end, duration, **more)


def test_limits_are_kept_between_the_instants_of_the_grid_too() -> None:
    """At t = 0, 10 and 20 s the load is where it may be; in between it dips above the girder."""
    hop = sc.through([(5, 0, -1), (5, 1, 0.1), (5, 2, -1), (5, 3, -1), (5, 4, -1)], times=[0, 5, 10, 15, 20])
    grid = hop.jet(np.array([0.0, 10.0, 20.0]), 0)[:, 0, 2]
    between = hop.jet(np.linspace(0.0, 20.0, 2001), 0)[:, 0, 2]
    assert grid.max() < 0.0 < between.max()
    with pytest.raises(sc.InvalidReference, match="the load is not below the girder"):
        solve(CRANE.with_reference(hop), step=10.0)


def test_a_near_miss_of_the_axis_between_survey_points_is_found() -> None:
    """The straight line passes the axis at a hundredth of a millimetre: closer than allowed, for a few milliseconds."""
    with pytest.raises(sc.InvalidReference, match="the trolley reaches the slewing axis"):
        solve(CRANE.with_reference(path((5.0, 1e-5, -5.0), (-5.3, 1e-5, -5.0))), step=0.1)


def test_a_limit_broken_for_milliseconds_in_a_short_ramp_is_found() -> None:
    """Ten milliseconds of free fall and more, then 20 s at constant speed: far from every evenly spaced instant."""
    drop = sc.rest_to_rest((5.0, 0.0, -2.0), (5.0, 0.0, -3.5), 20.0, sc.three_phase(ramp=0.01))
    assert drop.jet(np.linspace(0.0, 20.0, 401), 2)[:, 2, 2].min() > -9.81
    with pytest.raises(sc.InvalidReference, match=r"at t = 0\.00\S* s the rope goes slack"):
        solve(CRANE.with_reference(drop), step=0.1)


def test_limits_depend_on_parameters() -> None:
    """On the moon the same descent makes the rope slack."""
    descent = CRANE.with_reference(path((5, 0, -2), (5, 1, -5), 3.0))
    solve(descent, step=0.1)
    with pytest.raises(sc.InvalidReference, match="the rope goes slack"):
        solve(descent.with_parameters(gravity=1.62), step=0.1)


def test_a_path_without_enough_derivatives_is_refused() -> None:
    """Six cars need twelve derivatives, a spline of degree nine has nine."""
    chain = as_scene(car_chain([1.0] * 6, [50.0] * 5, [0.5] * 5), sc.through([(0.0,), (1.0,)], duration=4.0))
    with pytest.raises(sc.InvalidReference, match=r"the path has derivatives up to order 9, .* needs order 12"):
        solve(chain)


# Failures ------------------------------------------------------------------------------------------------------------


def test_the_original_equations_of_the_generalized_crane_blow_up_and_say_where() -> None:
    """The control: at 0.1 s round-off grows until some step has no solution, and says which."""
    sentence = (
        r"generalized, original, backward-euler: the step from t = \S+ s to \S+ s was not solved; the worst equation is"
        r" the momentum of .* Likely causes: errors that this form of index 5 amplifies from step to step, more so the"
    )
    with pytest.raises(sc.IntegrationFailed, match=sentence) as caught:
        solve(formulation=sc.Original(), model="generalized", step=0.1)
    assert "a smaller step" not in str(caught.value)
    assert "a step too large" not in str(caught.value)


@pytest.mark.filterwarnings("ignore:.*the form has index 5")
@pytest.mark.parametrize("method", [sc.Gauss(2), sc.RadauIIA(2), sc.BDF(2)], ids=lambda method: method.name)
def test_failures_of_every_kind_of_method_end_in_the_same_sentence(method: sc.Method) -> None:
    overhead = scene("overhead_crane")
    with pytest.raises(
        sc.IntegrationFailed, match=r"was not solved; the worst equation is the (momentum|velocity|servo)"
    ):
        sc.solve(overhead, sc.Original(), method, step=0.01, model="generalized")
