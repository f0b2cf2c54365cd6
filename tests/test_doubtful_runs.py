"""Runs that satisfy every equation and are wrong all the same are refused or warned of; right ones are left alone."""

from __future__ import annotations

import re
from contextlib import nullcontext
from functools import cache

import casadi as ca
import numpy as np
import pytest
from outside.writing import coordinates, lagrange

import servocore as sc
from benchmarks.atlas.row06_singular_configurations import near_axis, near_slack
from servocore.checks.branches import CLOSED_FORM, Branch


def circles(cycles: int) -> sc.Reference:
    return sc.periodic((0.0, 0.0, -1.0), [[5.0, 0.0, 0.0]], [[0.0, 5.0, 0.0]], period=2 * np.pi, cycles=cycles)


CIRCLE = circles(3)
"""Three times round the slewing axis: the bridge turns by 6 pi, the trolley runs inside the load."""


def projected(scene: sc.Scene, steps: int, model: str = "points") -> sc.Solution:
    return sc.solve(scene, sc.Projected(), sc.BackwardEuler(), step=scene.reference.duration / steps, model=model)


def largest_error(scene: sc.Scene, found: sc.Solution, name: str) -> float:
    """Largest error of a quantity in relation to its peak."""
    exact = scene.exact(found.t)[name]
    return float(np.abs(found[name] - exact).max() / np.abs(exact).max())


# Angles in a step -----------------------------------------------------------------------------------------------------


def test_a_step_that_turns_the_bridge_the_wrong_way_round_is_refused_with_angle_limit_and_time() -> None:
    """Past the slewing axis at 3 mm Newton's method finds a bridge angle a full turn away, which follows all equations.

    The bridge turns by 1.7 rad in this step; found was 1.7 - 2 pi, with a torque eight times the peak.
    """
    said = r"phi turns by 4\.586 rad in the step from t = 9\.98 s to 10 s, .* less than pi .* a smaller step is needed$"
    with pytest.raises(sc.IntegrationFailed, match=said):
        projected(near_axis(3e-3), 1000, "bodies")


@pytest.mark.parametrize("spring", [0.0, 1e-6])
def test_a_wheel_that_no_equation_knows_up_to_full_turns_only_may_turn_as_far_as_it_likes(spring: float) -> None:
    """A cart on a wheel of 1 cm radius goes 100 m in 20 steps: 500 rad a step, each of them as good as the first.

    A torsion spring that stiffens makes the angle enter nonlinearly, which is not periodically.
    """
    q = coordinates("x", "theta")
    x, theta = ca.vertsplit(q.q)
    wheel = lagrange(
        "wheel", q, q.v[0] ** 2 + 1e-4 * q.v[1] ** 2 / 2, {"y": x}, {"M": theta}, potential=spring * theta**4 / 4.0,
        constraints=x - 0.01 * theta,
    )  # fmt: skip
    reference = sc.rest_to_rest((0.0,), (100.0,), 20.0)
    scene = sc.Scene(name="wheel", models={"points": lambda: wheel}, reference=reference)
    found = projected(scene, 20)
    assert np.diff(found["theta"]).max() > 100.0
    np.testing.assert_allclose(found["theta"], 100.0 * found["x"], rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("model", sc.scenes.rotary_crane().models)
@pytest.mark.parametrize("steps", [40, 5, 3, 2])
def test_the_exact_bridge_angle_follows_the_path_however_far_its_instants_lie_apart(model: str, steps: int) -> None:
    """At five steps the bridge turns by 0.6 turns a step, at three by one, at two by one and a half."""
    crane = sc.scenes.rotary_crane().with_reference(CIRCLE)
    found = sc.solve(crane, sc.Reduced(), step=CIRCLE.duration / steps, model=model)
    np.testing.assert_allclose(found["phi"] - found["phi"][0], np.linspace(0.0, 6 * np.pi, steps + 1), atol=1e-9)


def test_a_closed_form_that_turns_too_often_between_the_instants_is_not_followed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """To follow a hundred turns takes many times as long as the run, for the same values."""
    monkeypatch.setattr(Branch, "follow", lambda *_: pytest.fail("the motion is followed"))
    found = sc.solve(sc.scenes.rotary_crane().with_reference(circles(100)))
    assert found.statistics.branch == CLOSED_FORM


def test_under_error_control_the_exact_bridge_angle_follows_the_path_as_well() -> None:
    crane = sc.scenes.rotary_crane().with_reference(CIRCLE)
    found = sc.solve(crane, sc.Reduced(), step=sc.Adaptive(1e-6), output_step=CIRCLE.duration / 5)
    assert found["phi"][-1] - found["phi"][0] == pytest.approx(6 * np.pi, abs=1e-9)


@pytest.mark.parametrize("distance", [1.0, 1e-2, 1.1e-3])
def test_past_the_axis_the_exact_bridge_angle_turns_by_what_a_fine_grid_says(distance: float) -> None:
    crane = near_axis(distance)
    for sign, scene in ((1.0, crane), (-1.0, near_axis(-distance))):
        near = (
            pytest.warns(sc.ServocoreWarning, match="close to a pole: .* M_b is") if distance < 0.1 else nullcontext()
        )
        with near:
            found = sc.solve(scene, sc.Reduced(), step=crane.reference.duration / 3)
        fine = scene.exact(np.linspace(0.0, crane.reference.duration, 30_001))["phi"]
        np.testing.assert_allclose(found["phi"], fine[::10_000], atol=1e-9)
        assert np.sign(found["phi"][-1] - found["phi"][0]) == sign


# Inputs far from the exact ones ---------------------------------------------------------------------------------------


@cache
def beyond_cosines() -> tuple[sc.Scene, sc.Solution, list[float]]:
    """Return a run whose direction cosines cannot follow the winch, and the numbers of its warning."""
    crane = near_slack(1.0)
    with pytest.warns(sc.ServocoreWarning) as heard:
        found = projected(crane, 1000, "bodies")
    assert len(heard) == 1
    numbers = re.fullmatch(
        r"rotary crane, bodies, projected, backward-euler, step \S+ s: M_w is off by (\S+) times its peak; at"
        r" t = (\S+) s it is (\S+) N\.m, the exact inversion gives (\S+) N\.m; beta turns by (\S+) rad within this"
        r" step, where about (\S+) rad would be an error of half the peak; the default route, solve without a form and"
        r" a method, has no step; a smaller step errs less",
        str(heard[0].message),
    )
    assert numbers is not None
    return crane, found, list(map(float, numbers.groups()))


@pytest.mark.parametrize("finer", [True, False])
def test_direction_cosines_that_cannot_follow_the_winch_are_warned_of_with_angle_turn_limit_and_time(
    finer: bool,
) -> None:
    crane, found, (times, time, given, exact, turn, allowed) = beyond_cosines()
    k = int(np.abs(found.t - time).argmin())
    assert given == pytest.approx(found["M_w"][k], rel=1e-3)
    assert exact == pytest.approx(crane.exact(found.t)["M_w"][k], rel=1e-3)
    assert turn == pytest.approx(np.diff(found["beta"])[k - 1], rel=0.02)
    assert times > 5.0
    assert largest_error(crane, found, "M_w") == pytest.approx(times, rel=1e-2)
    if finer:  # by as much as the warning says
        found = projected(crane, round(1000 * turn / allowed), "bodies")
        assert largest_error(crane, found, "M_w") == pytest.approx(0.5, rel=0.2)


@pytest.mark.parametrize("distance", [0.1, 0.03, 0.01])
def test_a_torque_that_the_step_cannot_resolve_is_warned_of(distance: float) -> None:
    crane = near_axis(distance)
    with pytest.warns(sc.ServocoreWarning) as heard:
        found = projected(crane, 1000)
    said = str(heard[-1].message)  # at 10 mm, that the exact torque has a peak between the instants comes first
    assert re.search(r"M_b is off by .* the exact inversion gives .* phi turns by", said)
    assert len(heard) == 1 + (distance < 0.03)
    assert largest_error(crane, found, "phi") < 1e-12
    assert largest_error(crane, found, "M_b") > 0.5


# Methods on forms of high index ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("count", "method", "order"),
    [(3, sc.RadauIIA(2), -1), (3, sc.RadauIIA(3), 0), (4, sc.RadauIIA(4), -1), (3, sc.Gauss(1), -2),
     (3, sc.Trapezoidal(), -2)],
    ids=str,
)  # fmt: skip
def test_a_method_whose_inputs_do_not_converge_on_a_form_of_this_index_is_warned_of_in_advance(
    count: int, method: sc.Method, order: int
) -> None:
    """Chains of n cars have index 2 n + 1, their projected form two less: the error goes like the power announced."""
    cars, errors = sc.scenes.cars(count), []
    for steps in (100, 200):
        with pytest.warns(sc.ServocoreWarning) as heard:
            found = sc.solve(cars, sc.Projected(), method, step=cars.reference.duration / steps)
        said = (
            f"the form has index {2 * count - 1}, on which the inputs of {method.name} err like the step to the power"
        )
        assert f"{said} {order} and no step is small enough; use the form Reduced()" in str(heard[0].message)
        errors.append(largest_error(cars, found, "u"))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)
    assert method.orders(2 * count - 1).forces == order


@pytest.mark.parametrize(("count", "stages"), [(2, 2), (2, 3), (3, 4), (3, 5)])
def test_enough_stages_converge_at_the_order_they_say_and_nothing_is_warned_of(count: int, stages: int) -> None:
    cars, method = sc.scenes.cars(count), sc.RadauIIA(stages)
    errors = [
        largest_error(cars, sc.solve(cars, sc.Projected(), method, step=cars.reference.duration / steps), "u")
        for steps in (100, 200)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(method.orders(2 * count - 1).forces, abs=0.15)


@pytest.mark.parametrize("model", list(sc.scenes.quadrotor_with_load().models))
def test_a_moment_of_which_the_instants_show_a_tenth_is_warned_of(model: str) -> None:
    """The thrust turns fast between two of 201 instants, where `certify` refutes that they show the moment."""
    quadrotor = sc.scenes.quadrotor_with_load()
    start, end = quadrotor.reference.jet(0.0, 0)[0], (5.91, 2.15)
    quick = quadrotor.with_reference(sc.rest_to_rest(start, end, 1.71, sc.DEGREE13))
    with pytest.warns(
        sc.ServocoreWarning, match=r"close to a pole: at t = 0\.28\d* s front is -2\d{3} N, .* so do M, rear"
    ):
        sc.solve(quick, model=model)
