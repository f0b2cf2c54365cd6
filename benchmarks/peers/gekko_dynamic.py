"""gekko: dynamic simulation by orthogonal collocation, step after step (IMODE 7), solved by IPOPT.

Equations go to gekko as expressions, common subexpressions as intermediates, and derivatives are automatic; time is a
variable of its own, so that the path is exact at inner nodes. IMODE 4 (all steps at once) and APOPT were tried and take
three to ten times as long. With fewer steps than output intervals a spline of degree 7 brings the inputs there. A solve
includes what `m.solve` does: writing the model's files, the solver's process, and reading the results; gekko's own
`SOLVETIME` is in the message.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks.chart.candidate import Answer, Array, Candidate, Prepared, Problem
from benchmarks.chart.forms import DERIVATIVE_ARRAY, Form, make_form
from benchmarks.chart.translate import apply
from benchmarks.peers.base import Effort, inside, named, reader

NAME, DISTRIBUTION = "gekko", "gekko"

NODES = {200: (3, 4, 5, 6), 100: (5, 6), 40: (5, 6)}
"""Nodes of each step, its ends included, by number of steps."""
SEQUENTIAL, IPOPT = 7, 3
TOLERANCE = 1e-10


def candidates(problem: Problem, effort: Effort) -> list[Candidate]:
    """List collocation of increasing order on the projected form, and the reduced one."""
    import gekko  # noqa: F401, PLC0415

    model = problem.scene.default_model
    found = []
    for formulation, variant in (("projected", ""), ("reduced", DERIVATIVE_ARRAY)):
        form = make_form(problem, model, formulation, variant, plain_path=True)
        for steps, orders in list(NODES.items())[: 1 if effort.smoke else None]:
            found += [
                Candidate(problem, NAME, model, formulation, named(f"IMODE 7, NODES {nodes}", form), f"{steps} steps",
                          partial(prepare, problem, formulation, variant, nodes, steps), limit=40.0)
                for nodes in inside(orders if form.differential.any() else (2,), effort.smoke)
            ]  # fmt: skip
    return found


def prepare(problem: Problem, formulation: str, variant: str, nodes: int, steps: int) -> Prepared:
    """Build the model; every run gets a new one, because a solved one starts from its solution."""
    form = make_form(problem, problem.scene.default_model, formulation, variant, plain_path=True)
    grid, (inputs, answer) = problem.grid(steps), reader(form, steps)
    models: list[tuple[Any, list[Any]]] = []

    def before() -> None:
        models[:] = [build(form, nodes, grid)]

    def run() -> tuple[Array, Array, Array, Any]:
        m, y = models[0]
        m.solve(disp=False)
        found = np.array([[float(value) for value in list(variable.value)] for variable in y])
        rates = np.gradient(found, grid, axis=1)  # no form used here reports inputs as derivatives
        took = m.options.SOLVETIME
        m.cleanup()
        return found, rates, inputs(grid, found, rates), took

    def read(found: tuple[Array, Array, Array, Any]) -> Answer:
        return answer(grid, found[0], found[1])

    before()
    return Prepared(run, read, lambda found: f"SOLVETIME {found[3]:.3g} s", before)


def build(form: Form, nodes: int, grid: Array) -> tuple[Any, list[Any]]:
    """Return a model and its unknowns."""
    from gekko import GEKKO  # noqa: PLC0415

    m = GEKKO(remote=False)
    m.time = grid
    t = m.Var(float(m.time[0]))
    m.Equation(t.dt() == 1)
    y = [m.Var(value=float(value)) for value in form.y0]
    rates = [v.dt() if differential else 0.0 for v, differential in zip(y, form.differential, strict=True)]
    functions = {"sqrt": m.sqrt, "sin": m.sin, "cos": m.cos}
    rows = apply([form.t, form.y, form.yp], form.residual, [[t], y, rates], functions, m.Intermediate)
    m.Equations([row == 0 for row in rows])
    for option, value in {"IMODE": SEQUENTIAL, "NODES": nodes, "SOLVER": IPOPT, "RTOL": TOLERANCE,
                          "OTOL": TOLERANCE, "MAX_ITER": 500, "MAX_TIME": 40}.items():  # fmt: skip
        setattr(m.options, option, value)
    return m, y
