"""What every method offers: the equations of one step, as a value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import casadi as ca

from servocore.dae import Dae
from servocore.newton import SquareSystem


@dataclass(frozen=True, eq=False)
class Discretisation:
    """One time step of a method on a `Dae`: a square system, and how the state of the step moves on.

    Parameters
    ----------
    equations : SquareSystem
        Its givens are [state; reference at the nodes; step; parameters].
    state : casadi.SX
        The flat state at the start of the step, history included.
    next_state : casadi.SX
        The state at the end, an expression of unknowns and givens.
    first_state : casadi.SX
        The state from consistent values at the initial time, an expression of ``dae.x`` and ``dae.z``.
    x, z : casadi.SX
        Unknowns of the `Dae` within `state`: what the state says of its own instant.
    nodes : tuple of float
        Fractions of the step at which the reference is needed; the last is 1.
    reference : casadi.SX
        Symbols of the reference at the nodes, shape (m, orders * len nodes), node after node.
    step : casadi.SX
        Symbol of the step size h.
    """

    equations: SquareSystem
    state: ca.SX
    next_state: ca.SX
    first_state: ca.SX
    x: ca.SX
    z: ca.SX
    nodes: tuple[float, ...]
    reference: ca.SX
    step: ca.SX


class Method(Protocol):
    """A one-step or multi-step method; implementations are frozen dataclasses that know `Dae` only."""

    @property
    def name(self) -> str:
        """Name on command lines and in tables."""

    def __hash__(self) -> int: ...

    def discretise(self, dae: Dae) -> Discretisation:
        """Return the equations of one step."""


def scales(dae: Dae, h: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the magnitudes of unknowns and equations, by which Newton's system becomes well conditioned.

    An error e of the positions shows as e/h in velocities and e/h^2 in multipliers and inputs. On a form of index one
    or less nothing is divided by h, and nothing needs scaling.
    """
    if dae.index <= 1:
        return ca.vertcat(*[each.nominal for each in dae.unknowns]), ca.SX.ones(len(dae.equations))
    unknowns = [each.nominal * h**-each.level for each in dae.unknowns]
    equations = [h**-each.level for each in dae.equations]
    return ca.vertcat(*unknowns), ca.vertcat(*equations)
