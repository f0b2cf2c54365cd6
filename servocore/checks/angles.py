"""Angles that an equation knows up to full turns only, and that turn too far in a step."""

from __future__ import annotations

import casadi as ca
import numpy as np

from servocore.checks.findings import ROUND_OFF
from servocore.errors import IntegrationFailed
from servocore.numerics.compiled_calls import Array, Call
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.stepping.program import Program


@made_once
def _periodic_coordinates(resolved: ResolvedSystem) -> tuple[str, ...]:
    """Return the angles among the coordinates, reported as they are, of which an equation is a periodic function.

    Decided by numbers, at a point without symmetry. An angle that enters linearly, of a wheel say, may turn as far as
    it likes.
    """
    system = resolved.system
    terms = (system.constraints, system.output, system.potential, system.mass, system.input_matrix, system.force)
    arguments = [system.q, system.v, system.p, system.time]
    evaluate = Call(ca.Function("sc_terms", arguments, [ca.densify(ca.vertcat(*map(ca.vec, terms)))]))
    point, p = np.sin(1.0 + np.arange(len(system.coordinates))), system.parameters.values()
    time = np.full(system.time.numel(), 0.7)
    observed = {quantity.name: expression for quantity, expression in system.observables.items()}
    periodic = []
    for k, quantity in enumerate(system.coordinates.quantities):
        if quantity.unit != "rad" or not ca.is_equal(observed.get(quantity.name, system.q[k]), system.q[k]):
            continue
        aside = np.arange(len(point)) == k
        here, there, round_again = (evaluate(point + turn * aside, point, p, time)[0] for turn in (0.0, 1.0, 2 * np.pi))
        scale = ROUND_OFF * np.maximum(np.abs(here), np.abs(there))
        if ((np.abs(round_again - here) <= scale) & (np.abs(there - here) > scale)).any():
            periodic.append(quantity.name)
    return tuple(periodic)


def require_less_than_half_a_turn(problem: Problem, program: Program, t: Array, values: Array) -> None:
    """Raise `IntegrationFailed` if an angle that some equation knows up to full turns only turns too far in a step.

    A step of half a turn cannot be distinguished from one the other way round.
    """
    names = [channel.name for channel in program.channels]
    for name in _periodic_coordinates(problem.resolved):
        turns = np.abs(np.diff(values[:, names.index(name)]))
        if not (turns < np.pi).all():
            k = int((~(turns < np.pi)).argmax())
            cure = "a smaller step is needed"
            if not program.smaller_steps_help:
                cure = "another form is needed, such as Reduced()"
            raise IntegrationFailed(
                f"{program.name}: {name} turns by {turns[k]:.4g} rad in the step from t = {t[k]:.6g} s to"
                f" {t[k + 1]:.6g} s, a step resolves turns of less than pi only; {cure}"
            )
