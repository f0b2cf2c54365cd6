"""CasADi's own integrators: `idas` (SUNDIALS) and `collocation` (Radau and Gauss-Legendre).

Both ask for x' = f(x, z, t), 0 = g(x, z, t). Derivatives that a form does not give explicitly become algebraic
unknowns w, with x' = w. Jacobians are CasADi's own, and the integrator is called on arrays in place, without CasADi's
conversions of matrices. `collocation` reports at the ends of its elements; where these are fewer than the intervals of
the output grid, a spline of degree 7 brings the inputs there. Its systems are solved by KINSOL, which keeps
factorizations and takes half the time of CasADi's `newton` and `fast_newton` here, with the loosest tolerance that
costs no accuracy. Machine code takes as long here as the interpreter: KINSOL and the passes between its calls
dominate.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import chdir
from functools import cache, partial
from pathlib import Path
from shlex import quote

import casadi as ca
import numpy as np

from benchmarks.chart.candidate import COARSE, OUTPUT_INTERVALS, Answer, Array, Candidate, Prepared, Problem
from benchmarks.chart.forms import DERIVATIVE_ARRAY, Form
from benchmarks.chart.own import COMPILED
from benchmarks.peers.base import Effort, Lean, available_forms, inside, named, peer_models, reader

NAME, DISTRIBUTION = "casadi", "casadi"

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)
_GCC = quote(str(Path(__file__).with_name("gcc_once.sh")))
COMPILED_OPTIONS = {
    "jit": True, "compiler": "shell", "jit_name": "peer", "jit_temp_suffix": False, "jit_cleanup": False,
    "jit_options": {"compiler": f"sh {_GCC}", "flags": "-O2 -fPIC -ffp-contract=off -fno-math-errno -march=native",
                    "cleanup": False, "verbose": False},
}  # fmt: skip
"""Equations and Jacobian made ready by a compiler, with the flags that ours are; once for all tolerances."""
ELEMENTS = (200, 400, 800)  # of low order
COLLOCATION = {
    ("radau", 1): ELEMENTS, ("radau", 2): ELEMENTS, ("radau", 3): (100, *ELEMENTS), ("radau", 4): (*COARSE, 200, 400),
    ("radau", 5): (*COARSE, 200, 400), ("radau", 7): (*COARSE, 200), ("radau", 9): (*COARSE, 200),
    ("legendre", 4): ELEMENTS,
}  # fmt: skip
"""Numbers of elements, by scheme and order."""


def candidates(problem: Problem, effort: Effort) -> list[Candidate]:
    """List idas and collocation on every form."""
    found = []
    for model in peer_models(problem):
        for form in available_forms(problem, model):
            if form.formulation == "reduced" and form.variant != DERIVATIVE_ARRAY:
                continue  # with derivatives as unknowns of their own this is the derivative array again
            methods: dict[str, dict[str, object]] = {"idas": {}}
            if not effort.smoke:
                methods[f"idas{COMPILED}"] = COMPILED_OPTIONS
            found += [
                Candidate(problem, NAME, model, form.formulation, named(method, form), f"reltol = {tolerance:g}",
                          partial(prepare, form, "idas", {**idas_options(form, tolerance), **more}))
                for method, more in methods.items()
                for tolerance in inside(TOLERANCES, effort.smoke)
            ]  # fmt: skip
            for (scheme, order), elements in inside(list(collocations(form).items()), effort.smoke):
                found += [
                    Candidate(problem, NAME, model, form.formulation, named(f"collocation, {scheme} {order}", form),
                              f"{count} elements",
                              partial(prepare, form, "collocation", collocation_options(scheme, order, count), count))
                    for count in inside(elements, effort.smoke)
                ]  # fmt: skip
            if form.formulation == "projected" and not effort.smoke:
                found += [
                    Candidate(problem, NAME, model, form.formulation, f"collocation, radau {order}{COMPILED}",
                              f"{count} elements",
                              partial(prepare, form, "collocation",
                                      {**collocation_options("radau", order, count), **COMPILED_OPTIONS}, count))
                    for order in (4, 5, 7)
                    for count in (*COARSE, OUTPUT_INTERVALS)
                ]  # fmt: skip
    return found


def collocations(form: Form) -> dict[tuple[str, int], Sequence[int]]:
    """Return the schemes worth trying: a purely algebraic form needs no order."""
    return dict(COLLOCATION) if form.differential.any() else {("radau", 1): (*COARSE, OUTPUT_INTERVALS)}


def idas_options(form: Form, tolerance: float) -> dict[str, object]:
    """Return tolerances; on index three, velocities and inputs cannot be taken out of the test one by one."""
    return {"reltol": tolerance, "abstol": tolerance, "max_num_steps": 20_000,
            "suppress_algebraic": form.formulation == "projected"}  # fmt: skip


def collocation_options(scheme: str, order: int, elements: int) -> dict[str, object]:
    """Return the options of the collocation integrator."""
    return {
        "collocation_scheme": scheme,
        "interpolation_order": order,
        "number_of_finite_elements": elements - 1,  # rounded up in every interval of the grid
        "rootfinder": "kinsol",
        "rootfinder_options": {"abstol": 1e-12},
    }


def prepare(form: Form, plugin: str, options: dict[str, object], elements: int = OUTPUT_INTERVALS) -> Prepared:
    """Write the form semi-explicitly and build the integrator."""
    x, z, ode, alg, y, yp = semi_explicit(form)
    t = form.problem.grid(min(elements, OUTPUT_INTERVALS))
    dae = {"t": form.t, "x": x, "z": z, "ode": ode, "alg": alg}
    with chdir(workshop().name):
        integrator = ca.integrator("peer", plugin, dae, t[0], list(t[1:]), options)
    integrate = Lean(integrator)
    rebuild = Lean(ca.Function("rebuild", [form.t, x, z], [ca.densify(y), ca.densify(yp)]).map(len(t)))
    final_x, final_z = (integrate.results[integrator.index_out(name)] for name in ("xf", "zf"))
    places = np.flatnonzero(form.differential)
    x0 = form.y0[places] if len(places) else np.zeros(1)
    unknown = np.setdiff1d(np.arange(form.size), places)
    z0 = np.concatenate([form.y0[unknown], form.yp0[places]])[: z.numel()] if len(places) else form.y0
    if z.numel() != len(z0):
        z0 = np.concatenate([form.y0[unknown], form.yp0[implicit_rates(form)]])
    inputs, answer = reader(form, len(t) - 1)

    def run() -> tuple[Array, Array, Array]:
        integrate(x0, z0)
        # The first instant has its consistent values, which every solver is given.
        columns = (np.concatenate([first, rest.ravel(order="F")]) for first, rest in ((x0, final_x), (z0, final_z)))
        y_values, yp_values = rebuild(t, *columns)
        return y_values, yp_values, inputs(t, y_values, yp_values)

    def read(found: tuple[Array, Array, Array]) -> Answer:
        return answer(t, found[0], found[1])

    return Prepared(run, read)


@cache
def workshop() -> tempfile.TemporaryDirectory[str]:
    """Return the folder of a compiler's files, which go when the process ends."""
    return tempfile.TemporaryDirectory(prefix="idas-")


def implicit_rates(form: Form) -> list[int]:
    """Places of the differential unknowns whose derivative no equation gives explicitly."""
    explicit = explicit_rows(form)
    return [int(k) for k in np.flatnonzero(form.differential) if int(k) not in explicit]


def explicit_rows(form: Form) -> dict[int, int]:
    """Return, by unknown, the equation that holds its derivative alone, with a constant factor."""
    by_rates = form.jacobians[1]
    rows, columns = (np.array(each) for each in by_rates.sparsity().get_triplet())
    found = {}
    for row, column in zip(rows, columns, strict=True):
        alone = (rows == row).sum() == 1 and (columns == column).sum() == 1
        if alone and by_rates[int(row), int(column)].is_constant():
            found[int(column)] = int(row)
    return found


def semi_explicit(form: Form) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
    """Return x, z, f, g of the semi-explicit form, and y, y' as expressions of t, x, z."""
    explicit, implicit = explicit_rows(form), implicit_rates(form)
    places = [int(k) for k in np.flatnonzero(form.differential)]
    algebraic = [k for k in range(form.size) if k not in places]
    w = ca.SX.sym("w", len(implicit))
    rates = ca.SX.zeros(form.size)
    rates[implicit] = w
    for k, row in explicit.items():
        factor = form.jacobians[1][row, k]
        rates[k] = -ca.substitute(form.residual[row], form.yp[k], 0) / factor
    kept = [row for row in range(form.size) if row not in explicit.values()]
    alg = ca.substitute(form.residual[kept], form.yp, rates)
    if not places:  # an integrator wants a state
        clock = ca.SX.sym("clock")
        return clock, form.y, ca.SX(1), alg, form.y, rates
    return form.y[places], ca.vertcat(form.y[algebraic], w), rates[places], alg, form.y, rates
