"""SUNDIALS on the reduced form: variable step and order, one tolerance, dense output. It comes with CasADi."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.errors import IntegrationFailed, InvalidModel, InvalidReference
from servocore.formulations.reduced import Reduced
from servocore.methods.backward_euler import BackwardEuler
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.references.base import Formula
from servocore.solution import Solution
from servocore.solvers.route import require_tolerance
from servocore.solvers.runs import Progress, first_state, of_states, solution_of_states, step_of
from servocore.stepping.program import program_of

_MOST_STEPS = 100_000


@dataclass(frozen=True)
class Sundials:
    """The internal dynamics of the reduced form by IDAS: BDF of variable order and step (Hindmarsh et al. 2005).

    Give it to `solve` in the place of a method: ``solve(scene, Reduced(), Sundials(1e-6))``. The states are read at
    the instants from its dense output; everything else is solved there to round-off. The choice of states is kept over
    the whole run, and the path has to be a formula, as paths from rest to rest are.

    Parameters
    ----------
    rtol : float
        Of the local error, relative to each state; a thousandth of it in the unit of each state.

    Attributes
    ----------
    name : str
        Name on command lines and in tables.
    """

    name = "sundials"
    rtol: float = 1e-6

    def __post_init__(self) -> None:
        require_tolerance(self.rtol, "rtol of Sundials")

    def run(self, problem: Problem, times: Array, progress: Progress = lambda *_: None) -> Solution:
        """Integrate to the instants; see `Route`.

        Raises
        ------
        InvalidModel
            If there are no internal dynamics, or the equations depend on time.
        InvalidReference
            If the path is no formula.
        IntegrationFailed
            If SUNDIALS gives up, or an instant is not solved.
        """
        formula, array, how = problem.reference.formula, problem.array, (Reduced(), BackwardEuler())
        if problem.flat:
            raise InvalidModel(f"{problem.name} has no internal dynamics: there is nothing to integrate")
        if problem.system.time.numel():
            raise InvalidModel(f"{problem.name}: its equations depend on time, which Sundials excludes; use RadauIIA")
        if formula is None:
            raise InvalidReference("SUNDIALS needs a path that is a formula, such as rest_to_rest; RadauIIA takes any")
        program, count = program_of(problem, *how), len(times) - 1
        first, _ = first_state(problem, program, step_of(times))
        size = len(array.states)
        x0, z0 = first[:size], first[size : len(array.unknowns)]
        numbers = np.concatenate([formula.numbers(array.reference_order), problem.p])
        integrate = _integrator(problem.resolved, formula, self.rtol, tuple(times.tolist()))
        try:
            states = np.asarray(integrate(x0=x0, z0=z0, p=numbers)["xf"])
        except RuntimeError as error:  # SUNDIALS gives up
            raise IntegrationFailed(f"{problem.name}: SUNDIALS gave up: {str(error).splitlines()[-1]}") from None
        values = of_states(problem, times, np.hstack([x0[:, None], states]))
        if not np.isfinite(values).all():
            k = int(np.isfinite(values).all(axis=0).argmin())
            raise IntegrationFailed(f"{problem.name}: SUNDIALS led to no motion that can be at t = {times[k]:.6g} s")
        progress(count, count)
        return solution_of_states(problem, times, values, f"{problem.system.name}, reduced, {self.name}")


@made_once
def _integrator(resolved: ResolvedSystem, formula: Formula, rtol: float, times: tuple[float, ...]) -> ca.Function:
    """Compile (x0, z0, p = [numbers of the path; p]) -> states xf at the instants after the first."""
    dae, order = resolved.dae(Reduced()), resolved.array.reference_order
    numbers = ca.SX.sym("numbers", len(formula.numbers(order)))
    t = ca.SX.sym("t")
    gamma = ca.horzcat(*formula.jet(t, ca.vertsplit(numbers), order))
    rates = ca.solve(dae.H, dae.f)
    ode, alg = ca.substitute([rates, dae.h], [ca.vec(dae.gamma[:, : order + 1])], [ca.vec(gamma)])
    equations = {"x": dae.x, "z": dae.z, "p": ca.vertcat(numbers, dae.p), "t": t, "ode": ode, "alg": alg}
    options = {"reltol": rtol, "abstol": rtol / 1000.0, "max_num_steps": _MOST_STEPS, "show_eval_warnings": False}
    return ca.integrator("sc_sundials", "idas", equations, times[0], list(times[1:]), options)
