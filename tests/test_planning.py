"""Plans keep all limits, are as fast as independent bounds and answers allow, and what cannot be kept is refused."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

import servocore as sc
from servocore.model.limits import Bounds
from servocore.planning.integrator_chains import advanced
from servocore.planning.report import PlanReport

CRANE = sc.scenes.rotary_crane()
OVERHEAD = sc.scenes.overhead_crane()
LINE = [(5, 0, -5), (-2, 2, -2)]
DEFAULT: dict[str, Bounds] = {"M_b": 1000, "F": 60, "swing": "5 deg"}
LEVEL = [(0, -4), (5, -4)]
FREE: dict[str, Bounds] = {"F": 200, "M_w": (-113.1, -83.1), "swing": "15 deg", "z": (-6, -1)}
CURVE = [(5, 0, -5), (3.5, 1.5, -3.4), (1.5, 2.6, -2.6), (-0.3, 2.6, -2.3), (-2, 2, -2)]
QUICK, COARSE = 40, 20
"""Intervals: half and a quarter of what is usual; plans are some two and five per cent slower."""


def largest_excess(scene: sc.Scene, path: sc.Reference, limits: Mapping[str, Any]) -> float:
    """Return by how much the closed form of a crane exceeds symmetric limits, divided by them."""
    t = np.linspace(0.0, path.duration, 20_001)
    exact = scene.with_reference(path).exact(t)
    return float(max(np.abs(exact[name]).max() / bound - 1.0 for name, bound in limits.items()))


WAYS: dict[str, tuple[sc.Scene, Any, dict[str, Bounds]]] = {
    "level": (OVERHEAD, LEVEL, {"F": 200}),
    "line": (CRANE, LINE, DEFAULT),
}
BOUNDS: dict[str, dict[str, float]] = {
    "level": {"F": 200.0}, "line": {"M_b": 1000.0, "F": 60.0, "swing": math.radians(5.0)}
}  # fmt: skip


@cache
def planned(name: str) -> tuple[sc.Reference, PlanReport]:
    scene, way, limits = WAYS[name]
    return sc.fastest(scene, way, limits, intervals=QUICK)


class TestPlans:
    """A level way under a limit of force; the line of the crane under those of slewing torque, force and swing."""

    def test_the_line_is_as_fast_as_the_best_known_on_such_a_grid(self) -> None:
        _, report = planned("line")
        assert report.duration == pytest.approx(7.284, rel=3e-3)
        assert report.degree9 == pytest.approx(10.694, abs=1e-3)
        assert report.three_phase == pytest.approx(10.293, rel=1e-3)
        assert report.status == "Solve_Succeeded"
        assert 0.0 < report.grid_error < 0.5

    @pytest.mark.parametrize("name", WAYS)
    def test_limits_are_kept_by_the_closed_form(self, name: str) -> None:
        path, report = planned(name)
        assert largest_excess(WAYS[name][0], path, BOUNDS[name]) <= 0.0
        assert report.violation == 0.0

    @pytest.mark.parametrize("name", WAYS)
    def test_every_limit_is_touched_at_some_time(self, name: str) -> None:
        _, report = planned(name)
        assert {each.quantity for each in report.active} == WAYS[name][2].keys()
        assert all(0.0 <= each.begin <= each.end <= report.duration for each in report.active)

    @pytest.mark.parametrize("name", WAYS)
    def test_a_plan_is_a_path_that_everything_takes(self, name: str) -> None:
        (path, report), (scene, _, limits) = planned(name), WAYS[name]
        scene = scene.with_reference(path).with_limits(**limits)
        solution = sc.solve(scene, step=report.duration / 100)
        inputs = sc.ExactInversion(scene)(solution.t)
        assert np.abs(inputs[:, -2] - solution["F"]).max() < 1e-7
        np.testing.assert_allclose(inputs[[0, -1]], [[0.0, 0.0, -98.1][-inputs.shape[1] :]] * 2, atol=1e-6)

    @pytest.mark.parametrize("name", WAYS)
    def test_derivatives_are_exact(self, name: str) -> None:
        path, _ = planned(name)
        t, h = np.linspace(0.3, path.duration - 0.3, 37) + 0.011, 1e-4
        for order in range(5):
            slope = (path.jet(t + h, order)[:, order] - path.jet(t - h, order)[:, order]) / (2 * h)
            exact = path.jet(t, 5)[:, order + 1]
            kink = np.abs(exact).max() if order == 4 else 1.0  # the fifth jumps at knots
            assert np.median(np.abs(slope - exact)) < 1e-6 * max(kink, 1.0)


class TestIndependentAnswers:
    """Momentum, a linear program and other starts say how fast a plan can be."""

    def test_level_overhead_crane_takes_what_a_linear_program_takes(self) -> None:
        _, report = planned("level")
        assert report.duration == pytest.approx(linear_optimum(QUICK), rel=1e-3)
        assert report.duration >= 2.0 * math.sqrt(110.0 * 5.0 / 200.0)

    def test_swing_alone_is_not_faster_than_momentum_allows(self) -> None:
        _, report = sc.fastest(CRANE, LINE, {"M_b": 3000, "F": 500, "swing": "3 deg"}, intervals=QUICK)
        level = math.hypot(7.0, 2.0)
        assert report.duration >= 2.0 * math.sqrt(level / (9.81 * math.tan(math.radians(3.0))))
        assert report.duration <= 1.05 * 7.811


def linear_optimum(intervals: int) -> float:
    """Return the shortest time for a level way of 5 m with |F| <= 200 N, F = (m + m_t) x'' + m_t h/g x''''."""
    low, high = 2.0, 6.0
    while high - low > 1e-4 * high:
        middle = (low + high) / 2.0
        low, high = (low, middle) if feasible(intervals, middle) else (middle, high)
    return high


def feasible(intervals: int, duration: float) -> bool:
    """Say whether snaps at knots exist; x and its derivatives are linear in them."""
    h, units = duration / intervals, np.eye(intervals + 1)[:, 1:-1]
    here, rows = [np.zeros(intervals - 1) for _ in range(4)], []
    for u, change in zip(units[:-1], np.diff(units, axis=0), strict=True):
        for part in np.linspace(0.0, 1.0, 4)[:-1]:
            jet = advanced(here, u, change, part, h)
            rows.append(110.0 * jet[2] + 10.0 * 4.0 / 9.81 * jet[4])
        here = advanced(here, u, change, 1.0, h)[:4]
    force, scale = np.array(rows) / 200.0, duration ** np.arange(4)[:, None]
    ends = np.array(here) * scale
    found = linprog(
        np.zeros(intervals - 1),
        A_ub=np.concatenate([force, -force]) * 600.0,
        b_ub=np.full(2 * len(force), 600.0),
        A_eq=ends,
        b_eq=[5.0, 0.0, 0.0, 0.0],
        bounds=(None, None),
    )
    return found.status == 0


CAR, GANTRY = sc.scenes.mass_on_car(), sc.scenes.gantry_crane()


@pytest.mark.parametrize(
    ("scene", "way", "limits", "settings", "words"),
    [
        (CRANE, [(5, 0, -4), (3, 3, -4.6), (-2, 3, -4)], {"l": 4.5, "F": 60}, {}, r"limit of l: .* it is 4\.\d+ m"),
        (CAR, [(0.0,), (1.0,)], {"u": 10}, {}, "internal dynamics"),
        (CRANE, LEVEL, DEFAULT, {}, "3 components, this one has 2"),
        (CRANE, LINE, DEFAULT, {"intervals": 7}, "even number of intervals"),
        (CRANE, LINE, DEFAULT, {"progress": 4}, "progress must be a function of a text, not 4"),
        (GANTRY, GANTRY.reference, {"swing.rate": 1e-4}, {}, "; limit swing itself, or its rate less tightly$"),
    ],
)
def test_what_no_law_keeps_or_nobody_can_plan_is_refused(
    scene: sc.Scene, way: Any, limits: dict[str, Bounds] | None, settings: dict[str, Any], words: str
) -> None:
    with pytest.raises((sc.InvalidReference, sc.InvalidSetting, sc.InvalidModel, sc.PlanningFailed), match=words):
        sc.fastest(scene, way, limits, **settings)


@pytest.mark.parametrize("smooth", [False, True, -1, 3, 0.0])
def test_smooth_is_a_number_of_derivatives_from_zero_to_two(smooth: int) -> None:
    with pytest.raises(sc.InvalidSetting, match=f"0 to 2, not {smooth!r}"):
        sc.fastest(CRANE, LINE, DEFAULT, smooth=smooth)


def test_a_bar_of_index_seven_has_six_smooth_derivatives() -> None:
    bar = sc.scenes.elastic_bar()
    (name,) = [each.name for each in bar.model().inputs]
    path, report = sc.fastest(bar, [(0.0,), (1.0,)], {name: 50.0}, intervals=20)
    assert path.smoothness == 6
    peak = np.abs(bar.with_reference(path).exact(np.linspace(0.0, path.duration, 4001))[name]).max()
    assert 0.97 * 50.0 < peak <= 50.0
    assert report.duration < report.degree9
    assert str(report).splitlines()[1:3] == [
        f"degree 13       {report.degree9:.4g} s",
        "three-phase     not as smooth as the plan",
    ]


def fastest_alone(*arguments: Any, **options: Any) -> tuple[sc.Reference, PlanReport]:
    """Return a plan without the durations of the laws that are compared with it, which take most of the time."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("servocore.planning.fastest._compared", lambda *_: (np.inf, np.inf))
        return sc.fastest(*arguments, **options)


@pytest.mark.parametrize("name", WAYS)
def test_a_law_for_a_range_of_masses_keeps_the_limits_of_every_mass(name: str) -> None:
    nominal, (scene, way, limits) = planned(name)[1].duration, WAYS[name]
    path, report = fastest_alone(scene, way, limits, robust={"load_mass": (0.9, 1.1)}, intervals=QUICK)
    assert 1.02 * nominal < report.duration < 1.05 * nominal
    assert report.limits.evidence == "proved to be kept at all times, load_mass from 90 to 110 kg"
    for mass in (90.0, 97.0, 110.0):
        assert largest_excess(scene.with_parameters(load_mass=mass), path, BOUNDS[name]) <= 0.0


@pytest.mark.parametrize(("name", "points"), [("level", [LEVEL[0], (2, -4), LEVEL[1]]), ("line", CURVE)], ids=WAYS)
def test_a_curve_through_waypoints_is_followed_to_its_end(name: str, points: list[tuple[float, ...]]) -> None:
    path, report = fastest_alone(WAYS[name][0], points, WAYS[name][2], intervals=QUICK)
    t = np.linspace(0.0, path.duration, 4001)
    places = path.jet(t, 0)[:, 0]
    for point in points:
        assert np.linalg.norm(places - point, axis=1).min() < 2e-3
    assert report.duration < 1.027 * planned(name)[1].duration


def test_the_way_of_a_reference_counts_and_not_its_times() -> None:
    slow = fastest_alone(OVERHEAD, sc.rest_to_rest(LEVEL[0], LEVEL[1], 50.0), {"F": 200}, intervals=QUICK)[1]
    assert slow.duration == pytest.approx(planned("level")[1].duration, rel=1e-6)


def test_a_curve_with_rest_at_its_ends_is_followed_closely() -> None:
    given = sc.through(CURVE, duration=20)
    path, report = sc.fastest(CRANE, given, DEFAULT, intervals=COARSE)
    wanted, found = (each.jet(np.linspace(0, each.duration, 4001), 0)[:, 0] for each in (given, path))
    away = np.array([np.linalg.norm(found - place, axis=1).min() for place in wanted[::40]])
    assert 0.0 < report.deviation < 1e-3
    assert away.max() < report.deviation + 4e-3  # half the distance of neighbours


def test_a_curve_with_a_corner_is_refused() -> None:
    cornered = sc.through([(5, 0, -5), (3, 0, -5), (3, 0.001, -5), (3, 3, -5)], times=[0, 4, 8, 12])
    with pytest.raises(sc.InvalidReference, match="no smooth curve follows the path"):
        sc.fastest(CRANE, cornered, DEFAULT)


class TestFreeWay:
    """Between two points a plan may choose its way, clear of what stands there."""

    def test_without_obstacles_is_faster_than_known_laws_on_the_line(self) -> None:
        way = [(0, -4), (5, -1.5)]
        free = sc.fastest(OVERHEAD, way, FREE, free=sc.Space(), intervals=COARSE)[1]
        assert free.duration < 0.95 * min(free.degree9, free.three_phase)
        assert free.clearance == math.inf

    def test_needs_bodies_of_its_dimension(self) -> None:
        space = sc.Space((sc.Sphere((0.0, 0.0, 0.0), 1.0),))
        with pytest.raises(sc.InvalidSetting, match="2 dimensions"):
            sc.fastest(OVERHEAD, LEVEL, FREE, free=space)

    @pytest.mark.parametrize(
        ("body", "sentence"),
        [
            (sc.Sphere((5.0, -3.0), 0.4), r"at rest at (5, -4) a point of load, rope is "),
            (sc.Box((0.0, -4.53), (0.3, 0.5)), r"at rest at (0, -4) a point of load, rope is 0.03 m from Box"),
        ],
    )
    def test_a_body_at_an_end_is_named_before_anything_is_solved(self, body: sc.Sphere | sc.Box, sentence: str) -> None:
        with pytest.raises(sc.InvalidReference, match=re.escape(sentence)):
            sc.fastest(OVERHEAD, LEVEL, FREE, free=sc.Space((body,)))

    def test_a_body_has_finite_numbers(self) -> None:
        for wrong in (lambda: sc.Sphere((1.0, math.nan), 1.0), lambda: sc.Box((1.0, 2.0), (1.0, math.inf))):
            with pytest.raises(sc.InvalidSetting, match="needs finite numbers"):
                wrong()


def test_a_law_that_breaks_limits_between_the_points_is_looked_for_on_a_finer_grid(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rounds = "servocore.planning.fastest._ROUNDS"
    told: list[str] = []

    def progress(stage: str) -> None:
        told.append(stage)
        monkeypatch.setattr(rounds, 1 if stage.endswith(" 5 intervals") else 8)  # one look at 10, more afterwards

    monkeypatch.setattr(rounds, 1)
    path, report = fastest_alone(OVERHEAD, LEVEL, {"F": 200}, intervals=10, progress=progress)
    stages = [each for each in told if each.startswith("solving")]
    assert stages[:3] == ["solving on 5 intervals", "solving on 10 intervals", "solving on 20 intervals"]
    assert report.violation == 0.0
    assert len(path.stretches) == 21
