"""scipy_dae on the same equations, reduced to index one: Radau IIA and BDF."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import casadi as ca
import numpy as np

from benchmarks.ivp.problems import IvpProblem
from servocore.numerics.compiled_calls import Call

Residual = Callable[..., np.ndarray]
Jacobians = Callable[..., tuple[np.ndarray, ...]]

TOLERANCES = (1e-6, 1e-9)


@lru_cache(maxsize=8)
def equations(problem: IvpProblem) -> tuple[Residual, Jacobians, int]:
    """Return F(t, y, y'), its Jacobians by y and y', and the number of multipliers, for y = (q, v, L).

    The constraints are differentiated twice. Multipliers enter as derivatives, lam = L': errors of lam itself are then
    no part of the error test, which keeps steps large.
    """
    system = problem.system
    n, t = len(system.coordinates), system.time if system.time.numel() else ca.SX.sym("t")
    q, v, g, forces = system.q, system.v, system.constraints, system.bias
    if problem.driven is not None:
        g = ca.vertcat(g, system.output - problem.driven(t))
    elif problem.force is not None:
        forces = forces + system.input_matrix.T * problem.force
    m, G = g.numel(), ca.jacobian(g, q)
    a, lam, L, q_rate = (ca.SX.sym(name, size) for name, size in (("a", n), ("lam", m), ("L", m), ("q_rate", n)))
    rate = ca.mtimes(G, v) + ca.jacobian(g, t)
    second = ca.jtimes(rate, q, v) + ca.mtimes(G, a) + ca.jacobian(rate, t)
    F = ca.vertcat(q_rate - v, ca.mtimes(system.mass, a) + forces + ca.mtimes(G.T, lam), second)
    y, yp = ca.vertcat(q, v, L), ca.vertcat(q_rate, a, lam)
    residual = Call(ca.Function("F", [t, y, yp], [ca.densify(F)]))
    jacobians = Call(ca.Function("J", [t, y, yp], [ca.densify(ca.jacobian(F, each)) for each in (y, yp)]))

    def f(time: float, y: np.ndarray, yp: np.ndarray) -> np.ndarray:
        return residual(np.array([time]), y, yp)[0].ravel().copy()

    def jac(time: float, y: np.ndarray, yp: np.ndarray) -> tuple[np.ndarray, ...]:
        return tuple(each.copy() for each in jacobians(np.array([time]), y, yp))

    return f, jac, m


def run(problem: IvpProblem, method: dict[str, object], tolerance: float) -> dict[str, float]:
    """Return the coordinates and rates at the end, by name."""
    from scipy_dae.integrate import solve_dae  # noqa: PLC0415 - only where it is installed

    F, jac, m = equations(problem)
    n = len(problem.system.coordinates)
    y = np.concatenate([problem.start, np.zeros(m)])
    yp = np.concatenate([problem.start[n:], np.zeros(n + m)])
    yp[n:] = np.linalg.solve(jac(0.0, y, yp)[1][n:, n:], -F(0.0, y, yp)[n:])  # linear in accelerations and multipliers
    scale = np.concatenate([np.array(problem.system.coordinates.nominal)] * 2 + [np.ones(m)])
    found = solve_dae(F, (0.0, problem.end), y, yp, jac=jac, rtol=tolerance, atol=tolerance * 1e-2 * scale, **method)
    if not found.success:
        raise RuntimeError(found.message)
    names = list(problem.system.coordinates.names)
    return dict(zip([*names, *(f"{each}_dot" for each in names)], found.y[: 2 * n, -1], strict=True))


METHODS: dict[str, dict[str, object]] = {
    "Radau, 3 stages": {"method": "Radau", "stages": 3},
    "Radau, 5 stages": {"method": "Radau", "stages": 5},
    "BDF": {"method": "BDF"},
}
