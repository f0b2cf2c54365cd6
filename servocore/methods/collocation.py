"""Collocation methods: Radau IIA, which ends its steps on the constraints, and Gauss, which does not."""

from __future__ import annotations

from dataclasses import dataclass, field
from numbers import Integral
from typing import ClassVar

import casadi as ca
import numpy as np
from numpy.polynomial import Legendre

from servocore.dae import Dae
from servocore.errors import InvalidSetting, require_kind
from servocore.methods.backward_euler import BackwardEuler
from servocore.methods.base import Discretization, Orders, Start
from servocore.numerics.interpolation import Array, lagrange
from servocore.numerics.memoization import made_once
from servocore.numerics.square_systems import SquareSystem

_MOST_STAGES = 10


@dataclass(frozen=True, eq=False)
class Tableau:
    """Runge-Kutta coefficients of a collocation method; construction fails unless the order conditions hold.

    Attributes
    ----------
    c, A, b : ndarray
        Nodes, shape (s,), matrix, shape (s, s), weights, shape (s,).
    order : int
        Order on ordinary differential equations: quadrature is exact to this degree.
    """

    c: Array
    A: Array
    b: Array
    order: int

    def __post_init__(self) -> None:
        for k in range(1, len(self.c) + 1):
            if np.abs(self.A @ self.c ** (k - 1) - self.c**k / k).max() > 1e-13:
                raise InvalidSetting(f"the stage condition C({k}) fails")
        for k in range(1, self.order + 1):
            if abs(self.b @ self.c ** (k - 1) - 1.0 / k) > 1e-13:
                raise InvalidSetting(f"the quadrature condition B({k}) fails")


@made_once  # methods are constructed for every run, and roots take longer than a run of a small scene
def tableau(family: str, stages: int) -> Tableau:
    """Compute the coefficients of ``radau`` (IIA) or ``gauss`` with any number of stages up to ten.

    Raises
    ------
    InvalidSetting
        If that many stages are not offered.
    """
    require_kind(stages, Integral, "the number of stages", "a whole number", InvalidSetting)
    if stages not in range(1, _MOST_STAGES + 1):
        raise InvalidSetting(f"{stages} stages are not offered; use 1 to {_MOST_STAGES}")
    to_the_end = family == "radau"
    # The roots of P_s - P_(s-1) include the right end.
    polynomial = Legendre([*[0.0] * (stages - 1), -float(to_the_end), 1.0], domain=[0.0, 1.0])
    c = np.sort(np.real(polynomial.roots()))
    for _ in range(3):  # polish the roots
        c = c - polynomial(c) / polynomial.deriv()(c)
    if to_the_end:
        c[-1] = 1.0
    powers, counts = np.vander([*c, 1.0], stages + 1, increasing=True), np.arange(1.0, stages + 1)
    weights = np.linalg.solve(powers[:-1, :-1].T, (powers[:, 1:] / counts).T).T
    return Tableau(c, weights[:-1], weights[-1], 2 * stages - to_the_end)


@dataclass(frozen=True)
class _Collocation:
    """Common part of Radau IIA and Gauss: tableau, name and equations, by the number of stages."""

    family: ClassVar[str]
    stages: int
    tableau: Tableau = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "tableau", tableau(self.family, self.stages))

    @property
    def name(self) -> str:
        """Name on command lines and in tables."""
        return f"{self.family}{self.stages}"

    def discretize(self, dae: Dae) -> Discretization:
        """Return the equations of one step, in the values at its stages.

        The state is the unknowns at the end of the last step, at its stages and its begin. Dense output is the
        polynomial through begin and stages: through the stages alone it would be extrapolated before the first of
        them, where its error is largest.
        """
        method = self.tableau
        s, size_x = len(method.c), dae.x.numel()
        size = size_x + dae.z.numel()
        old, past, unknowns = ca.SX.sym("old", size), ca.SX.sym("past", size, s), ca.SX.sym("stage", size, s)
        begin, h, start = ca.SX.sym("begin", size), ca.SX.sym("h"), Start.of(dae)
        state = ca.vertcat(old, ca.vec(past), begin)
        reference, at_nodes = dae.reference_symbols(s)
        W, fraction, nodes = np.linalg.inv(method.A), ca.SX.sym("fraction"), np.array([0.0, *method.c])
        residual = []
        for i, gamma in enumerate(at_nodes):
            rate = ca.mtimes(unknowns[:size_x, :] - ca.repmat(old[:size_x], 1, s), ca.DM(W[i])) / h
            x, z = unknowns[:size_x, i], unknowns[size_x:, i]
            H, f, algebraic = (dae.at(expression, x, z, gamma) for expression in (dae.H, dae.f, dae.h))
            residual.append(ca.vertcat(ca.mtimes(H, rate) - f, algebraic))
        unknown_scale, residual_scale = dae.scales(h)
        equations = SquareSystem(
            unknowns=ca.vec(unknowns),
            givens=ca.vertcat(state, ca.vec(reference), h, dae.p),
            residual=ca.vertcat(*residual),
            guess=ca.vec(ca.mtimes(past, lagrange(method.c, method.c + 1.0))),
            unknown_scale=ca.repmat(unknown_scale, s, 1),
            residual_scale=ca.repmat(residual_scale, s, 1),
        )
        # The collocation polynomial through old and the stages, at the end of the step.
        weights = method.b @ W
        end = (1.0 - weights.sum()) * old + ca.mtimes(unknowns, ca.DM(weights))
        if method.c[-1] == 1.0:
            end = unknowns[:, -1]
        return Discretization(
            equations=equations,
            state=state,
            next_state=ca.vertcat(end, ca.vec(unknowns), old),
            start=start,
            first_state=ca.repmat(start.values[:, 0], s + 2, 1),
            x=old[:size_x],
            z=old[size_x:],
            nodes=tuple(float(c) for c in method.c),
            reference=reference,
            step=h,
            fraction=fraction,
            between=ca.vertcat(ca.mtimes(ca.horzcat(begin, past), lagrange(nodes, [fraction])), state[size:]),
            labels=dae.labels * s,
        )


@dataclass(frozen=True)
class RadauIIA(_Collocation):
    """Radau IIA with s stages: collocation at nodes of which the last is the end of the step.

        H(X_i) sum_j w_ij (X_j - x0) = h f(X_i, Z_i, t0 + c_i h),    0 = h(X_i, Z_i, t0 + c_i h),    W = A^-1

    Stiffly accurate and L-stable: order 2 s - 1 on forms of index one. On projected forms (index 3) velocities have
    order s and multipliers and inputs s - 1, at least one (Hairer, Lubich & Roche 1989). Every further index costs two
    or more stages one order: on index 5 two stages diverge, three do not converge.

    Parameters
    ----------
    stages : int
        Number s of stages.
    """

    family = "radau"
    stages: int = 3

    def orders(self, index: int) -> Orders:
        """Return the orders of convergence on a form of the given index."""
        s = self.stages
        if s == 1:
            return BackwardEuler().orders(index)
        if index <= 1:
            return Orders(2 * s - 1, 2 * s - 1, 2 * s - 1)
        if index > 3:
            return Orders(s + 4 - index, s + 3 - index, s + 2 - index)
        return Orders(s, s, s - 1)

    def discretize(self, dae: Dae) -> Discretization:
        """Return the equations of one step; with one stage they are those of backward Euler."""
        if self.stages == 1:
            return BackwardEuler().discretize(dae)
        return super().discretize(dae)


@dataclass(frozen=True)
class Gauss(_Collocation):
    """Gauss collocation with s stages; one stage is the implicit midpoint rule.

    Order 2 s on ordinary differential equations, symplectic, not stiffly accurate: on projected forms nothing damps
    an error of the inputs from step to step, and with an even number of stages the inputs lose four orders: with two
    their error grows like 1/h^2. For comparison only.

    Parameters
    ----------
    stages : int
        Number s of stages.
    """

    family = "gauss"
    stages: int = 1

    def orders(self, index: int) -> Orders:
        """Return the orders of convergence on a form of the given index."""
        s = self.stages
        if index <= 1:
            return Orders(2 * s, 2 * s, s + s % 2, damped=False)
        if index > 3:
            lost = index - 3
            forces = -lost if s % 2 else s - 4 - 2 * lost
            return Orders(forces + 2, forces + 1, forces, damped=False)
        return Orders(s, s - 1, max(2, s - 1) if s % 2 else s - 4, damped=False)
