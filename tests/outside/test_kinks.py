"""Models with kinks and jumps: where inputs would have to strike, no instant shows it, and the path is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from outside.writing import coordinates, g, lagrange, square

import servocore as sc

STIFFNESS, MASS = 100.0, 1.0
ALONG = sc.rest_to_rest((0.0,), (1.0,), 2.0)


@cache
def two_cars(energy: Callable[[ca.SX], ca.SX], friction: Callable[[ca.SX], ca.SX], swinging: bool) -> sc.Scene:
    """Cars on a spring: one is pushed, the other follows the path; on the pushed one a mass may swing."""
    q = coordinates("x y s" if swinging else "x y")
    x, y, *others = ca.vertsplit(q.q)
    x_dot, y_dot, *rates = ca.vertsplit(q.v)
    kinetic = (2 * x_dot**2 + MASS * y_dot**2) / 2 + sum((x_dot + rate) ** 2 / 4 for rate in rates)
    system = lagrange(
        "two cars", q, kinetic, {"Y": y}, {"F": x}, potential=energy(x - y - 1.0) + sum(30 * s**2 for s in others),
        damping=sum((rate**2 / 2 for rate in rates), ca.SX(0)),
        guess=lambda at: (at[0] + 1.0, at[0], *(0.0 for _ in others)), home=(0.1,),
    )  # fmt: skip
    force = ca.vertcat(*(system.force[k] - (friction(y_dot) if k == 1 else 0) for k in range(len(q))))
    return sc.Scene("two_cars", {"only": lambda: replace(system, force=force)}, ALONG)


def none(_: ca.SX) -> ca.SX:
    return ca.SX(0)


def two_stiffnesses(stretch: ca.SX) -> ca.SX:
    return ca.if_else(stretch > 0, STIFFNESS, 3 * STIFFNESS) * stretch**2 / 2


def stop(stretch: ca.SX) -> ca.SX:
    return STIFFNESS * stretch**2 / 2 + 2000 * ca.fmax(0, stretch - 0.02) ** 2


def hardening(stretch: ca.SX) -> ca.SX:
    return STIFFNESS * stretch**2 / 2 + 200 * ca.fmax(0, stretch) ** 3


def linear(stretch: ca.SX) -> ca.SX:
    return STIFFNESS * stretch**2 / 2


def dry(speed: ca.SX) -> ca.SX:
    return 2 * ca.sign(speed)


def bead_on_a_rail(corner: bool, moved: bool = False) -> sc.Scene:
    """A bead is pushed along x on a rail with a corner in space, or one that turns back at t = 1 s."""
    q, t = coordinates("x z"), ca.SX.sym("t")
    x, z = ca.vertsplit(q.q)
    rail = ca.fabs(x - 0.5) if corner else x * ca.fabs(t - 1) if moved else (x - 0.5) ** 2
    system = lagrange(
        "bead", q, square(q.v) / 2, {"X": x}, {"F": x}, potential=g * z, constraints=z - rail,
        guess=lambda at: (at[0], 0.0), home=(0.1,), **({"time": t} if moved else {}),
    )  # fmt: skip
    return sc.Scene("bead", {"only": lambda: system}, ALONG)


STRIKES: dict[str, tuple[Callable[[], sc.Scene], str]] = {
    "two stiffnesses": (lambda: two_cars(two_stiffnesses, none, False), r"at t = 1 s the velocity of x would have to"),
    "a mass that swings beside": (lambda: two_cars(two_stiffnesses, none, True), r"at t = 1 s the velocity of x would"),
    "a stop": (lambda: two_cars(stop, none, False), r"at t = 0\.48258\d* s the velocity of x would have to jump"),
    "dry friction": (lambda: two_cars(linear, dry, False), r"at t = 0 s x would have to jump from 1 to 1\.02 m"),
    "a corner": (lambda: bead_on_a_rail(True), r"at t = 1 s the velocity of z would have to jump from -1\.23 to 1\.23"),
    "a support that turns back": (lambda: bead_on_a_rail(False, True), r"at t = 1 s the velocity of z would have to"),
}
HOW: tuple[tuple[Any, ...], ...] = (
    (), (sc.Projected(), sc.BackwardEuler()), (sc.Projected(), sc.RadauIIA(2)), (sc.Original(), sc.BDF(2)),
)  # fmt: skip


@pytest.mark.parametrize("steps", [37, 400])
@pytest.mark.parametrize("how", HOW, ids=str)
@pytest.mark.parametrize("kind", STRIKES)
def test_a_motion_that_jumps_between_two_instants_is_refused_with_the_time(
    kind: str, how: tuple[Any, ...], steps: int
) -> None:
    make, words = STRIKES[kind]
    with pytest.raises(sc.IntegrationFailed, match=words):
        sc.solve(make(), *how, step=2.0 / steps)


def test_the_velocity_jumps_as_the_spring_says() -> None:
    """x = y + 1 + m y''/k: its velocity jumps by m y''' (1/k - 1/(3 k)) where the spring passes its rest."""
    third = float(ALONG.jet(1.0, 3)[3, 0])
    with pytest.raises(sc.IntegrationFailed) as caught:
        sc.solve(two_cars(two_stiffnesses, none, False))
    before, after = (float(part) for part in str(caught.value).split(" jump from ")[1].split(" m/s")[0].split(" to "))
    speed = float(ALONG.jet(1.0, 1)[1, 0])
    assert before == pytest.approx(speed + MASS * third / STIFFNESS, abs=1e-3)
    assert after == pytest.approx(speed + MASS * third / (3 * STIFFNESS), abs=1e-3)


@pytest.mark.parametrize("kind", [kind for kind in STRIKES if kind != "a mass that swings beside"])
def test_what_prepares_inputs_refuses_it_as_well(kind: str) -> None:
    make, words = STRIKES[kind]
    with pytest.raises(sc.IntegrationFailed, match=words):
        sc.ExactInversion(make())(0.5)


@pytest.mark.parametrize("how", HOW, ids=str)
@pytest.mark.parametrize(
    "make", [lambda: two_cars(hardening, none, False), lambda: bead_on_a_rail(False)], ids=["hardening", "smooth rail"]
)
def test_what_jumps_in_inputs_alone_is_solved(make: Callable[[], sc.Scene], how: tuple[Any, ...]) -> None:
    assert sc.solve(make(), *how, step=0.005).error.largest is not None


def test_inputs_that_jump_with_friction_of_the_driven_body_are_right() -> None:
    q = coordinates("x")
    system = lagrange("car", q, q.v[0] ** 2, {"X": q.q[0]}, {"F": q.q[0]}, guess=lambda at: (at[0],), home=(0.1,))
    system = replace(system, force=-5 * ca.sign(q.v))
    path = sc.through([(0.0,), (1.0,), (0.0,)], duration=3.0)
    found = sc.solve(sc.Scene("car", {"only": lambda: system}, path), step=0.01)
    jet = path.jet(found.t, 2)[:, :, 0]
    away = np.abs(jet[:, 1]) > 1e-9
    assert found["F"][away] == pytest.approx(2 * jet[away, 2] + 5 * np.sign(jet[away, 1]), abs=1e-9)


@pytest.mark.parametrize("how", HOW, ids=str)
def test_a_table_without_derivatives_is_refused_and_a_smooth_one_solved(how: tuple[Any, ...]) -> None:
    """A measured force on the car that follows its path: the inputs hold its second derivative."""
    places = np.linspace(-1.0, 2.0, 13)

    def scene(kind: str) -> sc.Scene:
        table = ca.interpolant("table", kind, [places.tolist()], np.sin(places))
        q = coordinates("x y")
        x, y = ca.vertsplit(q.q)
        system = lagrange(
            "cars", q, square(q.v) / 2, {"Y": y}, {"F": x}, potential=50 * (x - y) ** 2,
            guess=lambda at: (at[0], at[0]), home=(0.1,),
        )  # fmt: skip
        system = replace(system, force=ca.vertcat(0, table(y)))
        return sc.Scene("cars", {"only": lambda: system}, ALONG)

    with pytest.raises(sc.InvalidModel, match="such as a table with linear interpolation"):
        sc.solve(scene("linear"), *how, step=0.005)
    assert sc.solve(scene("bspline"), *how, step=0.005).error.largest is not None
