"""Angles that an equation knows up to full turns only, and that turn too far in a step."""

from __future__ import annotations

import casadi as ca
import numpy as np

from servocore.errors import IntegrationFailed
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.stepping.program import Program


@made_once
def _periodic_coordinates(resolved: ResolvedSystem) -> tuple[str, ...]:
    """Return the angles among the coordinates, reported as they are, of which an equation is no linear function.

    An angle that enters linearly, of a wheel say, may turn as far as it likes.
    """
    system = resolved.system
    forces = ca.gradient(ca.SX(system.potential), system.q), system.force
    terms = ca.vertcat(*map(ca.vec, (system.constraints, system.output, system.mass, system.input_matrix, *forces)))
    observed = {quantity.name: expression for quantity, expression in system.observables.items()}
    return tuple(
        quantity.name
        for quantity, q in zip(system.coordinates.quantities, ca.vertsplit(system.q), strict=True)
        if quantity.unit == "rad" and ca.is_equal(observed.get(quantity.name, q), q)
        if ca.depends_on(ca.jacobian(terms, q), q)
    )


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
