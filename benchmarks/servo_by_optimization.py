"""Servo constraints by optimization (Altmann and Heiland 2017) beside exact inversion, on their overhead crane.

.venv/bin/python -m benchmarks.servo_by_optimization        (a minute)

Their manoeuvre: load from (0, 4) m to (1, 5) m below the girder in 6 s by the polynomial of degree 13, 601 instants,
weights beta of the inputs 1e-5 to 1e-7; masses, inertia and radius are those of the scene. The optimal control problem

    min  sum over instants of h (|y - y*|^2 + beta |u - u_0|^2)/2    so that implicit Euler holds,

u_0 the inputs at rest, is solved here with all nonlinearities by IPOPT; they solve it linearized along a trajectory.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.stepping.forward_dynamics import forward_rate

STEPS, WEIGHTS = 600, (1e-5, 1e-6, 1e-7, 1e-9)
CRANE = sc.scenes.overhead_crane().with_reference(sc.rest_to_rest((0.0, -4.0), (1.0, -5.0), 6.0, sc.DEGREE13))


@dataclass(frozen=True)
class Result:
    """Largest errors of the inputs F and M_w as fractions of their peaks, stray of the load (m), processor time (s)."""

    inputs: tuple[float, float]
    stray: float
    seconds: float


def judged(t: Array, inputs: Array, seconds: float) -> Result:
    """Compare inputs (N, 2) with the closed form, and simulate the crane under them."""
    exact = CRANE.exact(t)
    names = ("F", "M_w")
    peaks = [float(np.abs(exact[name] - exact[name][0]).max()) for name in names]
    errors = [float(np.abs(u - exact[name]).max()) / peak for u, name, peak in zip(inputs.T, names, peaks, strict=True)]
    found = sc.simulate(CRANE, CubicSpline(t, inputs), t=t, start={"s": 0.0, "l": 4.0})
    return Result((errors[0], errors[1]), float(found["tracking_error"].max()), seconds)


def inverted() -> Result:
    """Return exact inversion at the 601 instants, compiled before."""
    sc.solve(CRANE, step=CRANE.reference.duration / STEPS)
    begun = time.process_time()
    solution = sc.solve(CRANE, step=CRANE.reference.duration / STEPS)
    seconds = time.process_time() - begun
    return judged(solution.t, np.column_stack([solution["F"], solution["M_w"]]), seconds)


def optimized(weights: tuple[float, ...] = WEIGHTS, steps: int = STEPS) -> Iterator[tuple[float, Result]]:
    """Solve the optimal control problem for each weight, from the crane at rest."""
    system, h = CRANE.model("generalized"), CRANE.reference.duration / steps
    p, t = system.parameters.values(), np.linspace(0.0, CRANE.reference.duration, steps + 1)
    path, rest = CRANE.reference.jet(t, 0)[:, 0], np.array([0.0, -p[list(system.parameters.names).index("load_mass")]])
    rest[1] *= 9.81 * 0.1
    output = ca.Function("y", [system.q, system.p], [system.output])
    move = forward_rate(system, held=False)
    state, after, u = ca.MX.sym("x", 6), ca.MX.sym("x_1", 6), ca.MX.sym("u", 2)
    defect = ca.Function("defect", [state, after, u], [after - state - h * move(after, u, np.zeros(2), p)[0]])
    x, v, beta = ca.MX.sym("X", 6, steps + 1), ca.MX.sym("U", 2, steps), ca.MX.sym("beta")
    constraints = ca.vertcat(ca.vec(defect.map(steps)(x[:, :-1], x[:, 1:], v)), x[:, 0] - ca.DM([0, 4, 0, 0, 0, 0]))
    away = output.map(steps + 1)(x[:3, :], ca.repmat(ca.DM(p), 1, steps + 1)) - path.T
    cost = h / 2 * (ca.sumsqr(away) + beta * ca.sumsqr(v - ca.repmat(ca.DM(rest), 1, steps)))
    problem = {"x": ca.vertcat(ca.vec(x), ca.vec(v)), "p": beta, "f": cost, "g": constraints}
    solver = ca.nlpsol(
        "optimal", "ipopt", problem, {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10}}
    )
    guess = np.concatenate([np.tile([0.0, 4.0, 0.0, 0.0, 0.0, 0.0], steps + 1), np.tile(rest, steps)])
    for weight in weights:
        begun = time.process_time()
        found = np.asarray(solver(x0=guess, p=weight, lbg=0.0, ubg=0.0)["x"]).ravel()
        seconds = time.process_time() - begun
        inputs = found[6 * (steps + 1) :].reshape(-1, 2)
        yield weight, judged(t, np.vstack([inputs[:1], inputs]), seconds)


def main() -> None:
    """Print the table."""
    print(
        "| route | error of F / change | error of M_w / change | stray, mm | processor time, s |\n|---|---|---|---|---|"
    )
    rows = [("exact inversion", inverted()), *((f"optimal control, beta = {w:g}", found) for w, found in optimized())]
    for name, row in rows:
        errors = " | ".join(f"{error:.1e}" for error in row.inputs)
        print(f"| {name} | {errors} | {1e3 * row.stray:.2g} | {row.seconds:.2g} |", flush=True)


if __name__ == "__main__":
    main()
