"""The equations that peers get: F(t, y, y') = 0 with numbers for parameters, scaled, with consistent initial values.

Nothing is held back from a peer: coordinates that the servo constraints prescribe are eliminated where that is
possible, unknowns are divided by their peaks over the exact run and equations by their largest derivative, and the
initial values are exact. Three forms:

* ``projected``: equation (29), or (19) on generalized coordinates: index 3 (2 where internal dynamics remain);
* ``reduced``, derivative array: nothing to integrate where there are no internal dynamics, otherwise
  their states are the differential unknowns (index 1);
* ``reduced``, inputs as derivatives: one differentiation less; the inputs, and the multipliers that need as many
  derivatives as they do, are the derivatives of differential unknowns (index 1). Only without internal dynamics.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

import servocore as sc
from benchmarks.chart.candidate import Array, Problem
from benchmarks.chart.paths import path_jet, straight
from servocore import RadauIIA
from servocore.formulations.projected import Projected
from servocore.formulations.reduced import Reduced
from servocore.model.system import MechanicalSystem
from servocore.solvers.runs import run_steps
from servocore.stepping.program import program_of
from servocore.structure.derivative_array import derivative_array
from servocore.structure.inversion import inversion

Key = tuple[str, int]
"""A variable and which of its derivatives: ("q.s", 1)."""

DERIVATIVE_ARRAY, INPUTS_AS_DERIVATIVES = "derivative array", "inputs as derivatives"

_SMALLEST_PEAK = 1e-6  # unknowns that stay below are not scaled


@dataclass(frozen=True, eq=False)
class Form:
    """A DAE ready for a peer, in scaled unknowns.

    Attributes
    ----------
    t, y, yp : casadi.SX
        Symbols of time, unknowns and their derivatives; only those marked `differential` have one.
    residual : casadi.SX
        F(t, y, y'), as many rows as unknowns.
    outputs : casadi.SX
        Inputs of the mechanical system, in their units, an expression of t, y and y'.
    violation : casadi.SX
        Largest violation of servo and holonomic constraints.
    differential : ndarray of bool
        Which unknowns are differentiated.
    levels : ndarray of int
        0 for positions, 1 for velocities, 2 for multipliers and inputs.
    y0, yp0 : ndarray
        Consistent initial values.
    keys, peaks : list of Key, ndarray
        What the unknowns are, and by what they were divided.
    """

    problem: Problem
    model: str
    formulation: str
    variant: str
    t: ca.SX
    y: ca.SX
    yp: ca.SX
    residual: ca.SX
    outputs: ca.SX
    violation: ca.SX
    differential: np.ndarray
    levels: np.ndarray
    y0: Array
    yp0: Array
    keys: list[Key]
    peaks: Array

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.y.numel())

    @cached_property
    def jacobians(self) -> tuple[ca.SX, ca.SX]:
        """dF/dy and dF/dy', sparse."""
        return ca.jacobian(self.residual, self.y), ca.jacobian(self.residual, self.yp)


@dataclass(frozen=True, eq=False)
class _Raw:
    """A form before scaling: unknowns under their keys, with the symbols of y'."""

    keys: list[Key]
    symbols: ca.SX
    rates: ca.SX
    residual: ca.SX
    outputs: ca.SX
    violation: ca.SX


@lru_cache(maxsize=64)
def make_form(problem: Problem, model: str, formulation: str, variant: str = "", plain_path: bool = False) -> Form:
    """Return one of the forms of a problem.

    Parameters
    ----------
    problem, model : Problem, str
        What to solve.
    formulation : str
        ``projected`` or ``reduced``.
    variant : str
        ``derivative array`` or ``inputs as derivatives``, of the reduced form.
    plain_path : bool
        No case distinctions, for solvers whose languages have none.

    Raises
    ------
    ValueError
        If the problem has no such form.
    """
    system = _system(problem, model)
    t = ca.SX.sym("t")
    if formulation == "projected":
        raw = _projected(system)
    elif variant == DERIVATIVE_ARRAY:
        raw = _derivative_array(system)
    else:
        raw = _inputs_as_derivatives(system)
    raw = _with_path(raw, problem, system, t, near_end=not plain_path)
    if formulation == "projected":
        raw = _without_prescribed(raw, problem, system, t, near_end=not plain_path)
        raw = _without_unused_velocities(raw)
    return _scaled(raw, problem, model, formulation, variant, t)


def _system(problem: Problem, model: str) -> MechanicalSystem:
    return sc.Problem.of(problem.scene, model).system


def _rates(keys: list[Key]) -> ca.SX:
    return ca.vertcat(*[ca.SX.sym(f"rate_{name}_{order}") for name, order in keys])


def _violation(system: MechanicalSystem) -> ca.SX:
    return ca.norm_inf(ca.vertcat(system.output - system.gamma[:, 0], system.constraints))


def _projected(system: MechanicalSystem) -> _Raw:
    dae = Projected().dae(system)
    keys = [(each.variable, each.order) for each in dae.unknowns]
    rates = _rates(keys)
    residual = ca.vertcat(ca.mtimes(dae.H, rates[: dae.x.numel()]) - dae.f, dae.h)
    return _Raw(keys, ca.vertcat(dae.x, dae.z), rates, residual, system.u, _violation(system))


def _derivative_array(system: MechanicalSystem) -> _Raw:
    dae = Reduced().dae(system)
    keys = [(each.variable, each.order) for each in dae.unknowns]
    rates = _rates(keys)
    residual = ca.vertcat(rates[: dae.x.numel()] - dae.f, dae.h)
    outputs, violation = (_in_physical(each, system, dae.physical) for each in (system.u, _violation(system)))
    return _Raw(keys, ca.vertcat(dae.x, dae.z), rates, residual, outputs, violation)


def _in_physical(expression: ca.SX, system: MechanicalSystem, physical: dict[str, ca.SX]) -> ca.SX:
    names = ("q", "v", "lam", "u")
    old = ca.vertcat(*[getattr(system, name) for name in names])
    return ca.substitute(expression, old, ca.vertcat(*[physical[name] for name in names]))


def _inputs_as_derivatives(system: MechanicalSystem) -> _Raw:
    """Replace y_j^(d_j) by the derivative of y_j^(d_j - 1), and drop the highest derivative of each equation."""
    array = derivative_array(system)
    if array.states:
        raise ValueError("with internal dynamics the inputs are not derivatives of algebraic unknowns")
    c, d = array.signature.equation_offsets, array.signature.variable_offsets
    keys: list[Key] = []
    old, new = [], []
    for j, name in enumerate(array.names):
        keys += [(name, order) for order in range(max(d[j], 1))] if d[j] else [(name, -1)]
    symbols, rates = ca.vertcat(*[ca.SX.sym(f"{name}_{order}") for name, order in keys]), _rates(keys)
    places = {key: k for k, key in enumerate(keys)}
    for j, order in array.unknowns:
        old.append(array.y[j, order])
        key = (array.names[j], order)
        new.append(symbols[places[key]] if key in places else rates[places[array.names[j], order - 1]])
    kept = [row for row, (i, order) in enumerate(array.rows) if order < max(c[i], 1)]
    n = len(system.coordinates)
    physical = {
        "q": array.y[:n, 0],
        "v": array.y[:n, 1],
        "lam": array.y[n : n + system.lam.numel(), 0],
        "u": array.y[n + system.lam.numel() :, 0],
    }
    expressions = [array.residual[kept], *(_in_physical(e, system, physical) for e in (system.u, _violation(system)))]
    residual, outputs, violation = ca.substitute(expressions, [ca.vertcat(*old)], [ca.vertcat(*new)])
    if residual.numel() != len(keys):
        raise ValueError(f"{residual.numel()} equations for {len(keys)} unknowns")
    return _Raw(keys, symbols, rates, residual, outputs, violation)


def _with_path(raw: _Raw, problem: Problem, system: MechanicalSystem, t: ca.SX, *, near_end: bool) -> _Raw:
    """Put numbers for the parameters, and the path as a function of t."""
    p = system.parameters.values(problem.scene.parameters)
    expressions = [raw.residual, raw.outputs, raw.violation]
    gamma = ca.vec(system.gamma)
    columns = ca.jacobian_sparsity(ca.vertcat(*expressions), gamma).get_col()
    order = max((column // system.gamma.size1() for column in columns), default=0)
    jet = ca.horzcat(*path_jet(straight(problem.scene), t, order, near_end=near_end))
    old = [ca.vec(system.gamma[:, : order + 1]), system.p]
    residual, outputs, violation = ca.substitute(expressions, old, [ca.vec(jet), ca.SX(ca.DM(p))])
    return _Raw(raw.keys, raw.symbols, raw.rates, residual, outputs, violation)


def _without_prescribed(raw: _Raw, problem: Problem, system: MechanicalSystem, t: ca.SX, *, near_end: bool) -> _Raw:
    """Eliminate coordinates that are servo outputs themselves, with their velocities."""
    C = system.C
    if not C.is_constant() or C.nnz() != C.size1() or not np.allclose(np.abs(ca.DM(C).nonzeros()), 1.0):
        return raw
    jet = path_jet(straight(problem.scene), t, 2, near_end=near_end)
    old, new, gone = [], [], set()
    places = {key: k for k, key in enumerate(raw.keys)}
    for row in range(C.size1()):
        name = f"q.{system.coordinates.names[C[row, :].sparsity().get_col()[0]]}"
        for order in (0, 1):
            k = places[name, order]
            old += [raw.symbols[k], raw.rates[k]]
            new += [jet[order][row], jet[order + 1][row]]
            gone.add(k)
    expressions = [ca.simplify(each) for each in ca.substitute(
        [raw.residual, raw.outputs, raw.violation], [ca.vertcat(*old)], [ca.vertcat(*new)])]  # fmt: skip
    kept = [k for k in range(len(raw.keys)) if k not in gone]
    everything = ca.vertcat(raw.symbols[kept], raw.rates[kept])
    by_row = ca.jacobian_sparsity(expressions[0], everything).T.colind()
    rows = [i for i in range(expressions[0].numel()) if by_row[i + 1] > by_row[i]]
    if len(rows) != len(kept):
        raise ValueError(f"{len(rows)} equations for {len(kept)} unknowns")
    return _Raw([raw.keys[k] for k in kept], raw.symbols[kept], raw.rates[kept], expressions[0][rows], *expressions[1:])


def _without_unused_velocities(raw: _Raw) -> _Raw:
    """Drop velocities of massless coordinates, which stand in their own definition only."""
    symbols = ca.vertcat(raw.symbols, raw.rates)
    rows, columns = ca.jacobian_sparsity(raw.residual, symbols).get_triplet()
    size = len(raw.keys)
    places = {key: k for k, key in enumerate(raw.keys)}
    gone_rows, gone = set(), set()
    for (name, order), k in places.items():
        used = [row for row, column in zip(rows, columns, strict=True) if column in (k, size + k)]
        if order == 1 and len(used) == 1 and not ca.depends_on(raw.outputs, raw.symbols[k]):
            defined = [column for row, column in zip(rows, columns, strict=True) if row == used[0]]
            if sorted(defined) == sorted((k, size + places[name, 0])):
                gone_rows.add(used[0])
                gone.add(k)
    kept = [k for k in range(size) if k not in gone]
    kept_rows = [i for i in range(size) if i not in gone_rows]
    return _Raw([raw.keys[k] for k in kept], raw.symbols[kept], raw.rates[kept],
                raw.residual[kept_rows], raw.outputs, raw.violation)  # fmt: skip


def _scaled(raw: _Raw, problem: Problem, model: str, formulation: str, variant: str, t: ca.SX) -> Form:
    """Divide unknowns by their peaks and equations by their largest derivatives along the exact run."""
    exact = exact_unknowns(problem, model)
    values = np.array([_value(exact, key) for key in raw.keys])
    rates = np.array([_value(exact, (name, order + 1)) for name, order in raw.keys])
    peaks = np.abs(values).max(axis=1)
    peaks[peaks < _SMALLEST_PEAK] = 1.0
    k = values.shape[1] // 3  # somewhere in the middle of the motion
    everything = ca.vertcat(raw.symbols, raw.rates)
    derivatives = ca.Function("by", [t, everything], [ca.jacobian(raw.residual, everything)])
    point = np.concatenate([values[:, k], rates[:, k]])
    sizes = np.abs(np.asarray(ca.DM(derivatives(exact["time", 0][k], point)))) * np.tile(peaks, 2)
    y, yp = ca.SX.sym("y", len(peaks)), ca.SX.sym("yp", len(peaks))
    residual, outputs, violation = ca.substitute(
        [raw.residual / ca.DM(np.maximum(sizes.max(axis=1), 1e-12)), raw.outputs, raw.violation],
        [raw.symbols, raw.rates],
        [y * ca.DM(peaks), yp * ca.DM(peaks)],
    )
    return Form(
        problem, model, formulation, variant, t, y, yp, residual, outputs, violation,
        differential=np.isin(np.arange(len(peaks)), ca.jacobian_sparsity(residual, yp).get_col()),
        levels=np.array([order if name.startswith("q.") else order + 2 for name, order in raw.keys]),
        y0=values[:, 0] / peaks,
        yp0=rates[:, 0] / peaks,
        keys=raw.keys,
        peaks=peaks,
    )  # fmt: skip


def quasi_static(form: Form, t: Array) -> Array:
    """Return unknowns (n, N) at the times `t` as if the load rested there: a guess that any user could make."""
    array = derivative_array(_system(form.problem, form.model))
    reference, p = form.problem.scene.reference, array.system.parameters.values(form.problem.scene.parameters)
    jets = np.zeros((len(t), array.reference_order + 1, reference.dimension))
    jets[:, 0] = reference.jet(t, 0)[:, 0]
    guess = inversion(array).guess
    values = np.column_stack([np.asarray(guess(jet.T, p)).ravel() for jet in jets])
    rows = {(array.names[j], order): values[k] for k, (j, order) in enumerate(array.unknowns)}
    return np.array([
        rows[key] / form.peaks[k] if key in rows else np.full(len(t), form.y0[k]) for k, key in enumerate(form.keys)
    ])  # fmt: skip


def _value(exact: dict[Key, Array], key: Key) -> Array:
    """Return a derivative along the run: zero where the equations do not determine it, order -1 by quadrature."""
    t = exact["time", 0]
    if key[1] >= 0:
        return exact.get(key, np.zeros(len(t)))
    values = exact[key[0], 0]
    return np.concatenate([[0.0], np.cumsum(np.diff(t) * (values[1:] + values[:-1]) / 2)])


@lru_cache(maxsize=32)
def exact_unknowns(problem: Problem, model: str) -> dict[Key, Array]:
    """Return all derivatives of all variables over the run, by exact inversion, for scaling and initial values."""
    scene, system, method = problem.scene, _system(problem, model), RadauIIA(5)
    t = problem.grid()
    resolved = sc.Problem.of(scene, model)
    states = run_steps(resolved, program_of(resolved, Reduced(), method), t).states
    dae = Reduced().dae(system)
    found = {(each.variable, each.order): states[k] for k, each in enumerate(dae.unknowns)}
    return {**found, ("time", 0): t}
