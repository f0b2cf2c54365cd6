"""The generalized-alpha method for equations of second order in time."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from servocore.dae import Dae
from servocore.errors import InvalidModel, InvalidSetting, require_real
from servocore.methods.base import Discretization, Orders, Start
from servocore.numerics.square_systems import SquareSystem


@dataclass(frozen=True)
class GeneralizedAlpha:
    """Generalized-alpha (Chung & Hulbert 1993) in the form of Arnold & Bruels (2007) for constrained systems.

        q1 = q0 + h v0 + h^2 ((1/2 - beta) a0 + beta a1),    v1 = v0 + h ((1 - gamma) a0 + gamma a1)
        (1 - alpha_m) a1 + alpha_m a0 = (1 - alpha_f) v1_dot + alpha_f v0_dot

    with the equations and constraints at the new instant. `rho` is the spectral radius at infinite frequency: 1 damps
    nothing, 0 everything at once. Second order; on projected forms errors of the inputs decay like rho^n.
    A start in motion causes such an error of first order: the method's own acceleration differs from v_dot.

    Parameters
    ----------
    rho : float
        Spectral radius at infinite frequency, 0 to 1.
    """

    rho: float = 0.8

    def __post_init__(self) -> None:
        require_real(self.rho, "the spectral radius rho", "a number in [0, 1]", InvalidSetting)
        if not 0.0 <= self.rho <= 1.0:
            raise InvalidSetting(f"the spectral radius rho must lie in [0, 1], not {self.rho}")

    @property
    def name(self) -> str:
        """Name on command lines and in tables."""
        return f"generalized-alpha-{self.rho:g}"

    @property
    def parameters(self) -> tuple[float, float, float, float]:
        """Return (alpha_m, alpha_f, beta, gamma) for second order and the spectral radius `rho`."""
        # Chung & Hulbert: least damping of low frequencies for a given damping of high ones.
        alpha_m, alpha_f = (2 * self.rho - 1) / (self.rho + 1), self.rho / (self.rho + 1)
        gamma = 0.5 + alpha_f - alpha_m
        return alpha_m, alpha_f, (gamma + 0.5) ** 2 / 4, gamma

    def orders(self, index: int) -> Orders:  # noqa: ARG002 - the same on every form up to index 3
        """Return the orders of convergence on a form of the given index."""
        return Orders(2, 2, 2, damped=self.rho < 1.0)

    def discretize(self, dae: Dae) -> Discretization:
        """Return the equations of one step; raises `InvalidModel` if x is not made of pairs (q, v)."""
        places_q, places_v = _pairs(dae)
        n, size_z = len(places_q), dae.z.numel()
        alpha_m, alpha_f, beta, gamma = self.parameters
        sizes = (n, n, size_z, n, n, size_z)
        state = [ca.SX.sym("old", size) for size in sizes]
        (q0, v0, z0, a0, rate0, z_before), old = state, ca.vertcat(*state)
        a1, rate1, h = ca.SX.sym("a", n), ca.SX.sym("v_dot", n), ca.SX.sym("h")
        q1, v1 = dae.x[places_q], dae.x[places_v]
        reference, (at_end,) = dae.reference_symbols(1)
        x_dot = _joined(places_q, places_v, v1, rate1)
        balance = dae.at(ca.mtimes(dae.H, x_dot) - dae.f, dae.x, dae.z, at_end)
        kept = [k for k in range(balance.numel()) if not balance[k].is_zero()]  # q_dot = v holds by construction
        residual = ca.vertcat(
            # Divided by h^2 and h, so that all three rows are accelerations and one scale fits them.
            (q1 - q0 - h * v0) / h**2 - (0.5 - beta) * a0 - beta * a1,
            (v1 - v0) / h - (1 - gamma) * a0 - gamma * a1,
            (1 - alpha_m) * a1 + alpha_m * a0 - (1 - alpha_f) * rate1 - alpha_f * rate0,
            balance[kept],
            dae.at(dae.h, dae.x, dae.z, at_end),
        )
        unknown_scale, residual_scale = dae.scales(h)
        accelerations = h**-2 if dae.index > 1 else ca.SX(1)
        unknowns = ca.vertcat(dae.x, dae.z, a1, rate1)
        # Rows that hold by construction are not part of the residual, nor of its scales.
        rows = [*kept, *range(balance.numel(), residual_scale.numel())]
        equations = SquareSystem(
            unknowns=unknowns,
            givens=ca.vertcat(old, ca.vec(reference), h, dae.p),
            residual=residual,
            guess=ca.vertcat(_joined(places_q, places_v, q0 + h * v0 + h**2 / 2 * a0, v0 + h * a0), z0, a0, rate0),
            unknown_scale=ca.vertcat(unknown_scale, ca.repmat(accelerations, 2 * n, 1)),
            residual_scale=ca.vertcat(ca.repmat(accelerations, 3 * n, 1), residual_scale[rows]),
        )
        start, fraction = Start.of(dae), ca.SX.sym("fraction")
        back = (1 - fraction) * h
        # a approximates v_dot at a shifted instant; at the start only v_dot itself is known.
        first, rates, z = start.values[:, 0], [start.rates[places_v]] * 2, start.values[2 * n :, 0]
        return Discretization(
            equations=equations,
            state=old,
            next_state=ca.vertcat(q1, v1, dae.z, a1, rate1, z0),
            start=start,
            first_state=ca.vertcat(first[places_q], first[places_v], z, *rates, z),
            x=_joined(places_q, places_v, q0, v0),
            z=z0,
            nodes=(1.0,),
            reference=reference,
            step=h,
            fraction=fraction,
            between=ca.vertcat(
                q0 - back * v0 + back**2 / 2 * a0,
                v0 - back * a0,
                fraction * z0 + (1 - fraction) * z_before,
                old[2 * n + size_z :],
            ),
            labels=_labels(dae, places_q, rows),
        )


def _labels(dae: Dae, places_q: list[int], rows: list[int]) -> tuple[str, ...]:
    """Name the equations of a step."""
    kinds = ("position", "velocity", "acceleration")
    own = (f"{kind} of {dae.unknowns[k].name}" for kind in kinds for k in places_q)
    return (*own, *(dae.labels[k] for k in rows))


def _pairs(dae: Dae) -> tuple[list[int], list[int]]:
    """Return the places of positions and of their velocities within x."""
    places = {(unknown.variable, unknown.order): k for k, unknown in enumerate(dae.unknowns[: dae.x.numel()])}
    velocities = [(variable, order) for variable, order in places if (variable, order - 1) in places]
    if 2 * len(velocities) != len(places):
        raise InvalidModel(f"{dae.name}: generalized-alpha needs positions with their velocities as unknowns")
    return [places[variable, order - 1] for variable, order in velocities], [
        places[velocity] for velocity in velocities
    ]


def _joined(places_q: list[int], places_v: list[int], q: ca.SX, v: ca.SX) -> ca.SX:
    x = ca.SX.zeros(len(places_q) + len(places_v))
    x[places_q], x[places_v] = q, v
    return x
