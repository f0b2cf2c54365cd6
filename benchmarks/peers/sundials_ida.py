"""scikit-SUNDAE: IDA of SUNDIALS, BDF of variable order and step.

As documented: residual and analytic Jacobian, a dense linear solver for systems of this size, `algebraic_idx` for
what is not differentiated. On the projected form (index 3) the local error of velocities, multipliers and inputs does
not fall with the step, so IDA is used as its users' guide advises for index above one: these are taken out of the
error test, and the largest step is limited. The plain setting, all unknowns in the error test, is run beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from benchmarks.chart.candidate import Answer, Array, Candidate, Prepared, Problem
from benchmarks.chart.forms import Form
from benchmarks.peers.base import (
    Effort,
    available_forms,
    inside,
    jacobian_functions,
    named,
    peer_models,
    reader,
    residual_function,
)

NAME, DISTRIBUTION = "scikit-sundae", "scikit-sundae"

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
LARGEST_STEPS = (200, 400, 800, 1600, 3200)  # of the duration
UNTESTED = 1e8  # an absolute tolerance that every error meets


def candidates(problem: Problem, effort: Effort) -> list[Candidate]:
    """List IDA on every form."""
    import sksundae  # noqa: F401, PLC0415

    found = []
    for model in peer_models(problem):
        for form in available_forms(problem, model):
            if form.formulation == "projected":
                settings: Sequence[tuple[str, dict[str, float]]] = [
                    (f"rtol = {1e-4:g}, all unknowns tested", {"rtol": 1e-4}),
                    *(
                        (f"rtol = {rtol:g}, positions tested, step at most duration/{n}",
                         {"rtol": rtol, "steps": n, "level": 0})
                        for rtol, n in zip((1e-6, 1e-7, 1e-8, 1e-9, 1e-10), LARGEST_STEPS, strict=True)
                    ),
                ]  # fmt: skip
            else:
                settings = [(f"rtol = {rtol:g}", {"rtol": rtol}) for rtol in TOLERANCES]
            found += [
                Candidate(
                    problem, NAME, model, form.formulation, named("IDA", form), text, partial(prepare, form, **of)
                )
                for text, of in inside(settings, effort.smoke)
            ]
    return found


def prepare(form: Form, rtol: float, steps: float = 0.0, level: float = 9) -> Prepared:
    """Compile residual and Jacobian, and set IDA up."""
    import sksundae  # noqa: PLC0415

    residual, (_, jacobian) = residual_function(form), jacobian_functions(form)

    def resfn(t: float, y: Array, yp: Array, res: Array) -> None:
        res[:] = residual(t, y, yp)[0][:, 0]

    def jacfn(t: float, y: Array, yp: Array, _: Array, cj: float, jac: Array) -> None:
        jac[:] = jacobian(t, y, yp, cj)[0]

    reference = form.problem.scene.reference
    options = {
        "rtol": rtol,
        "atol": np.where(form.levels > level, UNTESTED, rtol),
        "jacfn": jacfn,
        "linsolver": "dense",
        "max_num_steps": 20_000,
        "algebraic_idx": [int(k) for k in np.flatnonzero(~form.differential)] or None,
    }
    if steps:
        options["max_step"] = reference.duration / steps
    t = form.problem.grid()
    solver = sksundae.ida.IDA(resfn, **options)
    inputs, answer = reader(form)

    def run() -> object:
        found = solver.solve(t, form.y0, form.yp0)
        if not found.success or len(found.t) != len(t):
            raise RuntimeError(found.message)
        return found, inputs(t, found.y.T, found.yp.T)

    return Prepared(run, partial(_read, t, answer), _remark)


def _read(t: Array, answer: Callable[[Array, Array, Array], Answer], found: tuple[Any, Array]) -> Answer:
    return answer(t, found[0].y.T, found[0].yp.T)


def _remark(found: tuple[Any, Array]) -> str:
    return f"{found[0].nfev} residuals, {found[0].njev} Jacobians"
