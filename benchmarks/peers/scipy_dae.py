"""scipy_dae: Radau IIA of three, five and seven stages and BDF, written in Python after SciPy's solve_ivp.

As documented: `fun(t, y, y')` and `jac(t, y, y')`. The error test cannot be told the index (`var_index` raises
NotImplementedError), so on the projected form unknowns are taken out of it by large absolute tolerances, and the
largest step is limited. `PROJECTED` holds what did best out of two hundred combinations tried on the rotary crane.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.chart.candidate import Answer, Array, Candidate, Prepared, Problem
from benchmarks.chart.forms import DERIVATIVE_ARRAY, Form
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

NAME, DISTRIBUTION = "scipy_dae", "scipy_dae"

TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-12)
UNTESTED = 1e8  # an absolute tolerance that every error meets
PROJECTED = (
    # relative tolerance, highest derivative of positions that is tested, smallest number of steps
    *((rtol, 0, 0) for rtol in (1e-3, 1e-4, 1e-6, 1e-8)),
    *((rtol, 0, steps) for rtol, steps in ((1e-8, 100), (1e-8, 200), (1e-10, 200), (1e-10, 400))),
    *((rtol, 1, steps) for rtol, steps in ((1e-6, 0), (1e-8, 0), (1e-7, 100), (1e-8, 200))),
    *((rtol, 9, 0) for rtol in (1e-3, 1e-4)),
)
TESTED = {0: "positions tested", 1: "positions and velocities tested", 9: "all unknowns tested"}
METHODS: tuple[tuple[str, dict[str, object]], ...] = (
    ("Radau, 3 stages", {"method": "Radau", "stages": 3}),
    ("Radau, 5 stages", {"method": "Radau", "stages": 5}),
    ("Radau, 7 stages", {"method": "Radau", "stages": 7}),
    ("BDF", {"method": "BDF"}),
)


def candidates(problem: Problem, effort: Effort) -> list[Candidate]:
    """List Radau and BDF on every form."""
    import scipy_dae  # noqa: F401, PLC0415

    found = []
    for model in peer_models(problem):
        for form in available_forms(problem, model):
            methods = METHODS if model == problem.scene.default_model else METHODS[1:2]
            for method, options in inside(methods, effort.smoke):
                settings = projected_settings() if form.formulation == "projected" else plain_settings()
                found += [
                    Candidate(problem, NAME, model, form.formulation, named(method, form), text,
                              partial(prepare, form, options, **of))
                    for text, of in inside(settings, effort.smoke)
                ]  # fmt: skip
    return found


def plain_settings() -> list[tuple[str, dict[str, float]]]:
    """Return tolerances alone."""
    return [(f"rtol = {rtol:g}", {"rtol": rtol}) for rtol in TOLERANCES]


def projected_settings() -> list[tuple[str, dict[str, float]]]:
    """Return tolerances, what is tested, and limits of the step."""
    return [
        (
            f"rtol = {rtol:g}, {TESTED[level]}" + (f", step at most duration/{steps}" if steps else ""),
            {"rtol": rtol, "level": level, "steps": steps},
        )
        for rtol, level, steps in PROJECTED
    ]


def prepare(form: Form, method: dict[str, object], rtol: float, steps: float = 0.0, level: float = 9) -> Prepared:
    """Compile residual and Jacobians."""
    from scipy_dae.integrate import solve_dae  # noqa: PLC0415

    residual, (both, _) = residual_function(form), jacobian_functions(form)
    reference, t = form.problem.scene.reference, form.problem.grid()

    def fun(time: float, y: Array, yp: Array) -> Array:
        return residual(time, y, yp)[0][:, 0].copy()

    def jac(time: float, y: Array, yp: Array) -> tuple[Array, Array]:
        by_y, by_yp = both(time, y, yp)
        return by_y.copy(), by_yp.copy()

    options = {"rtol": rtol, "atol": np.where(form.levels > level, UNTESTED, rtol), "jac": jac, **method}
    if steps:
        options |= {"max_step": reference.duration / steps, "first_step": reference.duration / steps}
    elif form.variant == DERIVATIVE_ARRAY and not form.differential.any():
        options["first_step"] = reference.duration / 200  # the automatic choice divides by y', which is arbitrary here
    inputs, answer = reader(form)

    def run() -> object:
        found = solve_dae(fun, (t[0], t[-1]), form.y0, form.yp0, t_eval=t, **options)
        if not found.success or len(found.t) != len(t):
            raise RuntimeError(found.message)
        return found, inputs(t, found.y, found.yp)

    return Prepared(run, partial(_read, t, answer), _remark)


def _read(t: Array, answer: Callable[[Array, Array, Array], Answer], found: tuple[Any, Array]) -> Answer:
    return answer(t, found[0].y, found[0].yp)


def _remark(found: tuple[Any, Array]) -> str:
    return f"{found[0].nfev} residuals, {found[0].njev} Jacobians, {found[0].nlu} factorizations"
