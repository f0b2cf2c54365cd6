"""Constraints that follow from the others where a model is at home, and somewhere else do not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from native_fmu import END, Native
from outside.writing import coordinates, lagrange, square

import servocore as sc

RELATION = 2.0


def cars(
    constraints: Callable[..., tuple[ca.SX, ...]], end: float = 1.0, *, timed: bool = False, coupled: bool = True
) -> sc.Scene:
    """Two cars on a spring, or one geared to the other, with constraints (x, y, t)."""
    q, t = coordinates("x y"), ca.SX.sym("t")
    x, y = ca.vertsplit(q.q)
    slope = RELATION if coupled else 1.0
    system = lagrange(
        "cars", q, square(q.v) / 2, {"Y": y}, {"F": x}, potential=5 * (x - slope * y) ** 2,
        constraints=ca.vertcat(*constraints(x, y, t)), guess=lambda at: (slope * at[0], at[0]), home=(0.1,),
        **({"time": t} if timed else {}),
    )  # fmt: skip
    return sc.Scene("cars", {"only": lambda: system}, sc.rest_to_rest((0.0,), (end,), 2.0))


def geared(x: ca.SX, y: ca.SX) -> ca.SX:
    return x - RELATION * y


def stop_at(place: float) -> Callable[..., tuple[ca.SX, ...]]:
    return lambda x, *_: (ca.fmax(0, x - place),)


HOW: tuple[tuple[Any, ...], ...] = ((), (sc.Projected(), sc.BackwardEuler()), (sc.Original(), sc.BDF(2)))


@pytest.mark.parametrize("how", HOW, ids=str)
def test_a_stop_that_is_reached_is_told_and_one_that_is_not_is_none(how: tuple[Any, ...]) -> None:
    with pytest.raises(sc.InvalidModel, match=r"the holonomic constraint g_1 does not hold, by \S+: it follows from"):
        sc.solve(cars(stop_at(0.6), coupled=False), *how, step=0.02)
    sc.solve(cars(stop_at(1.5), coupled=False), *how, step=0.005)


@pytest.mark.parametrize("how", HOW, ids=str)
def test_two_supports_that_part_are_refused(how: tuple[Any, ...]) -> None:
    scene = cars(lambda x, y, t: (geared(x, y), geared(x, y) - 0.1 * t**4), timed=True)
    with pytest.raises(sc.InvalidModel, match=r"at t = \S+ s the holonomic constraint g_[12] does not hold"):
        sc.solve(scene, *how, step=0.02)


def test_what_prepares_inputs_refuses_it_too() -> None:
    with pytest.raises(sc.InvalidModel, match="the holonomic constraint g_1 does not hold"):
        sc.ExactInversion(cars(stop_at(0.6), coupled=False))
    simulated = cars(stop_at(0.6), coupled=False)
    with pytest.raises(sc.InvalidModel, match="the holonomic constraint g_1 does not hold"):
        sc.simulate(simulated, sc.solve(simulated, step=0.02, checks=False))


def test_what_exports_refuses_the_path_of_the_scene_with_the_same_sentence(tmp_path: Path) -> None:
    scene = cars(stop_at(0.6), coupled=False)
    for refused in (lambda: sc.export_fmu(scene, tmp_path / "cars.fmu"), lambda: sc.sensitivities(scene, wrt=())):
        with pytest.raises(
            sc.InvalidModel, match=r"at t = \S+ s the holonomic constraint g_1 does not hold, by \S+: it"
        ):
            refused()
    assert not list(tmp_path.iterdir())


NEAR, FAR = sc.rest_to_rest((0.0,), (0.4,), 2.0), sc.rest_to_rest((0.0,), (1.0,), 2.0)


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_refuses_a_path_of_its_host_that_breaks_it(fmi: int, tmp_path: Path) -> None:
    scene = cars(stop_at(0.6), coupled=False).with_reference(NEAR)
    file = sc.export_fmu(scene, tmp_path / "cars.fmu", fmi=fmi, targets="host")
    ended = {}
    for path in (NEAR, FAR):
        with Native("cars", fmi, file) as host:
            host.start(path.jet(0.0, 4), 0.0, input_time=END)
            steps = (host.tell(path.jet(0.1 * (k + 1), 4)).step(0.1 * k, 0.1) for k in range(20))
            ended[path] = all(steps), host.messages
    assert ended[NEAR][0]
    assert not ended[FAR][0]
    assert "at t = 1.3 s the holonomic constraint g_1 does not hold, it follows from the others" in ended[FAR][1][-1]


def test_sweeps_and_batches_refuse_a_path_that_breaks_it() -> None:
    scene = cars(stop_at(0.6), coupled=False).with_reference(NEAR)
    found = sc.sweep(scene, references=[NEAR, FAR])
    assert found["failure"].values[0] == ""
    assert "the holonomic constraint g_1 does not hold" in found["failure"].values[1]
    batch = sc.Batch(scene)
    values = batch(np.linspace(0.0, 2.0, 9), paths=[NEAR, FAR])
    assert [np.isfinite(case).all() for case in values] == [True, False]
    with pytest.raises(
        sc.InvalidModel, match=r"case 1 of a batch: cars: at t = .* the holonomic constraint g_1 does not"
    ):
        batch.solve(paths=[NEAR, FAR])


@pytest.mark.parametrize("size", [1e-8, 1.0, 1e8])
def test_constraints_that_are_redundant_everywhere_are_left_out(size: float) -> None:
    twice = cars(lambda x, y, _: (geared(x, y), size * geared(x, y)))
    once = sc.solve(cars(lambda x, y, _: (geared(x, y),)), step=0.02)
    assert sc.solve(twice, step=0.02)["F"] == pytest.approx(once["F"], abs=1e-12)
