"""`Dae`: equation (20), the interface between formulations, which make one, and methods, which step one.

    H(x) x_dot = f(x, z, t),    0 = h(x, z, t)

Time enters through the reference gamma(t) and its derivatives only, which replace t.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from servocore.errors import InvalidModel
from servocore.numerics.expressions import highest_derivative


@dataclass(frozen=True)
class Unknown:
    """Description of an unknown of a `Dae`.

    Parameters
    ----------
    variable : str
        The mechanical variable: ``q.s``, ``lam.3``, ``u.F``.
    order : int
        Order of the time derivative of the variable: 0, or 1 for a velocity.
    nominal : float
        Typical magnitude in SI units.
    """

    variable: str
    order: int = 0
    nominal: float = 1.0

    @property
    def level(self) -> int:
        """0 for positions, 1 for velocities, 2 for accelerations, multipliers and inputs, and so on.

        An error e of the positions appears as e/h^level, so that unknowns are scaled by h^-level.
        """
        return self.order + (0 if self.variable.startswith("q.") else 2)

    @property
    def name(self) -> str:
        """The variable with a prime for every derivative."""
        return self.variable + "'" * self.order


@dataclass(frozen=True)
class Equation:
    """Description of an equation of a `Dae`.

    Parameters
    ----------
    name : str
        Name in messages.
    level : int
        As `Unknown.level`: the power of 1/h in an error of it.
    """

    name: str
    level: int


@dataclass(frozen=True, eq=False)
class Dae:
    """A differential-algebraic equation in the form (20).

    Parameters
    ----------
    name : str
        Formulation and system, for messages.
    x, z : casadi.SX
        Differential and algebraic unknowns.
    H : casadi.SX
        Shape (rows of f, len x).
    f, h : casadi.SX
        Right-hand sides; together as many rows as unknowns.
    gamma : casadi.SX
        Symbols of the reference, shape (m, orders); columns up to `reference_order` are used.
    p : casadi.SX
        Parameters.
    unknowns, equations : tuples
        Descriptions of [x; z] and of the rows of [f; h].
    physical : dict of str to casadi.SX
        The mechanical variables ``q``, ``v``, ``lam``, ``u`` as expressions of x, z, gamma and p.
    index : int
        Differentiation index: 0 without differential unknowns, 1 if the equations determine the algebraic ones.
    """

    name: str
    x: ca.SX
    z: ca.SX
    H: ca.SX
    f: ca.SX
    h: ca.SX
    gamma: ca.SX
    p: ca.SX
    unknowns: tuple[Unknown, ...]
    equations: tuple[Equation, ...]
    physical: dict[str, ca.SX]
    index: int

    def __post_init__(self) -> None:
        unknowns, rows = self.x.numel() + self.z.numel(), self.f.numel() + self.h.numel()
        if unknowns != rows:
            raise InvalidModel(f"{self.name}: {rows} equations for {unknowns} unknowns")
        if self.H.shape != (self.f.numel(), self.x.numel()):
            raise InvalidModel(f"{self.name}: H has shape {self.H.shape}")
        if len(self.unknowns) != unknowns or len(self.equations) != rows:
            raise InvalidModel(f"{self.name}: unknowns and equations are not all described")

    @property
    def reference_order(self) -> int:
        """Highest derivative of the reference that enters."""
        return highest_derivative(ca.vertcat(self.f, self.h), self.gamma)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the rows."""
        return tuple(equation.name for equation in self.equations)

    def at(self, expression: ca.SX, x: ca.SX, z: ca.SX, reference: ca.SX) -> ca.SX:
        """Evaluate an expression of this equation at other unknowns and another instant.

        Parameters
        ----------
        expression : casadi.SX
            In the symbols of this equation, such as `f` or `h`.
        x, z : casadi.SX
            Replacements of the unknowns.
        reference : casadi.SX
            Replacement of gamma, shape (m, reference_order + 1).

        Returns
        -------
        casadi.SX
            Of the shape of `expression`.
        """
        old = ca.vertcat(self.x, self.z, ca.vec(self.gamma[:, : reference.size2()]))
        return ca.substitute(expression, old, ca.vertcat(x, z, ca.vec(reference)))

    def reference_symbols(self, nodes: int) -> tuple[ca.SX, list[ca.SX]]:
        """Make symbols of the reference at the nodes of a step; returns all of them and one block a node.

        Parameters
        ----------
        nodes : int
            Number of nodes.

        Returns
        -------
        tuple of (casadi.SX, list of casadi.SX)
            Shape (m, orders * nodes), and a block of shape (m, orders) for each node.
        """
        orders = self.reference_order + 1
        reference = ca.SX.sym("gamma_at", self.gamma.size1(), orders * nodes)
        return reference, ca.horzsplit(reference, orders)

    def scales(self, h: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the magnitudes of unknowns and equations, by which Newton's system becomes well conditioned.

        An error e of the positions appears as e/h in velocities and e/h^2 in multipliers and inputs. On a form of index
        one or less nothing is divided by h, and nothing needs scaling.

        Parameters
        ----------
        h : casadi.SX, scalar
            Step in s.

        Returns
        -------
        tuple of casadi.SX
            One entry per unknown, and one per equation.
        """
        if self.index <= 1:
            return ca.SX([unknown.nominal for unknown in self.unknowns]), ca.SX.ones(len(self.equations))
        unknowns = [unknown.nominal * h**-unknown.level for unknown in self.unknowns]
        return ca.vertcat(*unknowns), ca.vertcat(*[h**-equation.level for equation in self.equations])
