"""Fekete points and the wheelset: problems of index two and long duration, as their sets publish them, by bare `Dae`s.

Their references are the published values. Every row has the largest error at the end and the largest residual of the
constraints at all steps.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial

import casadi as ca
import numpy as np

import servocore as sc
from benchmarks.ivp.marching import marched
from benchmarks.ivp.problems import fekete, wheelset
from servocore.dae import Dae
from servocore.numerics.compiled_calls import Array, Call

Found = dict[str, float]
TOLERANCES = (1e-6, 1e-9)


@dataclass(frozen=True, eq=False)
class LongProblem:
    """A problem with its published end.

    Attributes
    ----------
    name, title : str
        In files, and on the page.
    dae : Dae
        Of index two.
    start : ndarray
        Consistent unknowns.
    end : float
        In s.
    error : callable
        Unknowns at the end -> largest error.
    own : mapping
        Route and setting -> the run.
    """

    name: str
    title: str
    dae: Dae
    start: Array
    end: float
    error: Callable[[Array], float]
    own: dict[tuple[str, str], Callable[[], Found]]

    def found(self, unknowns: Array) -> Found:
        """Return the error at the end and the constraints of unknowns at all steps, shape (N, n)."""
        n = self.dae.x.numel()
        residuals = ca.Function("h", [self.dae.x, self.dae.z], [self.dae.h])
        h = np.asarray(residuals(unknowns[:, :n].T, unknowns[:, n:].T))
        return {"error": self.error(unknowns[-1]), "constraints": float(np.abs(h).max())}

    def peers(self) -> Iterator[tuple[str, str, Callable[[], Found]]]:
        """Return other solvers, where they are installed."""
        if importlib.util.find_spec("scipy_dae") is not None:
            for tolerance in TOLERANCES:
                yield "scipy_dae, Radau, 3 stages", f"rtol = {tolerance:g}", partial(_scipy_dae, self, tolerance)
        if importlib.util.find_spec("sksundae") is not None:
            for tolerance in TOLERANCES:
                yield "SUNDIALS IDA (scikit-SUNDAE)", f"rtol = {tolerance:g}", partial(_ida, self, tolerance)


@cache
def _implicit(dae: Dae) -> tuple[Call, Call, int]:
    """Return F(y, y') and its Jacobians for y = (x, z) with the multipliers as derivatives, and how many these are.

    Errors of multipliers are then no part of the error test of a solver.
    """
    n, rest = dae.x.numel(), dae.z.numel()
    kept = sum(not each.variable.startswith(("lam", "mu")) for each in dae.unknowns[n:])
    y, yp = ca.SX.sym("y", n + rest), ca.SX.sym("yp", n + rest)
    z = ca.vertcat(y[n : n + kept], yp[n + kept :])
    H, f, h = ca.substitute([dae.H, dae.f, dae.h], [ca.vertcat(dae.x, dae.z)], [ca.vertcat(y[:n], z)])
    F = ca.densify(ca.vertcat(ca.mtimes(H, yp[:n]) - f, h))
    jacobians = [ca.densify(ca.jacobian(F, each)) for each in (y, yp)]
    return Call(ca.Function("F", [y, yp], [F])), Call(ca.Function("J", [y, yp], jacobians)), rest - kept


def _consistent(problem: LongProblem) -> tuple[Array, Array, int]:
    """Return y and y' at the start, and the number of multipliers."""
    F, _, count = _implicit(problem.dae)
    n, y, yp = problem.dae.x.numel(), problem.start.copy(), np.zeros(len(problem.start))
    y[len(y) - count :], yp[len(y) - count :] = 0.0, problem.start[len(y) - count :]
    H = np.asarray(ca.Function("H", [problem.dae.x, problem.dae.z], [problem.dae.H])(y[:n], problem.start[n:]))
    yp[:n] = np.linalg.solve(H, -np.asarray(F(y, yp)[0]).ravel()[:n])
    return y, yp, count


def _scipy_dae(problem: LongProblem, tolerance: float) -> Found:
    from scipy_dae.integrate import solve_dae  # noqa: PLC0415 - only where it is installed

    F, J, count = _implicit(problem.dae)
    y, yp, _ = _consistent(problem)

    def residual(_: float, y: Array, yp: Array) -> Array:
        return np.asarray(F(y, yp)[0]).ravel().copy()

    def jacobian(_: float, y: Array, yp: Array) -> tuple[Array, ...]:
        return tuple(np.array(each) for each in J(y, yp))

    found = solve_dae(
        residual,
        (0.0, problem.end),
        y,
        yp,
        jac=jacobian,
        method="Radau",
        stages=3,
        rtol=tolerance,
        atol=tolerance * 1e-2,
    )
    if not found.success:
        raise RuntimeError(found.message)
    return problem.found(_unknowns(found.y.T, found.yp.T, count))


def _ida(problem: LongProblem, tolerance: float) -> Found:
    import sksundae  # noqa: PLC0415 - only where it is installed

    F, J, count = _implicit(problem.dae)
    y, yp, _ = _consistent(problem)

    def residual(_: float, y: Array, yp: Array, res: Array) -> None:
        res[:] = np.asarray(F(y, yp)[0]).ravel()

    def jacobian(_: float, y: Array, yp: Array, __: Array, cj: float, jac: Array) -> None:
        by_y, by_yp = J(y, yp)
        jac[:] = np.asarray(by_y) + cj * np.asarray(by_yp)

    algebraic = list(range(problem.dae.x.numel(), len(y) - count)) or None
    solver = sksundae.ida.IDA(
        residual, rtol=tolerance, atol=tolerance * 1e-2, jacfn=jacobian, linsolver="dense", max_num_steps=200_000,
        algebraic_idx=algebraic,
    )  # fmt: skip
    found = solver.solve(np.array([0.0, problem.end]), y, yp)
    if not found.success:
        raise RuntimeError(found.message)
    return problem.found(_unknowns(found.y, found.yp, count))


def _unknowns(y: Array, yp: Array, count: int) -> Array:
    return np.hstack([y[:, : y.shape[1] - count], yp[:, y.shape[1] - count :]])


def fekete_points() -> LongProblem:
    """Return twenty particles on the sphere: `simulate`, energy-momentum, and collocation of the index-two form."""
    names = fekete.particles().coordinates.names
    t = np.append(np.linspace(0.0, 100.0, 1001), np.linspace(110.0, fekete.DURATION, 90))

    def simulated(**settings: object) -> Found:
        found = sc.simulate(fekete.scene(), lambda _: np.zeros(1), t=t, start=fekete.at_rest(), **settings)  # type: ignore[arg-type]  # settings by name
        points = np.column_stack([found[name] for name in names]).reshape(len(t), -1, 3)
        lengths = float(np.abs((points**2).sum(axis=2) - 1.0).max())
        return {"error": float(np.abs(points[-1] - fekete.END).max()), "constraints": lengths}

    def collocated(h: float) -> Found:
        stretches = ((h, round(30.0 / h)), (4 * h, round(17.5 / h)), (10.0, 90))
        return problem.found(marched(fekete.stabilized(), sc.RadauIIA(3), fekete.consistent(), stretches)[1])

    own: dict[tuple[str, str], Callable[[], Found]] = {
        ("simulate", f"rtol = {rtol:g}"): partial(simulated, rtol=rtol, atol=1e-3 * rtol) for rtol in (1e-8, 1e-13)
    }
    own["simulate, EnergyMomentum", "step = 0.05 s"] = partial(simulated, method=sc.EnergyMomentum(), step=0.05)
    own |= {("Dae, RadauIIA(3)", f"step = {h:g} s until t = 30 s"): partial(collocated, h) for h in (0.1, 0.05)}
    problem = LongProblem(
        "fekete", "Fekete points", fekete.stabilized(), fekete.consistent(), fekete.DURATION,
        lambda y: float(np.abs(y[:60] - fekete.END.ravel()).max()), own,
    )  # fmt: skip
    return problem


def railway_wheelset() -> LongProblem:
    """Return the wheelset: collocation only, for its creep forces depend on multipliers."""

    def collocated(h: float) -> Found:
        count = round(wheelset.DURATION / h)
        return problem.found(marched(wheelset.wheelset(), sc.RadauIIA(3), wheelset.START, ((h, count),))[1])

    own: dict[tuple[str, str], Callable[[], Found]] = {
        ("Dae, RadauIIA(3)", f"step = {h:g} s"): partial(collocated, h) for h in (2e-3, 1e-3, 5e-4)
    }
    problem = LongProblem(
        "wheelset", "Wheelset", wheelset.wheelset(), wheelset.START, wheelset.DURATION,
        lambda y: float(np.abs(y / wheelset.END - 1.0).max()), own,
    )  # fmt: skip
    return problem


def long_problems() -> tuple[LongProblem, ...]:
    """Return both."""
    return fekete_points(), railway_wheelset()
