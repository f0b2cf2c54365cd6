"""The protocol of formulations, and the form shared by those in the mechanical variables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import casadi as ca

from servocore.dae import Dae, Equation, Unknown
from servocore.model.system import MechanicalSystem


class Formulation(Protocol):
    """A way to write the servo constraint problem of a mechanical system as a `Dae`.

    Implementations are frozen dataclasses: equal settings compare equal and share compiled steps.
    """

    @property
    def name(self) -> str:
        """Name on command lines and in tables."""

    def __hash__(self) -> int: ...

    def dae(self, system: MechanicalSystem) -> Dae:
        """Return the problem in the form (20).

        Parameters
        ----------
        system : MechanicalSystem
            With its servo outputs and inputs.

        Returns
        -------
        Dae
            In the system's own symbols.
        """


def mechanical_dae(
    system: MechanicalSystem, form: str, H: ca.SX, f: ca.SX, h: ca.SX, described: Sequence[Equation], index: int
) -> Dae:
    """Return a `Dae` in x = (q, v), z = (lam, u), equations (21) and (30), with constraints of positions.

    Parameters
    ----------
    system : MechanicalSystem
        With its servo outputs and inputs.
    form : str
        Name of the formulation.
    H, f, h : casadi.SX
        H v_dot = f, 0 = h, in place of the momentum equation.
    described : sequence of Equation
        Names and levels of these rows.
    index : int
        Differentiation index of the form.
    """
    quantities = system.coordinates.quantities
    return Dae(
        name=f"{system.name}, {form}",
        x=ca.vertcat(system.q, system.v),
        z=ca.vertcat(system.lam, system.u),
        H=ca.diagcat(ca.SX.eye(len(quantities)), H),
        f=ca.vertcat(system.v, f),
        h=ca.vertcat(h, system.output - system.path[:, 0], system.constraints),
        gamma=system.gamma,
        p=system.p,
        unknowns=(
            *(Unknown(f"q.{quantity.name}", order, quantity.magnitude) for order in (0, 1) for quantity in quantities),
            *(Unknown(f"lam.{k + 1}") for k in range(system.lam.numel())),
            *(Unknown(f"u.{quantity.name}", 0, quantity.magnitude) for quantity in system.inputs),
        ),
        equations=(
            *(Equation(f"velocity of {quantity.name}", 1) for quantity in quantities),
            *described,
            *(Equation(f"servo constraint on {quantity.name}", 0) for quantity in system.outputs),
            *(Equation(f"holonomic constraint {k + 1}", 0) for k in range(system.lam.numel())),
        ),
        physical={"q": system.q, "v": system.v, "lam": system.lam, "u": system.u},
        index=index,
    )
