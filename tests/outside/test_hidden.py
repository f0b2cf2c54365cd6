"""Silent and wrong: answers hold every equation at every instant asked for, and are wrong."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
import pytest
from outside.systems import arm
from outside.writing import coordinates, lagrange

import servocore as sc

REACH = 1.8


def out_and_back(reach: float, scale: float = 1.0) -> sc.Scene:
    """The hand goes out along x from 0.9 m to a reach, at t = 1 s, and back."""
    middle, way = (reach + 0.9) / 2, (reach - 0.9) / 2
    path = sc.periodic((scale * middle, 0.0), [[-scale * way, 0.0]], [[0.0, 0.0]], 2.0)
    links = partial(arm, lengths=(scale, 0.8 * scale), home=(1.2 * scale, 0.6 * scale))
    return sc.Scene("arm", {"arm": links}, path)


@pytest.mark.parametrize(("rows", "beyond"), [(3, 0.2), (5, 0.02), (7, 4e-3), (9, 3e-3), (11, 1e-3), (15, 5e-4)])
def test_a_path_that_is_out_of_reach_between_few_instants_only_is_refused(rows: int, beyond: float) -> None:
    with pytest.raises(sc.InvalidReference, match="out of reach"):
        sc.solve(out_and_back(REACH + beyond), step=2.0 / rows)


@pytest.mark.parametrize("beyond", [1e-6, 1e-9])
def test_the_branch_ends_where_it_ends_and_not_where_the_guess_is_far(beyond: float) -> None:
    for ask in (sc.solve, lambda scene: sc.ExactInversion(scene)(np.linspace(0.0, 2.0, 38))):
        with pytest.raises(sc.ServocoreError) as caught:
            ask(out_and_back(REACH + beyond))
        assert "0.999" in str(caught.value)


@pytest.mark.parametrize("scale", [1.0, 1e-2, 1e-5])
def test_how_far_the_reach_is_missed_is_told_at_every_size(scale: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("servocore.checks.failure_causes._INSTANTS", 5)  # one of them is t = 1 s
    monkeypatch.setattr("servocore.checks.failure_causes.BISECTIONS", 4)  # from when on is of no interest here
    with pytest.raises(sc.InvalidReference, match="out of reach") as caught:
        sc.solve(out_and_back(REACH + 0.2, scale))
    missed = str(caught.value).partition("misses X = ")[2].split(" by ")[1].split()[0]
    assert float(missed) == pytest.approx(0.2 * scale, rel=0.02)


def test_a_singularity_that_is_passed_is_told_and_an_instant_on_it_is_refused() -> None:
    """TimeScaled at t = 1 s exactly, the elbow goes through: the torques have a limit there, and no value."""
    found = sc.solve(out_and_back(REACH), step=2.0 / 37)
    assert re.search(r"between t = 0\.99\d+ s and 1\.00\d+ s the equations are singular", found.statistics.branch)
    assert np.abs(found["T_1"]).max() < 100.0
    with pytest.raises(sc.IntegrationFailed, match="singular at t = 1 s"):
        sc.solve(out_and_back(REACH), step=0.01)


@pytest.mark.parametrize("steps", [37, 201, 333])
def test_torques_of_an_arm_that_is_all_but_stretched_are_told(steps: int) -> None:
    """A billionth of a metre short of its reach T_1 is 182 kN m for some microseconds."""
    with pytest.warns(sc.ServocoreWarning, match="close to a pole"):
        sc.solve(out_and_back(REACH - 1e-9), step=2.0 / steps)


def mass_on_a_rail(mass: Callable[[ca.SX], Any], force: Callable[[ca.SX], Any]) -> sc.Scene:
    q = coordinates("x")
    x, v = q.q[0], q.v[0]
    system = lagrange("mass", q, mass(x) * v**2 / 2, {"Y": x}, {"F": x}, home=(0.1,))
    system = replace(system, force=force(v))
    return sc.Scene("mass", {"only": lambda: system}, sc.rest_to_rest((0.0,), (1.0,), 2.0))


@pytest.mark.parametrize("method", [None, sc.RadauIIA(2)])
@pytest.mark.parametrize("friction", [lambda v: -8 * v / ca.fabs(v), lambda v: -v * ca.log(ca.fabs(v))])
def test_inputs_that_are_no_numbers_are_refused_with_the_time(
    friction: Callable[[ca.SX], ca.SX], method: sc.RadauIIA | None
) -> None:
    with pytest.raises(sc.IntegrationFailed, match=r"at t = 0 s"):
        sc.solve(mass_on_a_rail(lambda _: ca.SX(2), friction), None if method is None else sc.Reduced(), method)


def test_a_mass_that_becomes_negative_on_the_way_is_refused_with_the_time() -> None:
    scene = mass_on_a_rail(lambda x: 3 - 6 * x, lambda _: ca.SX(0))
    with pytest.raises(sc.InvalidModel, match=r"at t = \S+ s the mass matrix has the negative eigenvalue -"):
        sc.solve(scene)


def test_a_large_force_that_is_no_peak_is_left_alone() -> None:
    scene = mass_on_a_rail(lambda _: ca.SX(2), lambda _: ca.SX(0))
    far = scene.with_reference(sc.rest_to_rest((0.0,), (1e9,), 2.0))
    for how in ((), (sc.Projected(), sc.BDF(2))):
        assert np.abs(sc.solve(far, *how, step=0.01)["F"]).max() > 1e9
