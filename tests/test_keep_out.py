"""Plans whose way is free keep load and rope clear of bodies, however thin, by formulas that no planner uses."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
import pytest
from test_planning import COARSE, CRANE, FREE, LEVEL, OVERHEAD

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.planning.integrator_chains import Law
from servocore.planning.obstacles import least_distance, segment_distance
from servocore.planning.transcription import SOLVED, Outcome, Task

DRIVES: Mapping[str, Any] = {
    "M_b": 1000,
    "F": 100,
    "M_w": (-108.1, -88.1),
    "swing": "8 deg",
    "s": (1, None),
    "z": (-6, -1),
}


def rope(path: sc.Reference) -> tuple[Array, Array]:
    """Return where the rope begins and ends at 20,001 instants: along the load's acceleration less gravity."""
    jets = path.jet(np.linspace(0.0, path.duration, 20_001), 2)
    load, pull = jets[:, 0], jets[:, 2].copy()
    pull[:, -1] += 9.81
    return load, load - (load[:, -1] / pull[:, -1])[:, None] * pull


def passes_a_sphere(begin: Array, end: Array, sphere: sc.Sphere) -> bool:
    """Say whether any segment has a point within: roots of |begin + f way - centre| = radius lie between 0 and 1."""
    way, away = end - begin, begin - np.array(sphere.centre)
    a, b, c = (way * way).sum(axis=1), (way * away).sum(axis=1), (away * away).sum(axis=1) - sphere.radius**2
    inside = b * b - a * c
    root = np.sqrt(np.maximum(inside, 0.0))
    return bool(((inside > 0.0) & (-b - root < a) & (-b + root > 0.0)).any())


def passes_a_box(begin: Array, end: Array, box: sc.Box) -> bool:
    """Say whether any segment has a point within: it is between all pairs of faces at the same time."""
    with np.errstate(divide="ignore", invalid="ignore"):
        edges = [(np.array(box.centre) + side * np.array(box.half) - begin) / (end - begin) for side in (-1.0, 1.0)]
    enters, leaves = np.minimum(*edges).max(axis=1), np.maximum(*edges).min(axis=1)
    return bool((np.maximum(enters, 0.0) < np.minimum(leaves, 1.0)).any())


def test_a_plan_passes_a_sphere_that_is_thinner_than_the_distance_of_points_on_a_rope(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("servocore.planning.fastest._on_the_line", lambda *_: (np.inf, np.inf))  # for comparison only
    sphere = sc.Sphere((2.5, -3.0), 0.1)
    path, report = sc.fastest(OVERHEAD, LEVEL, FREE, free=sc.Space((sphere,)), intervals=COARSE)
    assert not passes_a_sphere(*rope(path), sphere)
    assert 0.0 < report.clearance < 0.3
    assert np.abs(path.jet(np.linspace(0, path.duration, 999), 0)[:, 0, 1]).min() < 2.9  # it is lifted above


def test_a_plan_passes_a_thin_plate_above_it() -> None:
    plate = sc.Box((2.5, -3.0), (0.6, 0.01))
    path, report = sc.fastest(OVERHEAD, LEVEL, FREE, free=sc.Space((plate,)), intervals=COARSE)
    assert not passes_a_box(*rope(path), plate)
    assert 0.0 < report.clearance < 0.3
    assert report.duration < 1.3 * 3.64  # with the way of the level line, which is not clear
    exact = OVERHEAD.with_reference(path).exact(np.linspace(0.0, path.duration, 20_001))
    assert np.abs(exact["F"]).max() <= 200.0
    assert exact["swing"].max() <= math.radians(15.0)


def test_a_way_through_a_body_is_never_handed_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the search finds: here the law along the line from which it begins."""

    def begun(_: Task, starts: Sequence[tuple[str, Law]], *more: object) -> tuple[Outcome, float, str]:
        del more
        return Outcome(starts[0][1], SOLVED, 0), np.nan, starts[0][0]

    monkeypatch.setattr("servocore.planning.fastest.planned", begun)
    monkeypatch.setattr("servocore.planning.tasks._HOPS", ())  # beside the line
    space = sc.Space((sc.Sphere((2.5, -2.0), 0.001),))
    with pytest.raises(sc.PlanningFailed, match="load, rope do not keep clear of the bodies"):
        sc.fastest(OVERHEAD, LEVEL, FREE, free=space, intervals=COARSE)


BODIES = [sc.Sphere((0.2, -0.3, 0.1), 0.4), sc.Box((0.2, -0.3, 0.1), (0.4, 0.02, 0.3))]
each_body = pytest.mark.parametrize("body", BODIES, ids=["sphere", "box"])


@each_body
def test_the_distance_of_a_segment_is_the_least_of_its_points(body: sc.Sphere | sc.Box) -> None:
    begin, end = np.random.default_rng(5).uniform(-1.0, 1.0, (2, 300, 3))
    parts = np.linspace(0.0, 1.0, 4001)
    every = np.min([body.distance(begin + part * (end - begin)) for part in parts], axis=0)
    found = segment_distance(begin, end, body.distance)
    assert (found <= every + 1e-6).all()
    assert (found > every - 1e-3).all()  # neighbours are up to 9e-4 m apart
    away = np.abs(found) > 2e-3

    def passes(begin: Array, end: Array) -> bool:
        return passes_a_sphere(begin, end, body) if isinstance(body, sc.Sphere) else passes_a_box(begin, end, body)

    for k in np.flatnonzero(away):
        assert passes(begin[k : k + 1], end[k : k + 1]) == (found[k] < 0.0)


@each_body
def test_a_plan_looks_where_a_rope_is_nearest(body: sc.Sphere | sc.Box) -> None:
    a, b, place = ca.SX.sym("a", 3), ca.SX.sym("b", 3), ca.SX.sym("place", 3)
    least, row = (
        ca.Function("least", [a, b], [body.row(body.nearest(a, b))]),
        ca.Function("row", [place], [body.row(place)]),
    )
    for begin, end in np.random.default_rng(6).uniform(-1.0, 1.0, (40, 2, 3)):
        points = begin[:, None] + (end - begin)[:, None] * np.linspace(0.0, 1.0, 2001)
        worst = float(np.asarray(row(points)).max())
        assert float(least(begin, end)) == pytest.approx(worst, abs=1e-4)


@pytest.mark.parametrize("radius", [1e-2, 1e-5])
def test_what_moves_past_between_two_instants_is_seen(radius: float) -> None:
    body = sc.Sphere((3.0 * 0.4321 + 3.0 / 40_000, 0.0), radius)

    def passing(height: float) -> float:
        def ends(t: Array) -> tuple[Array, Array]:
            here = np.column_stack([3.0 * t, np.full(len(t), height)])
            return here, here

        return least_distance(ends, body.distance, 0.0, 1.0)

    assert passing(0.5 * radius) < 0.0
    assert passing(3.0 * radius) == pytest.approx(2.0 * radius, rel=0.1)


def test_a_body_in_the_bridge_is_passed_or_refused_in_a_sentence() -> None:
    space = sc.Space((sc.Sphere((5.0, 0.1, 0.0), 0.3),), clearance_of=("load", "rope", "bridge"))
    with pytest.raises(
        sc.InvalidReference, match=re.escape("at rest at (5, 0, -5) a point of load, rope, bridge is 0.2 m")
    ):
        sc.fastest(CRANE, [(5, 0, -5), (-2, 2, -5)], DRIVES, free=space)
