"""What every formulation offers, and the description of unknowns that formulations share."""

from __future__ import annotations

from typing import Protocol

import casadi as ca

from servocore.dae import Dae, Unknown
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


def mechanical_unknowns(system: MechanicalSystem) -> tuple[ca.SX, ca.SX, tuple[Unknown, ...]]:
    """Return x = (q, v), z = (lam, u) and their descriptions, equations (21) and (30)."""
    x, z = ca.vertcat(system.q, system.v), ca.vertcat(system.lam, system.u)
    coordinates = system.coordinates.quantities
    described = (
        *(Unknown(f"q.{coordinate.name}", 0, coordinate.magnitude) for coordinate in coordinates),
        *(Unknown(f"q.{coordinate.name}", 1, coordinate.magnitude) for coordinate in coordinates),
        *(Unknown(f"lam.{k + 1}") for k in range(system.lam.numel())),
        *(Unknown(f"u.{quantity.name}", 0, quantity.magnitude) for quantity in system.inputs),
    )
    return x, z, described


def physical_variables(system: MechanicalSystem) -> dict[str, ca.SX]:
    """Return the mechanical variables of a formulation whose unknowns they are."""
    return {"q": system.q, "v": system.v, "lam": system.lam, "u": system.u}
