"""Collocation of a bare `Dae` from given initial values: for equations outside the form of a mechanical system."""

from __future__ import annotations

from collections.abc import Iterable

import casadi as ca
import numpy as np

import servocore as sc
from servocore.dae import Dae
from servocore.errors import IntegrationFailed
from servocore.numerics.compiled_calls import Array
from servocore.numerics.square_systems import compile_solver


def marched(dae: Dae, method: sc.RadauIIA, start: Array, stretches: Iterable[tuple[float, int]]) -> tuple[Array, Array]:
    """Take steps of a `Dae` that depends on time by its unknowns only, and return times (N,) and unknowns (N, n).

    Parameters
    ----------
    dae : Dae
        Without reference and parameters.
    method : RadauIIA
        Its last node is the end of a step: constraints hold there to Newton's tolerance.
    start : ndarray, shape (n,)
        Consistent unknowns [x; z] at t = 0.
    stretches : iterable of (float, int)
        Steps in s, and how many of each.
    """
    step = method.discretize(dae)
    solver = compile_solver("sc_march", step.equations, [step.next_state])
    first = ca.Function("first", [step.start.values, step.start.rates, step.step], [step.first_state])
    read = ca.Function("read", [step.state], [ca.vertcat(step.x, step.z)])
    rates = np.zeros(dae.x.numel())
    state = np.asarray(first(start, rates, 1.0)).ravel()
    t, found = [0.0], [start]
    none = np.zeros(step.reference.numel())
    for h, count in stretches:
        for _ in range(count):
            state, _, residual = solver(np.concatenate([state, none, [h]]))
            state = np.asarray(state).ravel()
            if not (np.isfinite(float(residual)) and np.isfinite(state).all()):
                raise IntegrationFailed(f"{dae.name}: the step from t = {t[-1]:.6g} s of {h:g} s was not solved")
            t.append(t[-1] + h)
            found.append(np.asarray(read(state)).ravel())
    return np.array(t), np.array(found)
