"""The scheme of the paper, compiled for export: projected form (19) or (29), backward Euler (31)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from servocore.export.inverse_functions import observation, timed_path, wanted
from servocore.formulations.projected import Projected
from servocore.methods.backward_euler import BackwardEuler
from servocore.problem import Problem
from servocore.stepping.program import program_of
from servocore.stepping.step_functions import compile_start
from servocore.structure.inversion import inversion

METHOD = BackwardEuler()
"""The method of the projected form."""


@dataclass(frozen=True, eq=False)
class Marching:
    """Steps of constant size; a path is (m, orders), column after column, parameters p.

    Attributes
    ----------
    functions : mapping of str to casadi.Function
        ``march_begin`` (paths at `instants`, h, p, time of the start) -> (state, outputs, residual), and ``march_on``
        (state, path after the step, h, p, time before it) -> (state, outputs, residual).
    orders : int
        Number of derivatives of the path among the arguments, the path itself included.
    instants : tuple of float
        Instants of the path for a start, in steps from the start: the start itself, and earlier ones.
    state_size : int
        Numbers kept from step to step.
    """

    functions: Mapping[str, ca.Function]
    orders: int
    instants: tuple[float, ...]
    state_size: int


def marching(problem: Problem, identifier: str) -> Marching:
    """Compile start and step of the projected form by backward Euler.

    Parameters
    ----------
    problem : Problem
        Resolved.
    identifier : str
        Prefix of names in C.

    Raises
    ------
    InvalidModel
        If the model cannot be projected.
    """
    system, array, form = problem.system, problem.array, Projected()
    program, inverse = program_of(problem, form, METHOD), inversion(problem.array)
    dae, orders, instants = problem.dae(form), program.start_order + 1, program.start_instants
    read = observation(system, dae, program.discretization, wanted(problem), program.start_order)
    m = len(system.outputs)
    past, path = ca.MX.sym("past", m, orders * len(instants)), ca.MX.sym("path", m, orders)
    p, h, time = ca.MX.sym("p", system.p.numel()), ca.MX.sym("h"), ca.MX.sym("time")
    known = [
        timed_path(system, column, time + k * h) for column, k in zip(ca.horzsplit(past, orders), instants, strict=True)
    ]
    start = compile_start(array, inverse.by_search(), dae, program.reduced, program.discretization, program.start_order)
    first, _, residual = start(ca.horzcat(*known), h, p)
    begin = [first, read(first, known[0], p), residual]
    state, then = ca.MX.sym("state", program.state_size), timed_path(system, path, time + h)
    after, _, left = program.step(state, then[:, : program.order + 1], h, p)
    on = [after, read(after, then, p), left]
    functions = {
        "march_begin": ca.Function(f"{identifier}_march_begin", [past, h, p, time], begin),
        "march_on": ca.Function(f"{identifier}_march_on", [state, path, h, p, time], on),
    }
    return Marching(functions, orders, instants, program.state_size)
