"""Problems of the test set for initial value problem solvers, to as many digits as were published or more."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import servocore as sc
from benchmarks.ivp import REFERENCES, peer
from benchmarks.ivp.__main__ import PAGE, own_rows, record, render
from benchmarks.ivp.long import long_problems
from benchmarks.ivp.marching import marched
from benchmarks.ivp.problems import at_the_end, digits, fekete, problems, wheelset

ROOT = Path(__file__).resolve().parents[1]
PROBLEMS = {each.name: each for each in problems()}
FINEST = {"car_axis": ("simulate, rtol", 1e-12), "squeezer": ("simulate, rtol", 1e-12),
          "slider_crank": ("solve, RadauIIA(5), steps", 4000)}  # fmt: skip
PUBLISHED = {"car_axis": 7.0, "squeezer": 5.8, "slider_crank": 3.0}
"""Digits that the published values have, in their worst quantity; see the page."""


@pytest.mark.parametrize("name", PROBLEMS)
def test_every_coordinate_rate_and_multiplier_at_the_end_has_eight_digits(name: str) -> None:
    route, setting = FINEST[name]
    correct = digits(at_the_end(PROBLEMS[name].own[route](setting)), PROBLEMS[name].reference())
    assert set(PROBLEMS[name].system.coordinates.names) <= set(correct)
    assert min(correct.values()) >= 8.0, correct


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_published_values_are_those_of_the_independent_integration(name: str) -> None:
    correct = digits(PROBLEMS[name].published, PROBLEMS[name].reference())
    assert min(correct.values()) >= PUBLISHED[name]
    positions = [correct[each] for each in PROBLEMS[name].system.coordinates.names if each.startswith(("x", "phi"))]
    assert min(positions, default=16.0) > 9.0


@pytest.mark.parametrize("name", PROBLEMS)
def test_what_others_are_given_are_the_equations_of_the_motion(name: str) -> None:
    """At the end of the motion, with its multipliers, the residual that scipy_dae solves vanishes."""
    problem, exact = PROBLEMS[name], json.loads(REFERENCES.read_text())[name]
    q, v, lam = (np.array([float(each) for each in exact[key]]) for key in ("q", "v", "lam"))
    F, jacobians, m = peer.equations(problem)
    n = len(q)
    y, yp = np.concatenate([q, v, np.zeros(m)]), np.concatenate([v, np.zeros(n), lam])
    yp[n : 2 * n] = np.linalg.lstsq(jacobians(problem.end, y, yp)[1][n:, n : 2 * n], -F(problem.end, y, yp)[n:])[0]
    forces = np.abs(jacobians(problem.end, y, yp)[1][n:] @ yp).max()
    assert np.abs(F(problem.end, y, yp)).max() < 1e-8 * forces


def test_the_page_holds_what_was_measured() -> None:
    rows, page = record(), PAGE.read_text()
    machine = page.split("Measured on ")[1].split(".\n")[0]
    assert render(rows, machine) == page
    assert set(rows) == {*PROBLEMS, *(each.name for each in long_problems())}
    assert all(any(row.found for row in each) for each in rows.values())


def test_the_script_measures_its_own_routes(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = PROBLEMS["car_axis"]
    monkeypatch.setitem(problem.settings, "simulate, rtol", (1e-6,))
    (row,) = own_rows(problem)
    assert min(digits(row.found, problem.reference()).values()) > 4.0


def test_the_study_needs_nothing_that_its_environment_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, module in list(sys.modules.items()):  # what may import pytest is imported again
        if Path(getattr(module, "__file__", None) or "").is_relative_to(ROOT / "benchmarks"):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pytest", None)
    importlib.import_module("benchmarks.ivp.__main__")


# Problems of long duration --------------------------------------------------------------------------------------------


def test_the_published_end_of_the_fekete_points_is_an_equilibrium_of_the_equations() -> None:
    """With the multipliers of the set, -4.75 in its sign."""
    dae = fekete.stabilized()
    residual = ca.Function("residual", [dae.x, dae.z], [dae.f, dae.h])
    end = np.concatenate([fekete.END.ravel(), np.zeros(60)])
    for part in residual(end, np.concatenate([np.full(20, 4.75), np.zeros(20)])):
        assert np.abs(np.asarray(part)).max() < 2e-12


def test_two_routes_agree_on_the_fekete_points_and_keep_the_sphere() -> None:
    t, names = np.linspace(0.0, 0.5, 6), fekete.particles().coordinates.names
    found = sc.simulate(fekete.scene(), lambda _: np.zeros(1), t=t, start=fekete.at_rest(), rtol=1e-12, atol=1e-14)
    positions = np.column_stack([found[name] for name in names])
    _, unknowns = marched(fekete.stabilized(), sc.RadauIIA(3), fekete.consistent(), [(0.025, 20)])
    np.testing.assert_allclose(unknowns[::4, :60], positions, atol=1e-8)
    for points in (positions, unknowns[:, :60]):
        assert np.abs((points.reshape(-1, 20, 3) ** 2).sum(axis=2) - 1.0).max() < 1e-13


@pytest.mark.nightly
@pytest.mark.parametrize(("route", "constraints"), [("simulate", 1e-13), ("Dae, RadauIIA(3)", 1e-15)])
def test_the_fekete_points_end_as_published_by_two_routes(route: str, constraints: float) -> None:
    problem, _ = long_problems()
    *_, finest = (run for (name, _), run in problem.own.items() if name == route)
    found = finest()
    assert found["error"] < 1e-8
    assert found["constraints"] < constraints


def test_the_wheelset_starts_with_the_published_accelerations() -> None:
    dae = wheelset.wheelset()
    H, f, h = (np.asarray(each) for each in ca.Function("parts", [dae.x, dae.z], [dae.H, dae.f, dae.h])(
        wheelset.START[:11], wheelset.START[11:]
    ))  # fmt: skip
    published = [-1.975258894011285, -1.0898297102811276e-3, 7.8855083626142589e-2, -5.533362821731549,
                 -0.3487021489546511, -2.132968724380927]  # fmt: skip
    np.testing.assert_allclose(np.linalg.solve(H, f)[5:, 0], published, rtol=1e-12)
    assert np.abs(h).max() < 1e-15


def test_the_wheelset_is_solved_to_the_order_of_the_method() -> None:
    dae = wheelset.wheelset()
    ends = [marched(dae, sc.RadauIIA(3), wheelset.START, [(0.05 / n, n)])[1][-1, :5] for n in (50, 100, 200)]
    coarse, fine = (np.abs(each - ends[2]).max() for each in ends[:2])
    assert coarse > 8 * fine


@pytest.mark.nightly
def test_the_wheelset_ends_within_six_millionths_of_all_published_values_and_mostly_within_one() -> None:
    _, unknowns = marched(wheelset.wheelset(), sc.RadauIIA(5), wheelset.START, [(2e-4, 50_000)])
    errors = np.abs(unknowns[-1] / wheelset.END - 1.0)
    assert errors.max() < 6e-6
    assert (errors < 1e-6).sum() >= 11
