"""How far inputs are from right is known where it counts, and warned of from 5 % of their peaks on."""

from __future__ import annotations

import pickle
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from outside.systems import vtol
from present import present
from problems import Rest, as_scene, car_chain, changed, scene

import servocore as sc
from servocore.checks.better_solutions import LARGEST_UNWARNED, BetterSolver, stated_branch
from servocore.scenes import jets
from servocore.solvers.fixed_step import FixedStep
from servocore.solvers.route import Route

DAMPED = (sc.BackwardEuler(), sc.BDF(2), sc.BDF(4), sc.RadauIIA(2), sc.RadauIIA(3), sc.GeneralizedAlpha())
UNDAMPED = (sc.Gauss(1), sc.Trapezoidal())


def solved(
    subject: sc.Scene,
    formulation: sc.Formulation | None = None,
    method: sc.Method | Route | None = None,
    **settings: Any,
) -> tuple[sc.Solution, list[str]]:
    """Solve, and return what was said of the inputs."""
    return heard(lambda: sc.solve(subject, formulation, method, **settings))


def heard(run: Callable[[], Any]) -> tuple[Any, list[str]]:
    """Return a result, and what was said of inputs on the way."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = run()
    return found, [text for each in told if re.search("is off by|may be wrong", text := str(each.message))]


def assert_known_and_warned_of(exact: dict[str, np.ndarray], found: sc.Solution, said: list[str]) -> None:
    """The estimate is within a factor of three of the truth, and the warning given if and only if there is cause."""
    error = found.error
    shares = {}
    for name in error:
        true, peak = np.abs(found[name] - exact[name]).max(), np.abs(exact[name]).max()
        shares[name] = true / peak
        estimate = error[name]
        assert estimate is not None, f"no error of {name} is known"
        if true > 1e-9 * peak:
            assert true / 3 < estimate < 3 * true
        assert error.relative[name] == estimate / error.peaks[name]
        # Better values count from where they are half as far off on; their peaks are no better known.
        assert abs(error.peaks[name] - peak) <= true / 2 + 1e-6 * peak
    worst = max(shares, key=lambda each: shares[each])
    assert len(said) == (shares[worst] > LARGEST_UNWARNED)
    assert all(f": {worst} is off by " in each for each in said)


# Random members -------------------------------------------------------------------------------------------------------


def force_on_the_car(t: np.ndarray, duration: float, p: dict[str, float], start: float = 0.0) -> np.ndarray:
    """The path is a polynomial, so the slide of the mass is one too, and a decaying oscillation from its start."""
    profile = np.polynomial.Polynomial([0, 0, 0, 0, 0, 126, -420, 540, -315, 70])
    rise = 2.0 * profile(np.polynomial.Polynomial([0.0, 1.0 / duration]))
    sin, cos = np.sin(p["inclination"]), np.cos(p["inclination"])
    inertia, damping, stiffness = p["mass"] * sin**2, p["damping"], p["stiffness"]
    drive, slide = -p["mass"] * cos * rise.deriv(2).coef, np.zeros(10)
    for n in range(len(drive) - 1, -1, -1):
        known = damping * (n + 1) * slide[n + 1] + inertia * (n + 2) * (n + 1) * slide[n + 2]
        slide[n] = (drive[n] - known) / stiffness
    steady = np.polynomial.Polynomial(slide)
    roots = np.roots([inertia, damping, stiffness]).astype(complex)
    weights = np.linalg.solve(np.vander(roots, 2, increasing=True).T, [start - steady(0.0), -steady.deriv()(0.0)])
    swings = (weights * roots**2 * np.exp(np.outer(t, roots))).sum(axis=1).real
    acceleration = rise.deriv(2)(t) - cos * (steady.deriv(2)(t) + swings)
    return np.asarray(p["car_mass"] * acceleration + p["mass"] * rise.deriv(2)(t))


@settings(max_examples=15)
@given(
    stiffness=st.floats(0.0, 2.5),
    damping=st.floats(-2.0, -0.1),
    inclination=st.floats(0.2, 1.5),
    duration=st.floats(1.0, 8.0),
    form=st.sampled_from([sc.Projected(), sc.Reduced(), sc.Original()]),
    method=st.sampled_from([*DAMPED, *UNDAMPED]),
    steps=st.integers(12, 700),
)
def test_a_mass_on_a_car_is_judged_by_better_runs(
    stiffness: float,
    damping: float,
    inclination: float,
    duration: float,
    form: sc.Formulation,
    method: sc.Method,
    steps: int,
) -> None:
    """Internal oscillations from slow to fast, from hardly damped to well damped, followed well and badly."""
    k = 10**stiffness
    damper = 10**damping * np.sqrt(8 * k) * np.sin(inclination)
    moved = scene("mass_on_car").with_reference(sc.rest_to_rest((0.0,), (2.0,), duration))
    subject = moved.with_parameters(stiffness=k, inclination=inclination, damping=damper)
    found, said = solved(subject, form, method, step=duration / steps)
    exact = {"u": force_on_the_car(found.t, duration, subject.parameter_values())}
    assert_known_and_warned_of(exact, found, said)


@settings(max_examples=15)
@given(
    st.floats(-2.0, 1.9),
    st.floats(-6.0, -1.0),
    st.floats(-5.0, 1.0),
    st.sampled_from([sc.Projected(), sc.Reduced(), sc.Original()]),
    st.sampled_from([*DAMPED, *UNDAMPED, sc.RadauIIA(10), sc.Gauss(10)]),
    st.sampled_from([13, 100, 1300]),
    st.booleans(),
)
def test_a_free_oscillation_is_warned_of_if_steps_damp_or_delay_it(
    radians: float, damping: float, start: float, form: sc.Formulation, method: sc.Method, steps: int, to_rtol: bool
) -> None:
    """It goes from a hundredth of a radian in a step to eighty, and hardly decays within one.

    Its share of a peak below the limit adds to other errors below it.
    """
    rate, step = 10**radians * steps / 4.0, sc.Adaptive(0.02) if to_rtol else 4.0 / steps
    decay = 10**damping * min(rate, steps / 4.0)
    subject = scene("mass_on_car").with_parameters(stiffness=rate**2, damping=2.0 * decay)
    try:
        found, said = solved(subject, form, method, step=step, start={"s": 10**start, "s_dot": 0.0})
    except sc.IntegrationFailed:
        assert to_rtol or isinstance(form, sc.Original)
        return
    exact = force_on_the_car(found.t, 4.0, subject.parameter_values(), 10**start)
    off = np.abs(found["u"] - exact).max() / np.abs(exact).max()
    assert off > 0.5 * LARGEST_UNWARNED if said else off < 2.0 * LARGEST_UNWARNED
    assert not (said and "stands out" in found.statistics.branch)


@settings(max_examples=20)
@given(
    stiffness=st.floats(0.0, 3.0),
    duration=st.floats(0.5, 8.0),
    form=st.sampled_from([sc.Projected(), sc.Original()]),
    method=st.sampled_from([*DAMPED, *UNDAMPED]),
    steps=st.integers(12, 700),
)
def test_cars_are_judged_by_the_exact_inversion_at_every_instant(
    stiffness: float, duration: float, form: sc.Formulation, method: sc.Method, steps: int
) -> None:
    moved = scene("cars").with_reference(sc.rest_to_rest((0.0,), (1.0,), duration, sc.DEGREE13))
    subject = moved.with_parameters(stiffness_1=10**stiffness)
    try:
        found, said = solved(subject, form, method, step=duration / steps)
    except sc.IntegrationFailed:
        assert isinstance(form, sc.Original)  # whose inputs grow without bound
        return
    assert_known_and_warned_of(subject.exact(found.t), found, said)


# A system of somebody's own -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CubicCars:
    """Two cars of 1 kg with the spring force k e + k3 e^3."""

    k: float = 1.0
    k3: float = 3.0

    def __call__(self) -> sc.MechanicalSystem:
        cars = car_chain((1.0, 1.0))
        stretch = cars.q[0] - cars.q[1]
        return changed(cars, name="cubic cars", potential=self.k / 2 * stretch**2 + self.k3 / 4 * stretch**4)

    def closed_form(self, reference: np.ndarray, _: object) -> dict[str, np.ndarray]:
        """F = x_1'' + x_2'', where x_2 = x_1 - e and k e + k3 e^3 = -x_1''."""
        y = jets.components(reference)[0].derivatives()
        force, rate, second = -y[2], -y[3], -y[4]
        root = np.sqrt((force / (2 * self.k3)) ** 2 + (self.k / (3 * self.k3)) ** 3)
        e = np.cbrt(force / (2 * self.k3) + root) + np.cbrt(force / (2 * self.k3) - root)  # Cardano
        slope, curvature = self.k + 3 * self.k3 * e**2, 6 * self.k3 * e
        e_rate = rate / slope
        return {"F": 2 * y[2] - (second - curvature * e_rate**2) / slope}

    def scene(self, duration: float) -> sc.Scene:
        reference = sc.rest_to_rest((0.0,), (1.0,), duration)
        return as_scene(self(), reference, closed_form=self.closed_form, closed_form_order=4)


@pytest.mark.parametrize("duration", [1.0, 2.0, 4.0, 16.0])
@pytest.mark.parametrize("steps", [100, 400, 3200])
def test_a_spike_between_samples_is_seen(duration: float, steps: int) -> None:
    """Where the cubic spring goes through zero the force has a spike that lasts a few steps."""
    subject = CubicCars().scene(duration)
    assert np.abs(sc.solve(subject)["F"] - subject.exact(sc.solve(subject).t)["F"]).max() < 1e-8 * 1e4
    found, said = solved(subject, sc.Projected(), sc.BackwardEuler(), step=duration / steps)
    assert_known_and_warned_of(subject.exact(found.t), found, said)


# Every route ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-9, 1e3])
def test_an_exact_inversion_that_newton_left_early_does_not_pass_for_exact(scale: float) -> None:
    """A path of a nanometre where a metre is typical: Newton's method stops before it has begun."""
    subject = CubicCars(k=1.0, k3=3.0 / scale**2).scene(4.0)
    found = sc.solve(subject.with_reference(sc.rest_to_rest((0.0,), (scale,), 4.0)))
    exact = subject.with_reference(sc.rest_to_rest((0.0,), (scale,), 4.0)).exact(found.t)["F"]
    true, peak = np.abs(found["F"] - exact).max(), np.abs(exact).max()
    assert true < 1e-10 * peak or true / 3 < found.error["F"] < 3 * true


def test_a_run_is_compared_on_the_branch_that_it_began_on() -> None:
    """An aircraft that turns over: from the guess of the model exact inversions jump to another attitude."""
    aircraft = vtol()
    found, said = solved(aircraft.scene, sc.Projected(), sc.BDF(2), step=0.005)
    exact = aircraft.exact(found.t)
    assert said == []
    assert found.statistics.branch.startswith("one: every instant is near the exact inversion")
    true = np.abs(found["torque"] - exact["torque"]).max()
    assert found.error["torque"] == pytest.approx(true, rel=1e-3)


PUSHED = scene("mass_on_car").with_parameters(stiffness=-5.0)


@pytest.mark.parametrize(
    ("subject", "form", "method", "step", "within"),
    [
        (PUSHED, None, sc.StableInversion(tolerance=0.05, stages=1), 0.4, 0.1),  # beside one of higher order
        (PUSHED, sc.Reduced(), sc.RadauIIA(3), 0.04, 1e-6),  # what runs forward, beside what stays bounded
        (scene("mass_on_car"), sc.Reduced(), sc.BDF(2), sc.Adaptive(1e-3), 0.1),
    ],
    ids=["bounded", "forward", "to a tolerance"],
)
def test_every_route_of_internal_dynamics_is_compared_with_a_better_one(
    subject: sc.Scene, form: sc.Formulation | None, method: sc.Method | Route, step: Any, within: float
) -> None:
    found, said = solved(subject, form, method, step=step)
    true = np.abs(found["u"] - subject.exact(found.t)["u"]).max()
    assert said == []
    assert found.error["u"] == pytest.approx(true, rel=within)


def test_of_a_route_of_ones_own_it_is_known_where_an_exact_answer_is() -> None:
    found = sc.solve(scene("cars"), method=Rest())
    assert found.error.relative["u"] == pytest.approx(1.0)
    found, said = solved(scene("mass_on_car"), method=Rest())
    assert said == []
    assert found.error["u"] is None
    assert found.error.largest is None
    assert "no more accurate solver of mass on car, generalized is known" in found.error.basis


# What is said ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("form", "method", "smaller"),
    [
        (sc.Projected(), sc.BackwardEuler(), True),
        (sc.Original(), sc.BackwardEuler(), False),
        (sc.Projected(), sc.Trapezoidal(), False),
        (sc.Projected(), sc.GeneralizedAlpha(1.0), False),
    ],
    ids=str,
)
def test_a_smaller_step_is_advised_only_where_it_helps(form: sc.Formulation, method: sc.Method, smaller: bool) -> None:
    cars = scene("cars").with_reference(sc.rest_to_rest((0.0,), (1.0,), 1.0))
    found, (said,) = solved(cars, form, method, step=0.02)
    told = re.fullmatch(
        rf"2 cars, points, {form.name}, {re.escape(method.name)}, step 0\.02 s: u is off by (\S+ %|\S+ times|more than"
        r" 10000 times)(?: of)? its peak; at t = \S+ s it is \S+ N, the exact inversion gives \S+ N; the default route,"
        r" solve without a form and a method, has no step(; a smaller step errs less)?",
        said,
    )
    assert told is not None, said
    assert (told[2] is not None) == smaller
    if smaller:
        finer = solved(cars, form, method, step=0.01)[0]
        assert present(finer.error.largest) < 0.7 * present(found.error.largest)


def test_advice_to_the_default_route_is_to_use_a_smaller_step() -> None:
    found, (said,) = solved(scene("mass_on_car"), step=2.0)
    assert re.search(r"gives \S+ N; a smaller step errs less$", said)
    assert present(found.error.largest) > LARGEST_UNWARNED


def test_an_input_that_is_next_to_nothing_is_not_compared_with_itself() -> None:
    """The crane moves in a plane: the slewing torque is round-off."""
    path = sc.rest_to_rest((5.0, 0.0, -5.0), (3.0, 0.0, -3.0), 20.0)
    crane = scene("rotary_crane").with_reference(path)
    found, said = solved(crane, sc.Projected(), sc.BackwardEuler(), step=0.05, model="generalized")
    assert said == []
    assert present(found.error.largest) < LARGEST_UNWARNED


def test_without_checks_nothing_is_said_and_the_error_is_known_when_asked_for() -> None:
    found, said = solved(scene("rotary_crane"), sc.Projected(), sc.BackwardEuler(), step=0.1, checks=False)
    assert said == []
    assert found.statistics.branch == ""
    assert found.error.relative["M_b"] == pytest.approx(0.23, abs=0.01)
    assert list(found.error) == ["M_b", "F", "M_w"]
    assert found.error.basis == "the exact inversion"


def test_an_error_is_computed_once_and_of_the_values_at_hand() -> None:
    found = sc.solve(scene("cars"))
    counting = Mock(side_effect=found.estimator)
    counted = replace(found, estimator=counting)
    counting.assert_not_called()
    assert counted.error is counted.error
    counting.assert_called_once_with(counted)
    worse = replace(found, values=1.5 * found.values)
    assert worse.error.relative["u"] == pytest.approx(0.5)


def test_a_solution_in_a_file_has_lost_what_estimates_its_error_but_not_an_estimate() -> None:
    asked, not_asked = sc.solve(scene("cars")), sc.solve(scene("cars"))
    assert present(asked.error["u"]) < 1e-10
    assert pickle.loads(pickle.dumps(asked)).error["u"] == asked.error["u"]
    assert len(pickle.loads(pickle.dumps(not_asked)).error) == 0


@settings(max_examples=40)
@given(st.sampled_from([-2, 1, 3, 9]), st.sampled_from([-4, -3, 0, 3]), st.sampled_from([-3, 1]), st.integers(12, 6400))
def test_what_better_runs_leave_open_is_warned_of(order: int, better: int, own: int, steps: int) -> None:
    """Better runs that converge or diverge as steps get smaller; at the step of a run they err by 10^better peaks."""
    exact = sc.solve(scene("mass_on_car"))

    def off_by(t: np.ndarray, size: float) -> sc.Solution:
        values = np.column_stack([np.interp(t, exact.t, row) for row in exact.values.T])
        values[:, 0] += size * np.abs(exact["u"]).max() * np.sin(9.0 * t + len(t))
        return replace(exact, t=t, values=values)

    run = off_by(np.linspace(0.0, exact.t[-1], steps + 1), 10.0**own)
    judge = BetterSolver(lambda _, t: off_by(t, 10.0**better * (steps / (len(t) - 1)) ** order), False, "a better run")
    _, said = heard(lambda: stated_branch(present(exact.origin), run, judge, "take smaller steps"))
    if 10.0**own > 0.3:  # wrong, which better runs hide neither where they are right nor where they are wrong too
        (told,) = said
        assert re.search(": u (is off by|may be wrong, more accurate values change by) .*; take smaller steps$", told)
    elif order > 0 and 10.0**own + 10.0**better < 0.01:  # right, as better runs are at such steps
        assert said == []


# One motion -----------------------------------------------------------------------------------------------------------


def test_a_motion_that_changes_over_is_neither_called_one_nor_right() -> None:
    """The aircraft is turned upside down within a step: thrust and attitude jump, everything else goes on."""
    aircraft = vtol()
    found = sc.solve(aircraft.scene, sc.Projected(), sc.BDF(2), step=0.005)
    values, after = found.values.copy(), found.t > 2.0
    values[after, found.names.index("f")] *= -1.0
    values[after, found.names.index("theta")] += np.pi
    turned, problem = replace(found, values=values), sc.Problem.of(aircraft.scene)
    route = FixedStep(sc.Projected(), sc.BDF(2))
    with pytest.warns(sc.ServocoreWarning, match="f is off by 2 times its peak"):
        said = stated_branch(problem, turned, route.better(problem), "")
    assert said == (
        "not known: the step from t = 2 s to 2.005 s is much larger than its neighbours, and the exact inversion is"
        " elsewhere from t = 2.005 s on"
    )
    assert turned.error.relative["f"] == pytest.approx(2.0, rel=0.05)


def test_every_solution_says_of_its_motion_that_it_is_one() -> None:
    for name in ("cars", "mass_on_car", "passive_joint_arm", "rotary_crane"):
        for form in (sc.Projected(), sc.Reduced()):
            for step in (sc.Adaptive(1e-2), scene(name).reference.duration / 200):
                method = sc.RadauIIA(3) if form == sc.Reduced() else sc.BDF(2)
                assert solved(scene(name), form, method, step=step)[0].statistics.branch.startswith("one: ")


@pytest.mark.parametrize(
    ("name", "digits", "count"), [*(("rotary_crane", 3, n) for n in (101, 201, 401, 2001)), ("mass_on_car", 4, 201)]
)
def test_the_part_of_a_fit_to_rounded_samples_is_estimated(name: str, digits: int, count: int) -> None:
    subject = scene(name)
    t = np.linspace(0.0, subject.reference.end_time, count)
    path = sc.sampled(t, np.round(subject.reference.jet(t, 0)[:, 0], digits), 10.0**-digits)
    found, exact = sc.solve(subject.with_reference(path)), sc.solve(subject)
    fit = present(found.fit_effect)
    assert present(found.error.largest) < (1e-14 if name == "rotary_crane" else 1e-9)  # the numerical error alone
    assert found.fit_effect is fit
    true = {name: np.abs(found[name] - exact[name]).max() / np.abs(exact[name]).max() for name in fit}
    assert max(true.values()) / 2.0 < present(fit.largest) < 10.0 * max(true.values())


def test_exact_samples_have_no_part_of_a_fit_and_exact_paths_no_estimate_of_one() -> None:
    crane = sc.scenes.rotary_crane()
    t = np.linspace(0.0, 20.0, 201)
    found = sc.solve(crane.with_reference(sc.sampled(t, crane.reference.jet(t, 0)[:, 0])))
    largest = present(present(found.fit_effect).largest)
    assert largest < 1e-12
    assert sc.solve(crane).fit_effect is None
    assert pickle.loads(pickle.dumps(found)).fit_effect.largest == largest
    assert pickle.loads(pickle.dumps(sc.solve(crane.with_reference(found.origin.reference)))).fit_effect is None
