"""What is refused says why: out of reach and by how much, singular and where; and simulations end."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from outside.systems import arm as two_links
from outside.writing import coordinates, lagrange, square
from present import present
from problems import as_scene, driven_pendulum, polynomial_path, scene

import servocore as sc
from servocore.checks import failure_causes
from servocore.problem import Problem

CRANE = scene("rotary_crane")
REACH = 1.8
"""Of the arm, in m: both of its links."""


def arm(start: tuple[float, float], end: tuple[float, float]) -> sc.Scene:
    """Return an arm of two links, 1 m and 0.8 m, whose tip goes from one point to another in 2 s."""
    return sc.Scene("arm", {"links": two_links}, sc.rest_to_rest(start, end, 2.0))


def refusal(subject: sc.Scene, way: str) -> str:
    """Return the reason that one of the ways to solve or look at a scene gives."""
    if way == "analyse":
        return sc.analyse(subject).reason
    ways: dict[str, Callable[[], object]] = {
        "ExactInversion": lambda: sc.ExactInversion(subject),
        "reduced": lambda: sc.solve(subject),
        "projected": lambda: sc.solve(subject, sc.Projected()),
    }
    with pytest.raises(sc.InvalidReference) as caught:
        ways[way]()
    return str(caught.value)


# Out of reach ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("way", "end"),
    [
        ("reduced", (2.0, 1.5)), ("projected", (2.0, 1.5)), ("ExactInversion", (-1.2, 1.8)), ("analyse", (0.9, -2.1)),
    ],
)  # fmt: skip
def test_a_path_out_of_reach_says_from_when_on_and_by_how_much(way: str, end: tuple[float, float]) -> None:
    """The tip cannot be farther than 1.8 m from the shoulder; it is missed along the line to it."""
    subject = arm((1.0, 0.9), end)
    sentence = refusal(subject, way)
    path, distance = subject.reference, np.hypot(*end)
    t = np.linspace(0.0, 2.0, 20001)
    leaves = t[np.argmax(np.hypot(*path.jet(t, 0)[:, 0].T) > REACH)]
    missed = distance - REACH
    said = re.fullmatch(
        r"arm: from t = (\S+) s on the path is out of reach; at t = 2 s the nearest configuration found misses"
        r" X = (\S+) m by (\S+) m and Y = (\S+) m by (\S+) m, (\S+) m in all",
        sentence,
    )
    begin, x, off_x, y, off_y, off = map(float, present(said).groups())
    assert begin == pytest.approx(leaves, abs=2e-4)
    assert (x, y) == end
    assert off == pytest.approx(missed, rel=5e-3)
    assert (off_x, off_y) == pytest.approx((missed * abs(x) / distance, missed * abs(y) / distance), rel=5e-3)


@pytest.mark.parametrize(
    "other",
    [
        lambda far, _: sc.sweep(far, {"duration": [2.0, 3.0]}),
        lambda far, _: sc.sensitivities(far),
        lambda far, folder: sc.export_fmu(far, folder / "arm.fmu", targets="host"),
    ],
    ids=["sweep", "sensitivities", "export"],
)
def test_whatever_is_asked_of_a_path_out_of_reach_the_cause_is_looked_for(
    other: Callable[[sc.Scene, Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The search itself, which takes seconds, is that of the tests above."""

    def found(problem: Problem, error: sc.ServocoreError) -> sc.ServocoreError:
        return sc.InvalidReference(f"{problem.name}: the cause of {type(error).__name__}")

    monkeypatch.setattr(failure_causes, "explained", found)
    with pytest.raises(sc.InvalidReference, match=r"^arm: the cause of IntegrationFailed$"):
        other(arm((1.0, 0.9), (2.0, 1.5)), tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_point_that_is_reached_to_the_last_millimetre_is_no_miss() -> None:
    """Beyond 1.7999 m the arm is all but straight, and still solved."""
    assert sc.solve(arm((1.0, 0.9), (1.7999 * 0.8, 1.7999 * 0.6)), step=0.02)["X"][-1] == pytest.approx(1.7999 * 0.8)


# Singular -------------------------------------------------------------------------------------------------------------

TWO = coordinates("x y")
X, Y = ca.vertsplit(TWO.q)
AT_REST = {
    "an output that is a square": (
        lagrange("points", TWO, square(TWO.v) / 2, {"a": X**2, "b": Y}, {"F": X, "G": Y}),
        (0.0, 0.0), (1.0, 1.0), "q.x",
    ),
    "a coupling that vanishes at rest": (
        lagrange("points", TWO, square(TWO.v) / 2, {"a": Y}, {"F": X}, potential=X**2 * Y),
        (0.0,), (1.0,), "q.x",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", AT_REST)
def test_a_start_without_relative_degree_is_refused_with_that_reason_by_all(case: str) -> None:
    system, start, end, variable = AT_REST[case]
    subject = as_scene(system, sc.rest_to_rest(start, end, 2.0))
    reason = sc.analyse(subject).reason
    assert reason.startswith("points has no relative degree at ")
    assert "t = 0 s" in reason
    assert variable in reason.split("the variables ")[1]
    for form in (None, sc.Original()):
        with pytest.raises((sc.InconsistentStart, sc.IntegrationFailed)) as caught:
            sc.solve(subject, form)
        assert str(caught.value) == reason
    with pytest.raises(sc.IntegrationFailed, match="no relative degree"):
        sc.ExactInversion(subject)


# What is advised ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "method", [sc.Gauss(2), sc.Trapezoidal(), sc.GeneralizedAlpha(1.0)], ids=lambda each: each.name
)
def test_a_smaller_step_is_not_advised_for_methods_that_damp_nothing(
    method: sc.Method,
) -> None:
    """On the projected form errors of the inputs stay; a path out of reach ends such a run between its instants."""
    away = CRANE.with_reference(sc.rest_to_rest((5, 0, -2), (5, 0, 2), 4.0)).with_limits()
    with pytest.raises(sc.ServocoreError) as caught:
        sc.solve(away, sc.Projected(), method, step=0.5, checks=False)
    assert "smaller step" not in str(caught.value)
    assert "a step too large" not in str(caught.value)


# Simulation -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def inputs() -> sc.Solution:
    return sc.solve(CRANE, step=0.1)


@pytest.mark.parametrize("t", [[0.0, 20.1], [-0.5, 3.0], [25.0, 30.0]])
def test_inputs_are_not_known_outside_their_time(inputs: sc.Solution, t: list[float]) -> None:
    said = re.escape(
        f"the inputs are known from t = 0 s to 20 s, the simulation is to go from {t[0]:g} s to {t[1]:g} s: outside"
        " their time they are unknown"
    )
    with pytest.raises(sc.InvalidSetting, match=f"^{said}$"):
        sc.simulate(CRANE, inputs, t=np.array(t))


@pytest.mark.parametrize(
    ("t", "said"),
    [
        ([0.0, 3.0, 2.0], "must rise, but 2 s follows 3 s"),
        ([3.0, 1.0], "must rise, but 1 s follows 3 s"),
        ([0.0, np.nan], r"an array of shape \(2,\) that holds nan"),
        ([], r"an array of shape \(0,\)"),
        ([[0.0, 1.0]], r"an array of shape \(1, 2\)"),
        ("now", "must be numbers in s, not the text 'now'"),
    ],
)
def test_times_to_report_at_rise(inputs: sc.Solution, t: list[float | list[float]] | str, said: str) -> None:
    with pytest.raises(sc.InvalidSetting, match=f"^the times at which to report .*{said}$"):
        sc.simulate(CRANE, inputs, t=t)  # type: ignore[arg-type]  # wrong on purpose


def test_inputs_that_are_given_twice_are_refused(inputs: sc.Solution) -> None:
    twice = replace(inputs, t=np.append(0.0, inputs.t[:-1]))
    with pytest.raises(sc.InvalidSetting, match=r"the inputs are given twice at t = 0 s"):
        sc.simulate(CRANE, twice)


@pytest.mark.parametrize("count", [0, 1, 2, 4, 7])
def test_too_few_or_many_inputs_are_counted(count: int) -> None:
    said = f"the function of time returns {count} inputs at t = 0 s, rotary crane, points has 3: M_b, F, M_w"
    with pytest.raises(sc.InvalidSetting, match=f"^{said}$"):
        sc.simulate(CRANE, lambda _: np.zeros(count), t=[0.0, 1.0])  # type: ignore[arg-type]  # wrong on purpose


def test_inputs_of_another_scene_are_missed_by_name(inputs: sc.Solution) -> None:
    pendulum = as_scene(driven_pendulum(), polynomial_path([[0.3]]))
    with pytest.raises(sc.InvalidSetting, match=r"^the solution lacks the inputs torque of pendulum; it has M_b, F, "):
        sc.simulate(pendulum, inputs)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"inputs": np.zeros((3, 3))}, "the inputs must be a Solution or a function of time, not a numpy.ndarray"),
        ({"inputs": lambda _: ["a", "b", "c"]}, "the inputs at t = 0 s must be numbers, not a list"),
        ({"rtol": "tight"}, "rtol must be a positive number, not the text 'tight'"),
        ({"atol": np.inf}, "atol must be positive and finite, not inf"),
        ({"time_limit": 0.0}, "time_limit must be positive and finite, not 0"),
    ],
)
def test_arguments_of_a_simulation_are_looked_at(arguments: dict[str, Any], said: str) -> None:
    said = re.escape(said.removesuffix("...")) + ("" if said.endswith("...") else "$")
    with pytest.raises(sc.InvalidSetting, match=f"^{said}"):
        sc.simulate(CRANE, **{"inputs": lambda _: np.zeros(3), "t": [0.0, 1.0], **arguments})


def test_an_input_that_is_no_number_stops_the_simulation_with_its_name() -> None:
    pendulum = as_scene(driven_pendulum(), polynomial_path([[0.3]]))
    with pytest.raises(sc.IntegrationFailed, match=r"stopped at t = 0\.\d+ s: the input torque is nan$"):
        sc.simulate(pendulum, lambda time: np.array([np.nan if time > 0.5 else 0.0]), t=np.array([0.0, 1.0]))


def test_one_instant_is_the_initial_state() -> None:
    pendulum = as_scene(driven_pendulum(), polynomial_path([[0.3]]))
    assert sc.simulate(pendulum, lambda _: np.zeros(1), t=np.array([0.5, 0.5]))["theta"] == pytest.approx([0.3, 0.3])


def test_a_simulation_ends_when_its_time_is_over(inputs: sc.Solution) -> None:
    said = r"the forward simulation had come to t = \S+ s of 20 s when its time limit of 1e-05 s was over$"
    with pytest.raises(sc.IntegrationFailed, match=said):
        sc.simulate(CRANE, inputs, time_limit=1e-5)


def block(friction: Callable[..., ca.SX], *, masses: int = 1) -> sc.Scene:
    """Return blocks in a row with friction, pushed by a force on the first that is too weak to keep it moving."""
    q = coordinates(" ".join("xy"[:masses]))
    system = lagrange("points", q, square(q.v) / 2, {"a": q.q[0]}, {"F": q.q[0]})
    rubbed = replace(system, force=friction(*ca.vertsplit(q.v)))
    return as_scene(rubbed, polynomial_path([[0.0], [0.5]], 2.0))


STICKING: dict[str, tuple[Callable[..., ca.SX], int]] = {
    "sign": (lambda v: ca.SX(-2.0 * ca.sign(v)), 1),
    "if_else": (lambda v: -2.0 * ca.if_else(v > 0, 1, -1), 1),
    "between blocks": (lambda v, w: ca.vertcat(-5.0 * ca.sign(v - w), 5.0 * ca.sign(v - w) - w), 2),
}


@pytest.mark.parametrize("case", STICKING)
def test_friction_that_sticks_ends_with_the_smooth_form_to_take(case: str) -> None:
    friction, masses = STICKING[case]
    said = (
        r"^points: the forward simulation does not get past t = \S+ s: the acceleration of x jumps by \S+ with the .*"
        r" the velocity of x, at every step, as where dry friction sticks; a smooth form does, such as tanh\(v/v_s\)"
        r" for sign\(v\), where v_s is about a thousandth of the usual v$"
    )
    with pytest.raises(sc.IntegrationFailed, match=said):
        sc.simulate(
            block(friction, masses=masses),
            lambda time: np.array([np.sin(3 * time)]),
            t=np.array([0.0, 2.0]),
            time_limit=60,
        )


def test_friction_that_is_only_passed_through_and_steep_damping_are_no_chatter() -> None:
    passing = block(lambda v: ca.SX(-0.1 * ca.sign(v)))
    found = sc.simulate(passing, lambda time: np.array([-3.0 * np.cos(time)]), t=np.array([0.0, 2.0]))
    assert found["x"][-1] < 0.0
    steep = sc.simulate(block(lambda v: -3e3 * v), lambda _: np.array([3.0]), t=np.array([0.0, 2.0]))
    assert steep["x"][-1] == pytest.approx(0.5 / 3e3 + 3.0 / 3e3 * (2.0 - 1 / 3e3), rel=1e-4)


@pytest.mark.parametrize("slip", [1e-6, 1e-8])
def test_friction_that_is_smooth_but_steep_ends_soon(slip: float) -> None:
    """Steps of the velocity of slip are 1e6 and more; the block is at rest until the push overcomes friction."""
    steep = block(lambda v: -2.0 * ca.tanh(v / slip))
    t = np.linspace(0.0, 2.0, 41)
    found = sc.simulate(steep, lambda time: np.array([3.0 * np.sin(time)]), t=t, start={"x": 0.0, "x_dot": 0.0})
    assert found.statistics.factorizations < 200_000
    begin = np.arcsin(2.0 / 3.0)
    moved = 3.0 * ((t - begin) * np.cos(begin) - np.sin(t) + np.sin(begin)) - (t - begin) ** 2
    assert np.abs(found["x"] - np.where(t > begin, moved, 0.0)).max() < 20 * slip


@pytest.mark.parametrize("name", ["overhead_crane", "gantry_crane"])
def test_a_rope_that_goes_slack_is_told_with_the_time_and_a_duration_that_would_do(name: str) -> None:
    """Without the limits of the scene, by the rope's length alone: 1.2 g downwards at the peak of degree 9."""
    crane = replace(scene(name), limits=())
    aside = (0.0,) * (crane.reference.dimension - 2)
    start, end = (0.0, *aside, -1.5), (0.3, *aside, -2.5)

    def falling(duration: float) -> sc.Scene:
        return crane.with_reference(sc.rest_to_rest(start, end, duration))

    sentence = r"the rope goes slack at t = 0\.21\d+ s: l grows .*; in more than (\S+) s the same law keeps it taut"
    with pytest.raises(sc.IntegrationFailed, match=sentence) as refused:
        sc.solve(falling(0.892))
    found = re.search(sentence, str(refused.value))
    assert found is not None
    assert float(found[1]) == pytest.approx(np.sqrt(9.3721 / 9.81), rel=1e-3)
    assert (sc.solve(falling(1.05 * float(found[1])))["l"] > 0.0).all()
