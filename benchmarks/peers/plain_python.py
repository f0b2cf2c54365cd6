"""Backward Euler and pointwise Newton written by hand with NumPy and SciPy, without a solver package.

Residual and analytic Jacobian are straight-line Python with common subexpressions, as `sympy.lambdify(..., cse=True)`
gives; unknowns and equations are scaled; Newton starts from the extrapolated solution and stops on its last step; the
linear systems go to LAPACK without SciPy's checks. On the reduced form of a problem without internal dynamics there is
nothing to step: Newton is started from the last instant, on fewer instants too, with a spline of degree 7 through them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import casadi as ca
import numpy as np
from scipy.linalg.lapack import dgesv

from benchmarks.chart.candidate import COARSE, OUTPUT_INTERVALS, Answer, Array, Candidate, Prepared, Problem
from benchmarks.chart.forms import DERIVATIVE_ARRAY, Form
from benchmarks.chart.translate import compiled
from benchmarks.peers.base import Effort, available_forms, inside, named, peer_models, reader

NAME, DISTRIBUTION = "plain NumPy/SciPy", "scipy"

STEPS = (200, 400, 800, 1600, 3200)
NEWTON_TOLERANCE, MOST_ITERATIONS = 1e-9, 20


def candidates(problem: Problem, effort: Effort) -> list[Candidate]:
    """List backward Euler on the projected form, Newton and backward Euler on the reduced one."""
    found = []
    for model in peer_models(problem):
        for form in available_forms(problem, model):
            if form.formulation == "reduced" and form.variant != DERIVATIVE_ARRAY:
                continue
            pointwise = not form.differential.any()
            method = "Newton at every instant" if pointwise else "backward Euler"
            found += [
                Candidate(problem, NAME, model, form.formulation, named(method, form), f"{steps} steps",
                          partial(prepare, form, steps))
                for steps in ((*COARSE, OUTPUT_INTERVALS) if pointwise else inside(STEPS, effort.smoke))
            ]  # fmt: skip
    return found


def prepare(form: Form, steps: int) -> Prepared:
    """Write the step in Python."""
    step = form.problem.scene.reference.duration / steps
    before = ca.SX.sym("before", form.size)
    residual = ca.substitute(form.residual, form.yp, (form.y - before) / step)
    weights = np.where(form.differential.any() & (form.formulation == "projected"), step**-1.0, 1.0) ** form.levels
    jacobian = ca.jacobian(residual, form.y)
    scale = _row_scale(form, jacobian, before, weights)
    arguments = [form.t, form.y, before]
    evaluate = compiled("step", arguments, [residual / scale, jacobian * ca.repmat(ca.DM(weights).T, form.size, 1)
                                            / ca.repmat(scale, 1, form.size)])  # fmt: skip
    t = form.problem.grid(steps)
    division = max(steps // OUTPUT_INTERVALS, 1)
    coarse = t[::division]
    inputs, answer = reader(form, len(coarse) - 1)

    def run() -> tuple[Array, Array, Array]:
        y = integrate(evaluate, t, form.y0, weights)
        yp = np.empty_like(y)
        yp[:, 0] = form.yp0
        yp[:, 1:] = np.diff(y, axis=1) / step
        y, yp = y[:, ::division], yp[:, ::division]
        return y, yp, inputs(coarse, y, yp)

    def read(found: tuple[Array, Array, Array]) -> Answer:
        return answer(coarse, found[0], found[1])

    return Prepared(run, read)


def _row_scale(form: Form, jacobian: ca.SX, before: ca.SX, weights: Array) -> ca.DM:
    """Return the largest entry of every row of the scaled Jacobian at the start."""
    start = form.problem.scene.reference.start_time
    values = ca.Function("j", [form.t, form.y, before], [ca.densify(jacobian)])(start, form.y0, form.y0)
    return ca.DM(np.maximum(np.abs(np.asarray(values) * weights).max(axis=1), 1e-12))


def integrate(evaluate: Callable[..., tuple[list[float], list[float]]], t: Array, y0: Array, weights: Array) -> Array:
    """Step through the instants; raises ArithmeticError where Newton's method does not converge."""
    size = len(y0)
    y = np.empty((size, len(t)))
    y[:, 0] = y0
    before, guess = y0, y0
    for k in range(1, len(t)):
        now = guess.copy()
        for _ in range(MOST_ITERATIONS):
            residual, jacobian = evaluate((t[k],), now.tolist(), before.tolist())
            matrix = np.array(jacobian).reshape((size, size), order="F")
            _, _, correction, info = dgesv(matrix, np.array(residual), overwrite_a=True, overwrite_b=True)
            if info:
                raise ArithmeticError(f"singular matrix at t = {t[k]:g} s")
            now -= correction * weights
            if np.abs(correction).max() < NEWTON_TOLERANCE:
                break
        else:
            raise ArithmeticError(f"Newton's method did not converge at t = {t[k]:g} s")
        y[:, k] = now
        guess = 2 * now - before if k > 1 else now
        before = now
    return y
