"""Backward differentiation formulas at constant step, of order one to six."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import comb

import casadi as ca
import numpy as np

from servocore.dae import Dae
from servocore.errors import InvalidSetting
from servocore.methods.base import (
    Discretisation,
    Orders,
    at,
    differenced,
    labels,
    reference_symbols,
    scales,
    start_symbols,
)
from servocore.numerics.interpolation import lagrange, symbolic_lagrange
from servocore.numerics.square_systems import SquareSystem


def coefficients(order: int) -> tuple[Fraction, ...]:
    """Return alpha_0, ..., alpha_k of x_dot(t1) = (sum_i alpha_i x(t1 - i h)) / h, exactly.

    They are the sum of the backward differences nabla^j / j, j = 1 ... k, and are checked to differentiate
    polynomials up to degree k.
    """
    alpha = [Fraction(0)] * (order + 1)
    for j in range(1, order + 1):
        for i in range(j + 1):
            alpha[i] += Fraction((-1) ** i * comb(j, i), j)
    for degree in range(order + 1):
        moment = sum(a * Fraction(-i) ** degree for i, a in enumerate(alpha))
        if moment != (1 if degree == 1 else 0):
            raise AssertionError(f"BDF{order} does not differentiate degree {degree}")
    return tuple(alpha)


@dataclass(frozen=True)
class BDF:
    """Backward differentiation of order k at constant step.

        H(x1) (sum_i alpha_i x_{1-i}) = h f(x1, z1, t1),    0 = h(x1, z1, t1)

    Order k in all variables of a projected form (index 3) at constant step, A(alpha)-stable, for k up to 6. The start
    needs a history: positions come from the exact inversion before the initial time, on the reference continued
    backwards. On forms of index two and more their velocities are formed by the scheme's own difference formula:
    exact velocities would meet differenced ones with a jump of the order of their error, and cost the inputs an order.
    """

    order: int = 2

    def __post_init__(self) -> None:
        if self.order not in range(1, 7):
            raise InvalidSetting(f"BDF of order {self.order} does not exist or is unstable; use 1 to 6")

    @property
    def name(self) -> str:
        """Name on command lines and in tables."""
        return f"bdf{self.order}"

    def orders(self, index: int) -> Orders:  # noqa: ARG002 - the same on every form up to index 3
        """Return the orders of convergence on a form of the given index."""
        return Orders(self.order, self.order, self.order)

    def discretise(self, dae: Dae) -> Discretisation:
        """Return the equations of one step."""
        k = self.order
        alpha = [float(each) for each in coefficients(k)]
        size_x, size = dae.x.numel(), dae.x.numel() + dae.z.numel()
        # One column more than the formula needs serves to extrapolate the first guess with order k.
        history, past_times = ca.SX.sym("past", size, k + 1), -np.arange(k + 1.0)  # in steps
        h, ratio, fraction = ca.SX.sym("h"), ca.SX.sym("ratio"), ca.SX.sym("fraction")
        reference, (gamma,) = reference_symbols(dae, 1)
        past = sum((a * history[:size_x, i] for i, a in enumerate(alpha[1:])), ca.SX.zeros(size_x))
        rate = (alpha[0] * dae.x + past) / h
        unknowns = ca.vertcat(dae.x, dae.z)
        unknown_scale, residual_scale = scales(dae, h)
        equations = SquareSystem(
            unknowns=unknowns,
            givens=ca.vertcat(ca.vec(history), ca.vec(reference), h, dae.p),
            residual=at(dae, ca.vertcat(ca.mtimes(dae.H, rate) - dae.f, dae.h), dae.x, dae.z, gamma),
            guess=ca.mtimes(history, ca.DM(lagrange(past_times, [1.0]).T)),
            unknown_scale=unknown_scale,
            residual_scale=residual_scale,
        )
        start = start_symbols(dae, 2 * k + 1)
        return Discretisation(
            equations=equations,
            state=ca.vec(history),
            next_state=ca.vertcat(unknowns, ca.vec(history[:, :k])),
            start=start,
            first_state=ca.vec(differenced(dae, start, h, alpha)),
            x=history[:size_x, 0],
            z=history[size_x:, 0],
            nodes=(1.0,),
            reference=reference,
            step=h,
            ratio=ratio,
            rescaled=ca.vec(ca.mtimes(history, symbolic_lagrange(past_times, [-j * ratio for j in range(k + 1)]))),
            fraction=fraction,
            between=ca.vertcat(
                ca.mtimes(history, symbolic_lagrange(past_times, [fraction - 1])), ca.vec(history[:, 1:])
            ),
            labels=labels(dae),
        )
