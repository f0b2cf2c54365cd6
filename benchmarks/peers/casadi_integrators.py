"""CasADi's own integrators: `idas` (SUNDIALS) and `collocation` (Radau and Gauss-Legendre).

Both ask for x' = f(x, z, t), 0 = g(x, z, t). Derivatives that a form does not give explicitly become algebraic
unknowns w, with x' = w. Jacobians are CasADi's own. `collocation` reports at the ends of its elements: at least one
element for each interval of the output grid. Its systems are solved by KINSOL, which keeps factorisations and takes
half the time of CasADi's `newton` and `fast_newton` here, with the loosest tolerance that costs no accuracy.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import casadi as ca
import numpy as np

from benchmarks.chart.candidate import OUTPUT_INTERVALS, Answer, Array, Candidate, Prepared, Problem
from benchmarks.chart.forms import DERIVATIVE_ARRAY, Form
from benchmarks.peers.base import Effort, available_forms, inside, named, peer_models, reader

NAME, DISTRIBUTION = "casadi", "casadi"

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)
ELEMENTS = (1, 2, 4, 8)  # of collocation for each interval of the output grid
COLLOCATION = (("radau", 1), ("radau", 2), ("radau", 3), ("radau", 4), ("radau", 5), ("radau", 7), ("legendre", 4))


def candidates(problem: Problem, effort: Effort) -> list[Candidate]:
    """List idas and collocation on every form."""
    found = []
    for model in peer_models(problem):
        for form in available_forms(problem, model):
            if form.formulation == "reduced" and form.variant != DERIVATIVE_ARRAY:
                continue  # with derivatives as unknowns of their own this is the derivative array again
            found += [
                Candidate(problem, NAME, model, form.formulation, named("idas", form), f"reltol = {tolerance:g}",
                          partial(prepare, form, "idas", idas_options(form, tolerance)))
                for tolerance in inside(TOLERANCES, effort.smoke)
            ]  # fmt: skip
            for scheme, order in inside(collocations(form), effort.smoke):
                found += [
                    Candidate(problem, NAME, model, form.formulation, named(f"collocation, {scheme} {order}", form),
                              f"{elements * OUTPUT_INTERVALS} elements",
                              partial(prepare, form, "collocation", collocation_options(scheme, order, elements)))
                    for elements in (inside(ELEMENTS, effort.smoke) if order > 1 or differential(form) else (1,))
                ]  # fmt: skip
    return found


def differential(form: Form) -> bool:
    """Whether anything is left to integrate."""
    return bool(form.differential.any())


def collocations(form: Form) -> Sequence[tuple[str, int]]:
    """Return the schemes worth trying: a purely algebraic form needs no order."""
    return COLLOCATION if differential(form) else COLLOCATION[:1]


def idas_options(form: Form, tolerance: float) -> dict[str, object]:
    """Return tolerances; on index three, velocities and inputs cannot be taken out of the test one by one."""
    return {"reltol": tolerance, "abstol": tolerance, "max_num_steps": 20_000,
            "suppress_algebraic": form.formulation == "projected"}  # fmt: skip


def collocation_options(scheme: str, order: int, elements: int) -> dict[str, object]:
    """Return the options of the collocation integrator."""
    return {
        "collocation_scheme": scheme,
        "interpolation_order": order,
        "number_of_finite_elements": elements * OUTPUT_INTERVALS - 1,  # rounded up in every interval of the grid
        "rootfinder": "kinsol",
        "rootfinder_options": {"abstol": 1e-12},
    }


def prepare(form: Form, plugin: str, options: dict[str, object]) -> Prepared:
    """Write the form semi-explicitly and build the integrator."""
    x, z, ode, alg, y, yp = semi_explicit(form)
    t = form.problem.grid()
    dae = {"t": form.t, "x": x, "z": z, "ode": ode, "alg": alg}
    integrator = ca.integrator("peer", plugin, dae, t[0], list(t[1:]), options)
    rebuild = ca.Function("rebuild", [form.t, x, z], [ca.densify(y), ca.densify(yp)]).map(len(t))
    places = np.flatnonzero(form.differential)
    x0 = form.y0[places] if len(places) else np.zeros(1)
    unknown = np.setdiff1d(np.arange(form.size), places)
    z0 = np.concatenate([form.y0[unknown], form.yp0[places]])[: z.numel()] if len(places) else form.y0
    if z.numel() != len(z0):
        z0 = np.concatenate([form.y0[unknown], form.yp0[implicit_rates(form)]])
    inputs, answer = reader(form)

    def run() -> tuple[Array, Array, Array]:
        found = integrator(x0=x0, z0=z0)
        # The first instant has its consistent values, which every solver is given.
        columns = ca.horzcat(x0, found["xf"]), ca.horzcat(z0, found["zf"])
        y_values, yp_values = (np.asarray(each) for each in rebuild(t[None], *columns))
        return y_values, yp_values, inputs(t, y_values, yp_values)

    def read(found: tuple[Array, Array, Array]) -> Answer:
        return answer(t, found[0], found[1])

    return Prepared(run, read)


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
