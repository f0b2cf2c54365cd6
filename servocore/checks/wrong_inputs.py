"""Runs whose inputs are far from the exact ones though every equation holds.

Near a singular configuration a step may land on a root that satisfies every equation and is wrong all the same: a
bridge that turns the long way round, a winch whose direction cosines cannot follow it. What the equations do not show
is compared with what the path implies.
"""

from __future__ import annotations

import warnings

import numpy as np

from servocore.errors import ServocoreWarning
from servocore.numerics.calls import Array
from servocore.problem import Problem
from servocore.stepping.program import Program

LARGEST_DEVIATION = 0.5
"""Of an input's peak: an input further from the exact one is warned of."""

_UNNOTICED = 1e-3  # of the largest input: what is smaller may be all round-off
_SMALLEST_TURN = 0.01  # rad a step: not worth a word


def warn_of_wrong_inputs(problem: Problem, program: Program, t: Array, values: Array) -> None:
    """Warn if a run of steps gives an input that is off by more than `LARGEST_DEVIATION` of its peak.

    Forms of index two and more err by the step, and every model and path has a largest step of its own. Without
    internal dynamics the exact inputs at any instant are known: they are compared where each input is largest and where
    it changes most, at six instants of a crane's run.
    """
    if program.index <= 1 or problem.follow_branch or not problem.flat:
        return
    inputs = values[:, : len(problem.system.inputs)]
    largest = np.abs(inputs).argmax(axis=0)
    steepest = np.abs(np.diff(inputs, axis=0)).argmax(axis=0) + 1
    instants = np.unique(np.concatenate([largest, steepest]))
    jets = problem.reference.jet(t[instants], program.start_order)
    exact = np.array([_exact_values(program, jet, problem.p)[: inputs.shape[1]] for jet in jets])
    peaks = np.maximum(np.abs(inputs).max(axis=0), np.nan_to_num(np.abs(exact)).max(axis=0))
    off = np.nan_to_num(np.abs(inputs[instants] - exact))
    share = off / np.maximum(peaks, _UNNOTICED * max(float(peaks.max()), 1e-300))
    at, worst = (int(each) for each in np.unravel_index(share.argmax(), share.shape))
    if share[at, worst] > LARGEST_DEVIATION:
        quantity, k = problem.system.inputs[worst], int(instants[at])
        # The first values of a run are exact.
        peak = max(float(np.nan_to_num(np.abs(exact[:, worst])).max()), abs(float(inputs[0, worst])))
        cause = _fastest_turn(program, values, k, LARGEST_DEVIATION * peak / off[at, worst])
        warnings.warn(
            f"{program.name}: at t = {t[k]:.6g} s {quantity.name} is {inputs[k, worst]:.4g} {quantity.unit}, the exact"
            f" inversion gives {exact[at, worst]:.4g} {quantity.unit}; {cause}take the form Reduced(), which has no"
            f" step, or a smaller step or another method",
            ServocoreWarning,
            stacklevel=4,
        )


def _exact_values(program: Program, jet: Array, p: Array) -> Array:
    state, report = program.begin(jet, p)
    return program.values(state, jet, p) if report.converged else np.full(len(program.channels), np.nan)


def _fastest_turn(program: Program, values: Array, k: int, factor: float) -> str:
    """Name the angle that turns most within the step to instant `k`, and the turn it may make.

    Bodies given by their directors exert a torque of J turn^3/h^2 too much on a turn a step, so that the error of the
    inputs is proportional to the turn at a given speed; `factor` takes it to what is allowed.
    """
    turns = {
        channel.name: abs(float(values[k, j] - values[k - 1, j]))
        for j, channel in enumerate(program.channels)
        if channel.unit == "rad"
    }
    name = max(turns, key=lambda each: turns[each], default="")
    if k == 0 or not name or turns[name] < _SMALLEST_TURN:
        return ""
    return (
        f"{name} turns by {turns[name]:.2g} rad within this step, where about {min(factor, 1.0) * turns[name]:.2g} rad"
        f" would be an error of half the peak; "
    )
