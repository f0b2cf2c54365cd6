"""Families of right and of bad runs by chance: bad ones are never proved, and a cause is told."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import test_meeting_branches as meeting
from test_certificate import QUADROTOR, line
from test_failure_causes import arm
from thinned import thinned

import servocore as sc
from servocore.references.profiles import DEGREE5, DEGREE9
from servocore.references.rest_to_rest import RestToRest

CRANE, OVERHEAD, GANTRY, BOOM = (
    sc.scenes.REGISTRY[name]() for name in ("rotary_crane", "overhead_crane", "gantry_crane", "boom_crane")
)
Family = Callable[[np.random.Generator, bool], sc.Scene]
FAMILIES: dict[str, tuple[Family, str]] = {}
"""A family makes a right or a bad scene by chance; beside it the causes that are true of the bad ones."""


def one_of(rng: np.random.Generator, *scenes: sc.Scene) -> tuple[sc.Scene, RestToRest]:
    scene = scenes[rng.integers(len(scenes))]
    assert isinstance(scene.reference, RestToRest)
    return scene, scene.reference


def family(cause: str) -> Callable[[Family], Family]:
    def added(make: Family) -> Family:
        FAMILIES[make.__name__] = make, cause
        return make

    return added


@family("slewing axis|comes to zero|singular|between instants")
def through_the_axis(rng: np.random.Generator, bad: bool) -> sc.Scene:
    """Lines of the load through the slewing axis of a crane or within 3 mm of it; right ones pass at half a metre."""
    angle, height = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-6.0, -2.0)
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    aside = (rng.choice([0.0, 3e-3]) if bad else rng.uniform(0.5, 1.0)) * across
    ends = [(*(aside + sign * rng.uniform(2.0, 4.0) * along), height) for sign in (1.0, -1.0)]
    return line(CRANE, ends[0], ends[1], rng.uniform(15.0, 30.0))


@family("slack")
def slack_ropes(rng: np.random.Generator, bad: bool) -> sc.Scene:
    """Loads that are lowered faster than they fall, at the peak of a degree-9 law; right ones by half of that."""
    drop, way = rng.uniform(1.0, 4.0), rng.uniform(0.0, 3.0)
    share = rng.uniform(1.05, 2.0) if bad else rng.uniform(0.2, 0.5)
    duration = float(np.sqrt(9.3721 * drop / (share * 9.81)))  # s'' of that law is 9.37 at most
    scene, path = one_of(rng, OVERHEAD, GANTRY)
    aside = (0.0,) * (path.dimension - 2)
    return line(scene, (0.0, *aside, -1.0), (way, *aside, -1.0 - drop), duration, profile=DEGREE9)


@family("branches meet|kink")
def meeting_branches(rng: np.random.Generator, bad: bool) -> sc.Scene:
    """Linkages through the stretched position, where two assemblies meet; right ones have a longer rocker."""
    path = sc.rest_to_rest((rng.uniform(0.2, 1.2),), (np.pi + rng.uniform(0.3, 1.2),), rng.uniform(2.0, 6.0))
    return meeting.scene(path, longer=0.0 if bad else float(10.0 ** rng.uniform(-3.0, -1.0)))


def reaching(rng: np.random.Generator, far: float) -> sc.Scene:
    """An arm with a reach of 1.8 m from a place near its shoulder to one that is so far from it."""
    angles, near = rng.uniform(0.0, 1.5, 2), rng.uniform(0.8, 1.1)
    start, end = ((r * np.cos(t), r * np.sin(t)) for r, t in zip((near, far), angles, strict=True))
    return arm(start, end)


@family("out of reach")
def out_of_reach(rng: np.random.Generator, bad: bool) -> sc.Scene:
    return reaching(rng, rng.uniform(1.81, 3.0) if bad else rng.uniform(1.3, 1.7))


@family("refuted: mass matrix")
def negative_masses(rng: np.random.Generator, bad: bool) -> sc.Scene:
    """An arm whose mass falls where it stretches: negative beyond 1.71 m from the shoulder."""
    scene = reaching(rng, rng.uniform(1.73, 1.78) if bad else rng.uniform(1.3, 1.69))
    system = scene.model()
    lighter = replace(system, mass=(0.8 - ca.cos(system.q[1])) * system.mass)
    return replace(scene, models={"light": lambda: lighter})


@family("too rough")
def rough_paths(rng: np.random.Generator, bad: bool) -> sc.Scene:
    """Laws that start with a jump of the third derivative: too few for cranes, enough with one that starts smoothly."""
    scene, path = one_of(rng, OVERHEAD, GANTRY, BOOM, CRANE, QUADROTOR)
    start, end = np.array([path.start, path.end]) + rng.uniform(-0.1, 0.1, (2, path.dimension))
    duration = path.duration * rng.uniform(1.0, 1.5)
    return line(scene, tuple(start), tuple(end), duration, profile=DEGREE5 if bad else path.profile)


@family("between instants")
def spikes(rng: np.random.Generator, bad: bool) -> sc.Scene:
    """Lines on which the thrust of a quadrotor turns fast between two of 201 instants, by the closed form."""
    _, path = one_of(rng, QUADROTOR)
    while True:
        sharp = rng.uniform(1.6, 1.8) if bad else rng.uniform(2.5, 4.0)
        way = (path.start[0] + rng.uniform(5.0, 7.0), path.start[1] + rng.uniform(1.0, 3.0))
        scene = line(QUADROTOR, path.start, way, sharp, profile=path.profile)
        most = [np.abs(scene.exact(np.linspace(0.0, sharp, n))["M"]).max() for n in (201, 40_001)]
        if (most[1] > 2.1 * most[0]) == bad:
            return scene


@family("limit of ")
def narrow_limits(rng: np.random.Generator, bad: bool) -> sc.Scene:
    """Limits a billionth below the largest value between 100,001 instants, or a millionth above it."""
    scene, path = one_of(rng, OVERHEAD, GANTRY, CRANE, QUADROTOR)
    scene = scene.with_parameters(load_mass=scene.parameter_values()["load_mass"] * rng.uniform(0.7, 1.4))
    values = scene.exact(np.linspace(path.start_time, path.end_time, 100_001))
    name = rng.choice([each.name for each in scene.model().inputs])
    low, high = values[name].min(), values[name].max()
    size = max(abs(low), abs(high)) * (-1e-9 if bad else 1e-6)
    limited: sc.Scene = scene.with_limits(**{name: (low - size, high + size)})
    return limited


@pytest.mark.parametrize(
    ("name", "bad", "seed"),
    thinned([(name, bad, seed) for name in FAMILIES for bad in (True, False) for seed in range(13)],
            lambda case: case[2] == 0 and case[:2] not in {("slack_ropes", True), ("through_the_axis", True)}),
)  # fmt: skip
def test_what_is_right_is_proved_and_of_what_is_not_a_true_cause_is_told(name: str, bad: bool, seed: int) -> None:
    make, cause = FAMILIES[name]
    certificate = sc.certify(make(np.random.default_rng([seed, bad]), bad))
    assert (certificate.verdict == "proved") is not bad, certificate
    if bad:
        told = " ".join(str(each) for each in certificate.statements if each.verdict != "proved")
        assert re.search(cause, told), certificate
