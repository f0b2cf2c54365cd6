"""The index-3 problems of the test set for initial value problem solvers, to more digits than were published."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.ivp import REFERENCES, peer  # noqa: E402
from benchmarks.ivp.__main__ import PAGE, own_rows, record, render  # noqa: E402
from benchmarks.ivp.problems import at_the_end, digits, problems  # noqa: E402

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
    assert set(rows) == set(PROBLEMS)
    assert all(any(row.found for row in each) for each in rows.values())


def test_the_script_measures_its_own_routes(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = PROBLEMS["car_axis"]
    monkeypatch.setitem(problem.settings, "simulate, rtol", (1e-6,))
    (row,) = own_rows(problem)
    assert min(digits(row.found, problem.reference()).values()) > 4.0


def test_the_study_needs_nothing_that_its_environment_lacks() -> None:
    code = "import sys; sys.modules['pytest'] = None; import benchmarks.ivp.__main__"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=600)
