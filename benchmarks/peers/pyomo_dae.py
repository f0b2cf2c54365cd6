"""pyomo.dae: collocation over the whole run at once, solved by IPOPT as one square system.

`ContinuousSet`, `DerivativeVar` and ``dae.collocation`` (Radau) as documented. The first guess is the quasi-static
one, the load at rest at every instant: from constant values IPOPT takes wrong branches, or does not converge. The
discretized model goes through pyomo's own ``nl`` file to the IPOPT (with MUMPS) that CasADi brings, with exact first
and second derivatives, because no executable of IPOPT comes from the package index. Only the call of IPOPT is timed:
building, discretizing and writing the model, seconds each, count as preparation. With fewer elements than output
intervals a spline of degree 7 brings the inputs there.
"""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.chart.candidate import Answer, Array, Candidate, Prepared, Problem
from benchmarks.chart.forms import DERIVATIVE_ARRAY, Form, make_form, quasi_static
from benchmarks.chart.translate import apply
from benchmarks.peers.base import Effort, inside, named, reader

NAME, DISTRIBUTION = "pyomo.dae", "pyomo"

UNITS = 1e3
"""Units of the model's time in an element: pyomo.dae rounds instants to six decimals, which costs index 3 dearly."""

POINTS = {200: (1, 3), 100: (5,), 40: (7,)}
"""Points of collocation in each element, by number of elements."""
OPTIONS = {
    "ipopt.tol": 1e-10, "ipopt.constr_viol_tol": 1e-10, "ipopt.max_iter": 200, "ipopt.max_cpu_time": 10.0,
    "ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False,
}  # fmt: skip


def candidates(problem: Problem, effort: Effort) -> list[Candidate]:
    """List collocation of increasing order on the projected form, and the reduced one."""
    import pyomo.dae  # noqa: F401, PLC0415

    model = problem.scene.default_model
    found = []
    for formulation, variant in (("projected", ""), ("reduced", DERIVATIVE_ARRAY)):
        form = make_form(problem, model, formulation, variant, plain_path=True)
        few = effort.smoke or form.problem.scene.closed_form is None  # a setting of the arm takes a minute to build
        for elements, points in [(100, (3,))] if few else POINTS.items():
            found += [
                Candidate(problem, NAME, model, formulation, named(f"collocation, radau {count}", form),
                          f"{elements} elements", partial(prepare, form, count, elements), limit=12.0)
                for count in inside(points if form.differential.any() else (1,), effort.smoke)
            ]  # fmt: skip
    return found


def prepare(form: Form, points: int, elements: int) -> Prepared:
    """Build and discretize the model, and hand it to IPOPT through its file."""
    from pyomo.repn.plugins.nl_writer import NLWriter  # noqa: PLC0415

    m = build(form, points, elements)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.nl"
        with path.open("w") as stream:
            columns = [each.name for each in NLWriter().write(m, stream, linear_presolve=False).variables]
        nlp = ca.NlpBuilder()
        nlp.import_nl(str(path))
    solver = ca.nlpsol("peer", "ipopt", {"x": ca.vertcat(*nlp.x), "f": nlp.f, "g": ca.vertcat(*nlp.g)}, OPTIONS)
    bounds = {"x0": nlp.x_init, "lbx": nlp.x_lb, "ubx": nlp.x_ub, "lbg": nlp.g_lb, "ubg": nlp.g_ub}
    unit = form.problem.scene.reference.duration / (UNITS * elements)
    places = {name: k for k, name in enumerate(columns)}
    grid, (inputs, answer) = form.problem.grid(elements), reader(form, elements)
    instants = list(m.t)[::points]
    y_places, rate_places = (_places(form, instants, places, kind) for kind in ("y", "rate"))

    def run() -> tuple[Array, Array, Array]:
        found = solver(**bounds)
        if not solver.stats()["success"]:
            raise RuntimeError(f"IPOPT: {solver.stats()['return_status']}")
        values = np.append(np.asarray(found["x"]).ravel(), 0.0)
        y = values[y_places]
        y[:, 0] = form.y0
        rates = values[rate_places] / unit
        return y, rates, inputs(grid, y, rates)

    def read(found: tuple[Array, Array, Array]) -> Answer:
        return answer(grid, found[0], found[1])

    return Prepared(run, read)


def _places(form: Form, instants: list[float], places: dict[str, int], kind: str) -> np.ndarray:
    """Return where IPOPT's vector holds each unknown at each instant; its end where it does not."""
    names = {True: {"y": "x", "rate": "dx"}, False: {"y": "z", "rate": "none"}}
    return np.array([
        [places.get(f"{names[bool(form.differential[k])][kind]}[{k},{t}]", -1) for t in instants]
        for k in range(form.size)
    ])  # fmt: skip


def build(form: Form, points: int, elements: int) -> Any:
    """Return the discretized model."""
    import pyomo.dae  # noqa: PLC0415
    import pyomo.environ as pyo  # noqa: PLC0415

    reference = form.problem.scene.reference
    m = pyo.ConcreteModel()
    start, unit = reference.start_time, reference.duration / (UNITS * elements)
    m.t = pyomo.dae.ContinuousSet(bounds=(0.0, UNITS * elements))
    differential = [k for k in range(form.size) if form.differential[k]]
    algebraic = [k for k in range(form.size) if not form.differential[k]]
    m.x, m.z = pyo.Var(differential, m.t), pyo.Var(algebraic, m.t)
    if differential:
        m.dx = pyomo.dae.DerivativeVar(m.x, wrt=m.t, initialize=0.0)
    functions = {"sqrt": pyo.sqrt, "sin": pyo.sin, "cos": pyo.cos}
    rows: dict[float, list[Any]] = {}

    def rule(model: Any, row: int, t: float) -> Any:
        if t == 0.0:
            return pyo.Constraint.Skip
        if t not in rows:
            y = [model.x[k, t] if form.differential[k] else model.z[k, t] for k in range(form.size)]
            rates = [model.dx[k, t] / unit if form.differential[k] else 0.0 for k in range(form.size)]
            rows[t] = apply([form.t, form.y, form.yp], form.residual, [[start + unit * t], y, rates], functions)
        return rows[t][row] == 0.0

    m.equations = pyo.Constraint(range(form.size), m.t, rule=rule)
    for k in differential:
        m.x[k, 0.0].fix(float(form.y0[k]))
    method = pyo.TransformationFactory("dae.collocation")
    method.apply_to(m, wrt=m.t, nfe=elements, ncp=points, scheme="LAGRANGE-RADAU")
    for k in algebraic:
        m.z[k, 0.0].fix(float(form.y0[k]))
    t = start + unit * np.array(list(m.t))
    for k, values in enumerate(quasi_static(form, t)):
        unknowns = m.x if form.differential[k] else m.z
        for instant, value in zip(m.t, values, strict=True):
            if instant > 0.0:
                unknowns[k, instant] = float(value)
    m.objective = pyo.Objective(expr=0.0)
    return m
