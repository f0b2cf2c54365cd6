"""Evaluated quantities of exported functions: inputs and observables of a system, which may depend on time."""

from __future__ import annotations

from typing import TypeVar

import casadi as ca

from servocore.dae import Dae
from servocore.methods.base import Discretization
from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem
from servocore.problem import Problem
from servocore.stepping.observation import compile_observation

Matrix = TypeVar("Matrix", ca.SX, ca.MX)
"""Symbols of either kind, all of the same."""


def wanted(problem: Problem) -> list[tuple[Quantity, ca.SX]]:
    """List inputs and observables with their expressions."""
    system = problem.system
    return [*zip(system.inputs, ca.vertsplit(system.u), strict=True), *system.observables.items()]


def observation(
    system: MechanicalSystem, dae: Dae, step: Discretization, known: list[tuple[Quantity, ca.SX]], order: int
) -> ca.Function:
    """Compile (state, gamma (m, order + 1), p) -> values of `known`, without constraint violations."""
    read = compile_observation(system, dae, step, known, order)
    arguments = read.sx_in()
    return ca.Function(read.name(), arguments, [read(*arguments)[0]], {"cse": True})


def timed_path(system: MechanicalSystem, path: Matrix, time: Matrix) -> Matrix:
    """Return a path with the time as its last row, if the system depends on time."""
    if not system.time.numel():
        return path
    row = ca.horzcat(time, 1.0, ca.DM.zeros(1, max(path.shape[1] - 2, 0)))[:, : path.shape[1]]
    return ca.vertcat(path, row)
