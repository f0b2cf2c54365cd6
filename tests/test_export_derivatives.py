"""Derivatives of native FMUs: exact along any direction, and the same from behind."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import fmpy
import numpy as np
import pytest
from native_fmu import END, FULL, START, Native, exported, jets_of, scene_called
from problems import began

import servocore as sc
from servocore.numerics.compiled_calls import Array

pytestmark = pytest.mark.usefixtures("compiler")


def displaced(host: Native) -> Native:
    """Let a plant begin beside its rest: the swing of a hanging rope has no derivative."""
    for each in exported(host.name).settings:
        if each.name.startswith("start.") and not each.name.startswith(("start.position", "start.velocity")):
            host.numbers_set([each.name], [0.02] * (each.size or 1))
    return host


def told_to(name: str, random: np.random.Generator) -> np.ndarray:
    """Return inputs (6, m) of a plant, all near those that hold it at the start."""
    _, hold = began(scene_called(name.split(maxsplit=1)[0]), exported(name).model)
    told: np.ndarray = hold + 0.02 * (np.abs(hold) + 1.0) * random.standard_normal((6, len(hold)))
    return told


def directions(name: str, random: np.random.Generator) -> dict[str, np.ndarray]:
    """Return a direction of all inputs and the model's parameters."""
    own = [each for each in exported(name).of("parameter") if not each.role]
    knowns = [*exported(name).of("input"), *own]
    return {each.name: random.standard_normal(each.size or 1) * (each.nominal or 1.0) * 0.01 for each in knowns}


def on_its_way(host: Native, at: int, random: np.random.Generator, shift: Mapping[str, Array] = {}) -> Iterator[int]:
    """Start somewhere and take some steps of a random length; yield the number of those that are done.

    In the last one inputs and parameters are shifted.
    """
    scene, h = scene_called(host.name.split()[0]), 10.0 ** random.uniform(-3.0, -1.0)
    if host.name.endswith("plant"):
        told = told_to(host.name, random)
        t = np.arange(6) * h
        displaced(host).start(told[0], input_time=at, brakes=2, hold=int(random.integers(1, 3)))
    else:
        t = scene.reference.start_time + random.uniform(0.1, 0.8) * scene.reference.duration + np.arange(6) * h
        told = jets_of(host.name, t)
        host.start(told[0], t[0], input_time=at)
    for k in range(5):
        yield k
        host.tell(told[k + (at == END)])
        for name, change in shift.items() if k == 4 else ():
            host.numbers_set([name], host.get(name) + change)
        assert host.step(t[k], h), host.messages
    yield 5


OTHERS = ("driven", "driven plant", "elastic_hoist", "wind")
WITH_PLANTS = [f"{name}{what}" for name in sc.scenes.REGISTRY for what in ("", " plant")]


@pytest.mark.parametrize(("name", "at"), [*((name, END) for name in (*WITH_PLANTS, *OTHERS)),
                                          ("rotary_crane", START), ("mass_on_car", START)])  # fmt: skip
def test_derivatives_are_difference_quotients(name: str, at: int) -> None:
    """In all that may change on the way: what is fixed has derivatives too (see the next test) but no shift."""
    fixed, found = {each.name for each in exported(name).of("parameter") if each.fixed}, []
    along = {key: each for key, each in directions(name, np.random.default_rng(1)).items() if key not in fixed}
    for shift in (0.0, -2e-3, -1e-3, 1e-3, 2e-3):
        with Native(name) as host:
            for _ in on_its_way(host, at, np.random.default_rng(3), {key: shift * each for key, each in along.items()}):
                pass
            found.append(
                host.values() if shift else host.derivatives(list(along), np.concatenate(list(along.values())))
            )
    exact, *ends = found
    quotient = (ends[0] - 8.0 * ends[1] + 8.0 * ends[2] - ends[3]) / 12e-3
    assert (np.abs(exact - quotient) <= 1e-6 * np.abs(exact) + 1e-9 * np.abs(exact).max()).all()


@pytest.mark.parametrize("seed", range(8) if FULL else range(1))
@pytest.mark.parametrize("at", [START, END])
@pytest.mark.parametrize("name", WITH_PLANTS)
def test_adjoint_products_are_those_of_directions(name: str, at: int, seed: int) -> None:
    """At random instants, after steps of 1 ms to 0.1 s, along random directions of all inputs and parameters."""
    random = np.random.default_rng([seed, len(name)])
    with Native(name) as host:
        for k in on_its_way(host, at, random):
            along = directions(name, random)
            direction = np.concatenate(list(along.values()))
            forward = host.derivatives(list(along), direction)
            # All outputs weigh alike; at the start of a plant nothing depends on inputs and parameters yet.
            weights = random.standard_normal(len(forward)) / (np.abs(forward) + 1e-3 * np.abs(forward).max() + 1e-300)
            backward = host.sensitivities(list(along), weights)
            assert np.abs(forward).max() > 0.0 or k == 0
            # What cancels in a sum was there.
            size = np.abs(weights * forward).sum() + np.abs(backward * direction).sum()
            # Three times the direction has three times the derivatives: they differ by the round-off of the solution.
            round_off = np.abs(weights * (host.derivatives(list(along), 3.0 * direction) / 3.0 - forward)).sum()
            assert abs(weights @ forward - backward @ direction) <= 1e-12 * size + round_off


def test_an_output_without_a_derivative_keeps_it_from_no_other() -> None:
    """The angle of a rope from the vertical is a length, which has a corner at zero: where every plant begins."""
    with Native("gantry_crane plant") as host:
        host.start(brakes=2)
        along, every = ["F_x", "load_mass"], host.results
        with pytest.raises(fmpy.fmi1.FMICallException):
            host.derivatives(along, [1.0, 1.0])
        assert host.messages[-1] == "at t = 0 s swing has no derivative"
        host.results = tuple(each for each in every if each != "swing")
        assert np.isfinite(found := host.derivatives(along, [1.0, 1.0])).all()
        assert found[-1] != 0.0  # the tension grows with the mass
