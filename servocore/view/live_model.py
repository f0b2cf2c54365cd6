"""`LiveModel`: the functions of a page as JavaScript: the exact inversion, the scheme of the paper, and the path."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel, ServocoreError
from servocore.formulations.projected import Projected
from servocore.formulations.reduced import Reduced
from servocore.methods.backward_euler import BackwardEuler
from servocore.methods.base import Discretization, instantaneous
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array, at_instants
from servocore.numerics.components import triangular_blocks
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.profiles import TIME_LAWS, Profile
from servocore.references.rest_to_rest import RestToRest
from servocore.references.timed_path import TimeAugmented
from servocore.solvers.exact_inversion import prepared_motion
from servocore.stepping.observation import compile_observation, limits_order, observed
from servocore.structure.inversion import inversion
from servocore.view.javascript import written

METHOD = BackwardEuler()
"""The method on the projected form: the scheme of the paper."""


@dataclass(frozen=True, eq=False)
class LiveModel:
    """Functions of a page; a path is gamma (rows, orders), column after column, and parameters p.

    Attributes
    ----------
    exact : casadi.Function
        (path, p) -> values of `outputs`, NaN where the guess of the model is not exact.
    outputs : tuple of Quantity
        The quantities that a solution reports.
    orders : int
        How many derivatives of the path are taken, the path itself included.
    source : dict of str to str
        The functions as JavaScript by name: ``exact``, and those of the scheme of the paper.
    steps : mapping
        Sizes that stepping needs to know; empty where the model cannot be projected.
    """

    exact: ca.Function
    outputs: tuple[Quantity, ...]
    orders: int
    source: Mapping[str, str]
    steps: Mapping[str, Any]

    def values(self, problem: Problem, t: Array) -> Array:
        """Return the values of `exact` on the path of a problem, shape (N, outputs)."""
        jets = problem.reference.jet(t, self.orders - 1)
        return at_instants(self.exact, jets=jets, p=problem.p)[0].T


def live_model(problem: Problem) -> LiveModel:
    """Compile the functions of a page.

    Parameters
    ----------
    problem : Problem
        Resolved.

    Raises
    ------
    InvalidModel
        With the reason, if instants cannot be solved independently: internal dynamics, a branch that is followed, or a
        first guess that is not exact.
    """
    expression = _expression(problem)
    system, dae = problem.system, problem.dae(Reduced())
    known, rows = observed(system), problem.array.reference_order + 1
    orders = max(rows, limits_order(system, tuple(limit for limit in problem.limits if limit.of_path)), 3)
    path, p = system.gamma[:, :orders], system.p
    state = expression(path[:, :rows], p)[0]
    values = compile_observation(system, dae, instantaneous(dae), known, orders - 1)(state, path, p)[0]
    exact = ca.Function("exact", [path, p], [ca.densify(values)], {"cse": True})
    source = {"exact": written("exact", [path, p], [values])}
    sizes: dict[str, Any] = {}
    with suppress(ServocoreError):  # a model that cannot be projected has a page without the scheme of the paper
        functions, sizes = _stepping(problem, state, orders)
        source |= functions
    return LiveModel(exact, tuple(quantity for quantity, _ in known), orders, source, sizes)


def _expression(problem: Problem) -> ca.Function:
    """Return (path, parameters) -> all unknowns; raises `InvalidModel` with the reason if no expression gives them."""
    if not problem.flat:
        raise InvalidModel(
            "its inputs depend on internal dynamics, on the past or the future of the path as well as on the instant"
        )
    if problem.follow_branch or not prepared_motion(problem).direct:
        raise InvalidModel("its motion is followed from instant to instant")
    expression = inversion(problem.array).expression
    if expression is None:
        raise InvalidModel("its equations are solved by iteration")
    return expression


def _stepping(problem: Problem, state: ca.SX, orders: int) -> tuple[dict[str, str], dict[str, Any]]:
    """Return the functions of the projected form by backward Euler as JavaScript, and the sizes that stepping needs."""
    system, dae = problem.system, problem.dae(Projected())
    step = METHOD.discretize(dae)
    path, p = system.gamma[:, :orders], system.p
    places = [problem.array.position(unknown.variable, unknown.order) for unknown in dae.unknowns]
    read = compile_observation(system, dae, step, observed(system), orders - 1)
    equations = step.equations
    first = ca.substitute(step.first_state, step.start.rates, ca.SX.zeros(*step.start.rates.shape))
    blocks = _blocks(step)
    sizes = {
        "unknowns": equations.unknowns.numel(),
        "state": step.state.numel(),
        "orders": dae.reference_order + 1,
        "instants": len(step.start.instants),
        "blocks": [{"columns": columns, "linear": linear} for _, columns, linear in blocks],
    }
    functions = {
        "begin": written("begin", [path, p], [state[places]]),
        "first": written("first", [ca.vec(step.start.values), step.step], [first]),
        "guess": written("guess", [equations.givens], [equations.guess, equations.unknown_scale]),
        "next": written("next", [equations.unknowns, equations.givens], [step.next_state]),
        "observe": written("observe", [step.state, path, p], [read(step.state, path, p)[0]]),
    }
    for k, (rows, columns, _) in enumerate(blocks):
        residual = equations.residual[rows]
        jacobian = ca.jacobian(residual, equations.unknowns[columns])
        functions[f"block{k}"] = written("block", [equations.unknowns, equations.givens], [residual, jacobian])
    return functions, sizes


def _blocks(step: Discretization) -> list[tuple[list[int], list[int], bool]]:
    """Return rows, columns and whether they are linear, of the blocks of a step in the order of their solution."""
    residual, unknowns, blocks = step.equations.residual, step.equations.unknowns, []
    for block in triangular_blocks(ca.jacobian_sparsity(residual, unknowns)):
        rows, columns = block.rows.tolist(), block.columns.tolist()
        jacobian = ca.jacobian(residual[rows], unknowns[columns])
        blocks.append((rows, columns, not ca.depends_on(jacobian, unknowns[columns])))
    return blocks


# Paths: a straight line with its time laws as JavaScript, any other as a table of its derivatives ---------------------


def packed(values: Array) -> str:
    """Return numbers as a text: their bytes, least first, in base 64."""
    return b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode()


def path_of(reference: Reference, t: Array, orders: int) -> tuple[dict[str, Any], Mapping[str, str]]:
    """Return the data of a path for a page, and its functions as JavaScript by name.

    Parameters
    ----------
    reference : Reference
        The path.
    t : ndarray, shape (N,)
        Instants of a table.
    orders : int
        How many derivatives, the path itself included.
    """
    path = reference.path if isinstance(reference, TimeAugmented) else reference
    about = {"start_time": path.start_time, "duration": path.duration, "dimension": path.dimension}
    if not isinstance(path, RestToRest):
        return {**about, "kind": "table", "times": packed(t), "jets": packed(path.jet(t, orders - 1))}, {}
    laws = {law.name: law for law in (path.profile, *TIME_LAWS.values())}
    smooth = [law for law in laws.values() if law == path.profile or law.smoothness >= orders - 1]
    functions = {f"law{k}": _law(law, orders - 1) for k, law in enumerate(smooth)}
    described = [{"name": law.name, "shortest": law.shortest_duration} for law in smooth]
    return {**about, "kind": "line", "start": path.start, "end": path.end, "laws": described}, functions


def _law(profile: Profile, order: int) -> str:
    """Return ([elapsed, remaining, duration]) -> s and its derivatives."""
    given = ca.SX.sym("given", 3)
    elapsed, remaining, duration = ca.vertsplit(given)
    whole: Any = duration  # powers of a number are written as those of a symbol
    law = profile.law(elapsed, remaining, profile.numbers(whole, order), order)
    return written("law", [given], [ca.vertcat(ca.SX(0, 1), *law)])
