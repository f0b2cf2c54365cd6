"""Beams and ropes, and displacement control: against closed forms, by refinement, and past limit points."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import casadi as ca
import conserved
import numpy as np
import pytest
from flexible import unstrained
from outside.writing import coordinates, lagrange
from thinned import thinned

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.rotationless import GROUND, Assembly, Beam, ElasticRope, Frame, Section, angle, fixed, revolute, turned

LENGTH, BENDING = 2.0, 10.0
ALONG_X = ca.SX(np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=float))
"""Directors of a beam along x that bends about y."""
Y = (0, 1, 0)


def section(axial: float, bending: float, line_mass: float = 0.0, inertia: float = 0.0) -> Section:
    return Section(axial, (axial / 2, axial / 2), (bending, bending), bending, line_mass, (inertia, inertia))


# A cantilever under a moment at its tip ------------------------------------------------------------------------------


def cantilever(elements: int) -> sc.MechanicalSystem:
    """A clamped beam without mass; the moment at its tip drives the tip's angle."""
    beam = Beam("beam", LENGTH, elements, section(1e4, BENDING))
    parts = Assembly((beam, sc.Quantity("phi", "rad")), sc.Parameters(), gravity=(0, 0, 0))
    root, tip, phi = parts.node("beam", 0), parts.node("beam", -1), parts.augmented("phi")
    size = LENGTH / elements

    def rolled(y: ca.SX) -> dict[str, object]:
        nodes, place = [], ca.SX.zeros(3)
        for k in range(elements + 1):
            nodes.append((place, turned(Y, y[0] * k / elements) @ ALONG_X))
            place = place + size * (turned(Y, y[0] * (k + 0.5) / elements) @ ALONG_X)[:, 2]
        return {"beam": nodes, "phi": y[0]}

    return parts.system(
        "cantilever",
        constraints={
            "clamp": fixed(Frame(ca.SX.zeros(3), ALONG_X).at(), root.at()),
            "phi": angle(GROUND.at(axis=Y, normal=(1, 0, 0)), tip.at(axis=Y, normal=(0, 0, 1)), phi),
        },
        inputs={sc.Quantity("M", "N.m"): phi},
        outputs={sc.Quantity("turn", "rad"): phi},
        guess=rolled,
        home=(1.0,),
    )


@lru_cache
def rolled_up(elements: int, turn: float) -> sc.Solution:
    path = sc.rest_to_rest((0.1,), (turn,), 1.0)
    return sc.solve(sc.Scene("cantilever", {"only": lambda: cantilever(elements)}, path), step=0.1)


def test_a_cantilever_bends_into_an_arc_with_errors_of_order_two() -> None:
    """E I / L times the angle is the moment; the tip is at R (sin, cos - 1)."""
    errors = []
    for elements in (2, 4):
        found = rolled_up(elements, 1.0)
        turn, radius = found["turn"], LENGTH / found["turn"]
        x, z = found[f"beam.{elements}.x"], found[f"beam.{elements}.z"]
        moment = np.abs(found["M"] - BENDING / LENGTH * turn).max()
        place = np.hypot(x - radius * np.sin(turn), z - radius * (np.cos(turn) - 1)).max()
        errors.append((moment, place))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.2)


def test_a_cantilever_rolls_up_to_a_full_circle() -> None:
    """An element that turns by t resists with the sine and cosine of t: the moment is E I N / L sin t cos t."""
    elements = 6
    found = rolled_up(elements, 2 * np.pi)
    each = found["turn"] / elements
    exact = BENDING * elements / LENGTH * np.sin(each) * np.cos(each)
    np.testing.assert_allclose(found["M"], exact, rtol=1e-9)
    end = [found[f"beam.{elements}.{axis}"][-1] for axis in "xyz"]
    np.testing.assert_allclose(end, 0.0, atol=1e-6)


# Energy and momentum --------------------------------------------------------------------------------------------------


def flying_beam(elements: int = 3) -> conserved.Motion:
    """A beam without weight that is thrown, turning and bending."""
    beam = Beam("beam", LENGTH, elements, section(2000.0, 20.0, line_mass=1.0, inertia=0.01))
    parts = Assembly((beam,), sc.Parameters(), gravity=(0, 0, 0))
    nodes = unstrained(beam, GROUND)
    system = conserved.made(parts, "flying beam", parts.node("beam", 0).origin[0], {"beam": nodes})
    q = np.asarray(ca.DM(parts.configuration({"beam": nodes}))).ravel()
    omega = np.array([1.0, 0.4, 0.7])
    turn = np.vstack([np.cross(omega, each) for each in q.reshape(-1, 3)])
    turn[::4] += np.outer((2 * np.arange(elements + 1) / elements - 1) ** 2, [2.0, 0.0, 0.0])  # the ends one way
    mass = np.array([0.5, *[1.0] * (elements - 1), 0.5])
    turn[::4] -= mass @ turn[::4] / mass.sum()
    return conserved.Motion(system, conserved.started(system.coordinates.names, q, turn.ravel()), "xyz")


@pytest.mark.parametrize("steps", thinned([300, 10_000], lambda steps: steps < 10_000))
def test_a_flying_beam_keeps_energy_and_momentum(steps: int) -> None:
    motion = flying_beam()
    found = motion.run(0.01, steps, every=25)
    energy, momentum = motion.drift(found)
    assert energy < 1e-10
    assert momentum < 1e-10
    assert found.statistics.constraint_violation < 1e-12
    bend = sum(found[f"beam.0.d{k}_x"] * found[f"beam.3.d{k}_x"] for k in (1, 2, 3))
    assert np.ptp(bend) > 0.01  # it does bend


# Displacement control -------------------------------------------------------------------------------------------------

STIFFNESS, HALF_SPAN, RISE = 1e6, 1.0, 0.2
BAR = float(np.hypot(HALF_SPAN, RISE))


def truss(controlled: str) -> sc.MechanicalSystem:
    """Two bars to one joint, without inertia: q = (across, down, load). The load, or the way down, is prescribed."""
    q = coordinates("across down load")
    across, down, load = ca.vertsplit(q.q)
    lengths = [ca.sqrt((HALF_SPAN + side * across) ** 2 + (RISE - down) ** 2) for side in (1, -1)]
    strain = sum(STIFFNESS / (2 * BAR) * (each - BAR) ** 2 for each in lengths)
    by_way = controlled == "down"
    return lagrange(
        "von Mises truss",
        q,
        ca.SX(0),
        {"prescribed": q[controlled]},
        {"P": q[controlled]},
        potential=strain + (load**2 / 2 if by_way else -load * down),
        guess=lambda y: (0, y[0], 0) if by_way else (0, 0, y[0]),
        home=(0.05 if by_way else 1.0,),
    )


def truss_load(down: Array) -> Array:
    length = np.hypot(HALF_SPAN, RISE - down)
    return -2 * STIFFNESS * (length - BAR) / BAR * (RISE - down) / length


def controlled(name: str, end: float) -> sc.Solution:
    path = sc.rest_to_rest((0.0,), (end,), 1.0)
    return sc.solve(sc.Scene("truss", {"only": lambda: truss(name)}, path), step=0.005)


def test_a_truss_snaps_through_under_displacement_control() -> None:
    found = controlled("down", 0.5)
    exact = truss_load(found["prescribed"])
    assert np.abs(found["P"] - exact).max() < 1e-10 * np.abs(exact).max()
    assert (np.diff(np.sign(np.diff(exact))) != 0).sum() == 2  # it passes both limit points


def test_load_control_fails_at_the_first_limit_point() -> None:
    """Its load is the largest that the first branch bears; 1.2 times as much has no equilibrium near."""
    largest = truss_load(np.linspace(0.0, RISE, 2001)).max()
    assert np.isfinite(controlled("load", 0.9 * largest).values).all()
    with pytest.raises(sc.ServocoreError):
        controlled("load", 1.2 * largest)


def arch(elements: int = 8, rise: float = 0.1, span: float = 2.0) -> tuple[sc.MechanicalSystem, float]:
    """A shallow pinned arch of a curved beam; a force presses on its top."""
    radius = (span**2 / 4 + rise**2) / (2 * rise)
    half = np.arcsin(span / 2 / radius)
    length = 2 * radius * half
    bend = float(np.sin(2 * half / elements) * elements / length)
    beam = Beam("arch", length, elements, section(1e5, 82.0), curvature=(0.0, bend, 0.0))
    parts = Assembly((beam,), sc.Parameters(), gravity=(0, 0, 0))
    tangent = np.array([np.cos(half), 0.0, np.sin(half)])
    directors = np.column_stack([np.cross(Y, tangent), Y, tangent])
    nodes = unstrained(beam, Frame(ca.SX([-span / 2, 0, 0]), ca.SX(directors)))
    places = [np.asarray(ca.DM(place)).ravel() for place, _ in nodes]
    top, height = parts.node("arch", elements // 2).origin[2], float(places[elements // 2][2])
    system = parts.system(
        "arch",
        constraints={
            side: revolute(GROUND.at(tuple(places[k]), axis=Y), parts.node("arch", k).at(axis=Y))
            for side, k in (("left", 0), ("right", elements))
        },
        inputs={sc.Quantity("P", "N"): -top},
        outputs={sc.Quantity("height", "m"): top},
        guess=lambda y: {"arch": [(ca.vertcat(r[0], r[1], r[2] * y[0] / height), D) for r, D in nodes]},
        home=(0.9 * height,),
    )
    return system, height


def stationary(system: sc.MechanicalSystem, q: Array, height: float) -> float:
    """The load in equilibrium at a height, by Newton's method on the stationary energy, and the configuration."""
    lam, load = ca.SX.sym("lam", system.lam.numel()), ca.SX.sym("P")
    energy = ca.SX(system.potential) + ca.dot(lam, system.constraints) + load * (system.output - height)
    x = ca.vertcat(system.q, lam, load)
    gradient = ca.gradient(energy, x)
    step = ca.Function("step", [x], [ca.jacobian(gradient, x), gradient])
    now = np.concatenate([q, np.zeros(lam.numel() + 1)])
    for _ in range(30):
        K, force = (np.asarray(each) for each in step(now))
        now = now - np.linalg.solve(K, force.ravel())
    assert np.abs(np.asarray(step(now)[1])).max() < 1e-6
    return float(now[-1])


def test_a_shallow_arch_is_followed_past_both_limit_points() -> None:
    """Loads are those of stationary energy, found by other means at some heights; load control ends at the first."""
    system, height = arch()
    path = sc.rest_to_rest((height,), (-1.1 * height,), 1.0)
    found = sc.solve(sc.Scene("arch", {"only": lambda: system}, path), step=0.01)
    load, turns = found["P"], np.flatnonzero(np.diff(np.sign(np.diff(found["P"]))))
    assert len(turns) == 2
    assert load[turns[0] + 1] > 2 * load[turns[1] + 1]
    for k in (20, 40, 50, 60, 90):
        q = np.array([found[name][k] for name in system.coordinates.names])
        assert stationary(system, q, found["height"][k]) == pytest.approx(load[k], abs=1e-6 * load.max())


# What is refused ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("part", "said"),
    [
        (Beam("b", 1.0, 0, section(1.0, 1.0)), "its number of elements must be a whole number of at least 1, not 0"),
        (Beam("b", -1.0, 2, section(1.0, 1.0)), "beam b: its length is -1, it must be finite and positive"),
        (Beam("b", 1.0, 2, section(0.0, 1.0)), "beam b: its axial stiffness is 0"),
        (Beam("b", 1.0, 2, section(1.0, 1.0, -2.0)), "beam b: its line mass is -2, .* not negative"),
        (ElasticRope("r", 1.0, 2, float("inf"), 1.0), "rope r: its axial stiffness is inf"),
    ],
)
def test_impossible_flexible_parts_are_refused(part: Callable[[], object], said: str) -> None:
    with pytest.raises(sc.InvalidModel, match=said):
        Assembly((part,), sc.Parameters(), gravity=(0, 0, 0))  # type: ignore[arg-type]  # wrong on purpose


def test_a_node_that_is_not_there_is_refused() -> None:
    parts = Assembly((ElasticRope("r", 1.0, 2, 1.0, 1.0),), sc.Parameters(), gravity=(0, 0, 0))
    with pytest.raises(sc.InvalidModel, match="r has no node 3"):
        parts.node("r", 3)
