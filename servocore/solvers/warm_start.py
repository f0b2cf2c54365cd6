"""Exact inversions from an answer that is known: another exact one, or that of a run of steps.

From a guess beside an exact answer: the change is the residual that Newton's method left. From a run: the exact
answer on its branch, without continuation, if the answers are continuous from instant to instant.
"""

from __future__ import annotations

import numpy as np

from servocore.formulations.reduced import Reduced
from servocore.methods.backward_euler import BackwardEuler
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.solution import Solution
from servocore.solvers.branch_continuation import CONTINUOUS, Branch, on_one_branch
from servocore.solvers.fixed_step_loop import run_steps
from servocore.solvers.results import Run, Segment, solution_of
from servocore.stepping.exact_evaluation import exact_unknowns, guessed_unknowns, unknowns_from
from servocore.stepping.program import program_of

_ASIDE = 1e-7  # relative


def perturbed_inversion(problem: Problem, times: Array) -> Solution:
    """Return the inputs alone, at instants of a problem without internal dynamics."""
    states, array = _exact_states(problem, times), problem.array
    aside = states * (1.0 + _ASIDE * np.sin(1.0 + np.arange(len(states))))[:, None]
    unknowns = unknowns_from(problem, times, aside)
    inputs = problem.system.inputs
    places = [array.position(f"u.{quantity.name}", 0) for quantity in inputs]
    return Solution(times, inputs, unknowns[places].T, "the exact inversion, solved again")


def _exact_states(problem: Problem, t: Array) -> Array:
    """Return all unknowns of the derivative array (size, N) at instants, on one branch."""
    if problem.follow_branch:
        return run_steps(problem, program_of(problem, Reduced(), BackwardEuler()), t).states
    return on_one_branch(problem, t, exact_unknowns(problem, t)[0])[0]


def inversion_near(problem: Problem, solution: Solution) -> Solution | None:
    """Return the exact inversion nearest to a run; None if it is not solved, or not seen to be on one branch."""
    t, states = solution.t, unknowns_near(problem, solution)
    if not np.isfinite(states).all() or len(Branch.along(problem, states).jumps(t, states)):
        return None
    program = program_of(problem, Reduced(), BackwardEuler())
    return solution_of(problem, [Segment(program, t, Run(states, 0, 0, 0.0))], branch=CONTINUOUS)


def unknowns_near(problem: Problem, solution: Solution) -> Array:
    """Return all unknowns of the derivative array (size, N) nearest to a run, its internal states as they are there."""
    array, t = problem.array, solution.t
    guess = guessed_unknowns(problem, t)
    for kind, quantities in (("q", problem.system.coordinates.quantities), ("u", problem.system.inputs)):
        for channel in (quantity for quantity in quantities if quantity.name in solution):
            known = solution[channel.name]
            for order in range(3):
                entry = (array.names.index(f"{kind}.{channel.name}"), order)
                if entry in array.unknowns:
                    guess[array.places([entry])[0]] = known
                known = np.gradient(known, t)
    return unknowns_from(problem, t, guess)
