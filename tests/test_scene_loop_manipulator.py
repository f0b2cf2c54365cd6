"""The manipulator with a loop and a passive joint: stable inversion against SciPy's boundary value solver."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import servocore as sc
from servocore.scenes.loop_manipulator import TIP, angles, loop_manipulator

NAMES = ("F_1", "F_2", "s_1", "s_2", "alpha", "beta", "theta", "bend")


@pytest.mark.parametrize(("tip", "kind"), [(False, "minimum phase"), (True, "non-minimum phase")])
def test_it_is_of_minimum_phase_inside_and_of_non_minimum_phase_at_its_tip(tip: bool, kind: str) -> None:
    scene = loop_manipulator(tip)
    report, p = sc.analyse(scene), scene.parameter_values()
    assert (report.index, report.internal_degrees_of_freedom, report.classification) == (3, 2, kind)
    m, length, y_2 = p["link_3_mass"], p["link_3_length"], p["tracked_distance"]
    inertia, soft = m * length * (length / 3 - y_2 / 2), 1 + y_2 / p["link_2_length"]
    wanted = np.roots([inertia, p["joint_damping"] * soft, p["joint_stiffness"] * soft])
    np.testing.assert_allclose(np.sort_complex(np.array(report.eigenvalues)), np.sort_complex(wanted), rtol=1e-8)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"link_1_length": 2.0, "link_3_mass": 4.0, "joint_stiffness": 90.0},
        {"joint_damping": 0.0, "cart_1_mass": 9.0},
    ],
)
def test_stable_inversion_at_the_tip_meets_the_boundary_value_problem_to_1e_8(changes: dict[str, float]) -> None:
    scene = loop_manipulator(tip=True).with_parameters(**changes)
    solution = sc.solve(scene)
    assert "StableInversion" in solution.advice
    exact = scene.exact(solution.t)
    for name in NAMES:
        np.testing.assert_allclose(solution[name], exact[name], rtol=0.0, atol=1e-8 * np.abs(exact[name]).max())


def test_radau_of_order_five_meets_the_independent_solution_where_it_is_of_minimum_phase() -> None:
    scene = loop_manipulator()
    solution = sc.solve(scene, sc.Reduced(), sc.RadauIIA(3), step=scene.reference.duration / 400)
    exact = scene.exact(solution.t)
    for name in NAMES:
        np.testing.assert_allclose(solution[name], exact[name], rtol=0.0, atol=1e-9 * np.abs(exact[name]).max())


@pytest.mark.parametrize("tip", [False, True])
def test_the_independent_solution_keeps_the_equations_of_motion_of_the_model(tip: bool) -> None:
    scene, system = loop_manipulator(tip), angles()
    t = np.linspace(0.0, 2.0, 3001)
    exact = scene.exact(t)
    spline = make_interp_spline(t, np.column_stack([exact[name] for name in system.coordinates.names]), k=7)
    at = t[300:-300:300]
    acceleration, lam = ca.SX.sym("a", 5), system.lam
    symbols = [system.q, system.v, acceleration, lam, system.u, system.p]
    balance = ca.Function(
        "balance",
        symbols,
        [
            system.momentum_balance(acceleration),
            ca.jacobian(system.momentum_balance(acceleration), lam),
            system.constraints,
        ],
    )
    for k, now in enumerate(at):
        u = [exact["F_1"][300 * (k + 1)], exact["F_2"][300 * (k + 1)]]
        parts = balance(
            spline(now), spline(now, 1), spline(now, 2), np.zeros(2), u, system.parameters.values(scene.parameters)
        )
        left, rows, loop = (np.asarray(each) for each in parts)
        _, residual, *_ = np.linalg.lstsq(rows, -left[:, 0])
        assert np.sqrt(residual[0]) < 1e-4
        assert np.abs(loop).max() < 1e-12


def test_paths_out_of_reach_and_the_centre_of_percussion_are_refused() -> None:
    scene = loop_manipulator()
    with pytest.raises(sc.InvalidReference, match="stand across the rail"):
        sc.solve(scene.with_reference(sc.rest_to_rest((3.0, 1.4), (4.0, 3.2), 2.0)))
    with pytest.raises(sc.ServocoreError, match="does not feel the acceleration"):
        sc.solve(scene.with_parameters(tracked_distance=TIP * 2 / 3 + 1e-6))
