"""What a servo constraint problem cannot hold: outputs and constraints that depend on velocities."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from servocore.errors import InvalidModel

Named = tuple[Sequence[str], ca.SX]


def require_positions(system: str, v: ca.SX, outputs: Named, constraints: Named) -> None:
    """Raise `InvalidModel` if outputs or constraints hold velocities, with what can be done instead.

    Parameters
    ----------
    system : str
        Name for messages.
    v : casadi.SX
        Velocities.
    outputs, constraints : sequence of names, and casadi.SX
        What the rows are called, and the rows.
    """
    for name, expression in _rows(*outputs):
        velocities = _listed(expression, v)
        if velocities:
            raise InvalidModel(
                f"{system}: the output {name} depends on velocities ({velocities}), but a servo constraint prescribes a"
                " function of the coordinates alone; where the output is the rate of such a function, prescribe that"
                " function, along the integral of the path"
            )
    for name, expression in _rows(*constraints):
        velocities = _listed(expression, v)
        if velocities:
            raise InvalidModel(
                f"{system}: the constraint {name} depends on velocities ({velocities}), and nonholonomic constraints"
                " are not solved; give its integral if it has one (rolling along a line has), or let a force f(q, v)"
                " oppose what it forbids"
            )


def _rows(names: Sequence[str], column: ca.SX) -> list[tuple[str, ca.SX]]:
    return list(zip(names, ca.vertsplit(ca.SX(column)), strict=False))


def _listed(expression: ca.SX, v: ca.SX) -> str:
    """Names of the velocities that an expression depends on."""
    return ", ".join(str(v[int(k)]) for k in sorted(set(ca.jacobian_sparsity(expression, v).get_col())))
