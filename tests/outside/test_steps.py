"""Models that jump, by `floor`, `sign`, `fmod` or `if_else`: where no motion follows, the path is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy.integrate
from outside.writing import coordinates, lagrange, square
from thinned import thinned

import servocore as sc

ALONG = sc.rest_to_rest((0.0,), (1.0,), 2.0)
HOW: tuple[tuple[Any, ...], ...] = ((), (sc.Projected(), sc.BackwardEuler()), (sc.Original(), sc.BDF(2)))
STEP = 1e-3
"""How far outputs and constraints step: less than the path goes between two instants."""

Of = Callable[[ca.SX], ca.SX]


def car(output: Of = lambda x: x, potential: Of = lambda _: ca.SX(0), mass: Of = lambda _: ca.SX(1)) -> sc.Scene:
    q = coordinates("x")
    x = q.q[0]
    system = lagrange(
        "car", q, mass(x) * square(q.v) / 2, {"X": output(x)}, {"F": x}, potential=potential(x),
        guess=lambda at: (at[0],), home=(0.1,),
    )  # fmt: skip
    return sc.Scene("car", {"only": lambda: system}, ALONG)


def cars(
    force: Callable[[ca.SX, ca.SX], ca.SX | float] = lambda *_: 0.0,
    constraint: Callable[[ca.SX, ca.SX], ca.SX] | None = None,
) -> sc.Scene:
    """Two cars: the second follows the path, on a spring or by a gear from the first, with a force on it."""
    q = coordinates("x y")
    x, y = ca.vertsplit(q.q)
    others = {"constraints": constraint(x, y)} if constraint else {"potential": 50 * (x - y) ** 2}
    system = lagrange(
        "cars", q, square(q.v) / 2, {"Y": y}, {"F": x}, guess=lambda at: (at[0], at[0]), home=(0.1,), **others
    )
    system = replace(system, force=system.force + ca.vertcat(0, force(x, y)))
    return sc.Scene("cars", {"only": lambda: system}, ALONG)


def within(place: ca.SX, begin: float, end: float) -> ca.SX:
    return ca.if_else(place > begin, ca.if_else(place < end, 1, 0), 0)


GAP, JUMPS, STRIKES = r"no motion is found that follows the path", r"would have to jump", r"which is an impulse"
REFUSED: dict[str, tuple[Callable[[], sc.Scene], str]] = {
    "an output with a gap": (lambda: car(lambda x: x + STEP * ca.sign(x - 0.5)), rf"from t = 0\.99\d+ s to .*{GAP}"),
    "a gap on one side": (lambda: car(lambda x: ca.if_else(x < 0.37, x, x + STEP)), rf"from t = 0\.8927\d+ s.*{GAP}"),
    "an output that falls back": (lambda: car(lambda x: x - STEP * ca.sign(x - 0.5)), rf"at t = 1 s x {JUMPS}"),
    "an output with floor": (lambda: car(lambda x: x + 0.1 * ca.floor(4 * x)), "out of reach"),
    "an output with fmod": (lambda: car(lambda x: x + STEP * ca.fmod(x, 0.3)), rf"at t = 0\.831[2-5]\d+ s x {JUMPS}"),
    "a gear that slips by its output": (
        lambda: cars(constraint=lambda x, y: x - y - STEP * ca.sign(y - 0.37)), rf"at t = 0\.8927\d+ s x {JUMPS}"),
    "a gear that slips by its drive": (
        lambda: cars(constraint=lambda x, y: x - y + STEP * ca.sign(x - 0.37)), rf"from t = 0\.89\d+ s.*{GAP}"),
    "a force that jumps where the drive is": (
        lambda: cars(lambda x, _: 0.1 * ca.sign(x - 0.37)), rf"from t = 0\.88\d+ s.*{GAP}"),
    "a force between two places close together": (
        lambda: cars(lambda _, y: 0.1 * within(y, 0.37, 0.3702)), rf"at t = 0\.8927\d+ s x {JUMPS}"),
    "a potential with a step": (
        lambda: car(potential=lambda x: 5 * ca.if_else(x < 0.4, 0, 1)),
        rf"at t = 0\.917999\d* s the potential jumps from 0 to 5 J, {STRIKES}"),
    "a mass with a step": (
        lambda: car(mass=lambda x: ca.if_else(x > 0.4, 2, 1)),
        rf"at t = 0\.917999\d* s the mass of x jumps from 1 to 2, {STRIKES}"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("how", "steps"),
    thinned(
        [(HOW[0], 20), (HOW[0], 400), (HOW[1], 20), (HOW[2], 400)], lambda case: case in ((HOW[0], 20), (HOW[2], 400))
    ),
    ids=str,
)
@pytest.mark.parametrize("kind", REFUSED)
def test_a_step_that_no_motion_takes_is_refused_with_the_time(kind: str, how: tuple[Any, ...], steps: int) -> None:
    make, words = REFUSED[kind]
    with pytest.raises(sc.ServocoreError, match=words):
        sc.solve(make(), *how, step=2.0 / steps)


@pytest.mark.parametrize("kind", REFUSED)
def test_what_prepares_inputs_refuses_it_as_well(kind: str) -> None:
    make, words = REFUSED[kind]
    with pytest.raises(sc.ServocoreError, match=words):
        sc.ExactInversion(make())(0.5)


@pytest.mark.parametrize("kind", ["a potential with a step", "a mass with a step"])
def test_a_simulation_does_not_pass_it_either(kind: str) -> None:
    make, words = REFUSED[kind]
    scene, without = make(), car()
    pushed = sc.solve(without, step=0.01)
    with pytest.raises(sc.IntegrationFailed, match=words.split(" the ", 1)[1]):
        sc.simulate(scene, pushed)
    short = pushed.t[pushed["x"] < 0.3]
    assert sc.simulate(scene, pushed, t=short)["x"] == pytest.approx(pushed["x"][: len(short)], abs=1e-7)


HARMLESS: dict[str, Callable[[], sc.Scene]] = {
    "a step beyond the path": lambda: car(lambda x: x + STEP * ca.sign(x - 1.5) + STEP),
    "a potential with a kink, no step": lambda: car(potential=lambda x: 5 * ca.fabs(x - 0.4)),
    "branches that meet with all derivatives": lambda: car(lambda x: ca.if_else(x < 0.5, 2 * x, x + x) / 2),
    "friction of one direction on the other car": lambda: cars(lambda _, y: -0.3 * ca.sign(y + 1)),
}


@pytest.mark.parametrize("how", HOW, ids=str)
@pytest.mark.parametrize("kind", HARMLESS)
def test_a_step_that_is_not_met_is_solved(kind: str, how: tuple[Any, ...]) -> None:
    largest = sc.solve(HARMLESS[kind](), *how, step=0.005).error.largest
    assert largest is not None
    assert largest < 0.05


def cart(friction: Of) -> sc.Scene:
    """A mass on a spring slides on a cart that follows the path."""
    q = coordinates("x s")
    (x, s), (x_dot, s_dot) = ca.vertsplit(q.q), ca.vertsplit(q.v)
    system = lagrange(
        "cart", q, (2 * x_dot**2 + (x_dot + s_dot) ** 2) / 2, {"X": x}, {"F": x}, potential=15 * s**2,
        guess=lambda at: (at[0], 0.0), home=(0.1,),
    )  # fmt: skip
    system = replace(system, force=ca.vertcat(0, -friction(s_dot)))
    return sc.Scene("cart", {"only": lambda: system}, ALONG)


@pytest.mark.parametrize("how", HOW, ids=str)
def test_dry_friction_within_internal_dynamics_is_refused_where_it_sticks(how: tuple[Any, ...]) -> None:
    """It was left out: a Jacobian that is constant was taken for equations that are linear, with sign(0) = 0."""
    with pytest.raises(sc.IntegrationFailed, match=r"use a smooth form such as tanh\(v/e\) for sign\(v\)"):
        sc.solve(cart(lambda speed: 0.5 * ca.sign(speed)), *how, step=0.005)


def test_a_smooth_form_of_it_moves_as_another_integrator_says() -> None:
    def rate(t: float, y: np.ndarray) -> list[float]:
        return [y[1], -float(ALONG.jet(t, 2)[2, 0]) - 30 * y[0] - 0.5 * float(np.tanh(y[1] / 0.02))]

    found = sc.solve(cart(lambda speed: 0.5 * ca.tanh(speed / 0.02)), step=0.005)
    exact = scipy.integrate.solve_ivp(rate, (0, 2), [0, 0], method="DOP853", t_eval=found.t, rtol=1e-10, atol=1e-12)
    assert found["s"] == pytest.approx(exact.y[0], abs=1e-5)


def test_dry_friction_that_slips_in_one_direction_is_solved() -> None:
    """Gravity pulls a mass down a slope on the cart all the time: friction is a constant force."""
    sliding, pushed = cart(lambda speed: ca.sign(speed) - 3.0), cart(lambda _: ca.SX(-2.0))
    start = {"s": -0.05, "s_dot": 0.5}
    short = sc.rest_to_rest((0.0,), (0.01,), 0.2)
    found, same = (sc.solve(scene.with_reference(short), step=0.002, start=start) for scene in (sliding, pushed))
    assert found["s"] == pytest.approx(same["s"], abs=1e-12)
