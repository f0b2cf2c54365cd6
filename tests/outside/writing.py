"""What helps to write a system down, and its answer: Lagrange's equations of an energy, and more functions of jets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

import servocore as sc
from servocore.model.system import DERIVED
from servocore.scenes.jets import Jet

g = 9.81
"""Gravity in m/s^2."""


@dataclass(frozen=True)
class Case:
    """A scene of somebody else's, its answer by other means, and what is asked of ours.

    Attributes
    ----------
    exact : callable
        (times, reference) -> values by name.
    index, internal : int
        Structural index, and degrees of freedom of the internal dynamics.
    steps : int
        In the duration of the path.
    tolerance : float
        Largest error, relative to the peak of each quantity.
    options : mapping
        Of `solve`.
    warned : str
        What its solution is warned of; nothing if empty.
    """

    scene: sc.Scene
    exact: Callable[[np.ndarray, sc.Reference], Mapping[str, np.ndarray]]
    index: int
    internal: int = 0
    steps: int = 100
    tolerance: float = 1e-10
    options: Mapping[str, Any] | None = None
    warned: str = ""

    def solution(self) -> sc.Solution:
        import pytest  # here, because `make ivp` runs these problems in an environment without it

        said = pytest.warns(sc.ServocoreWarning, match=self.warned) if self.warned else nullcontext()
        with said:
            return self._solved()

    def _solved(self) -> sc.Solution:
        return sc.solve(self.scene, step=self.scene.reference.duration / self.steps, **(self.options or {}))


def named(names: str, unit: str = "m") -> tuple[sc.Quantity, ...]:
    return tuple(sc.Quantity(each, unit) for each in names.split())


def coordinates(lengths: str, angles: str = "") -> sc.Coordinates:
    return sc.Coordinates(*named(lengths), *named(angles, "rad"))


def lagrange(
    name: str,
    of: sc.Coordinates,
    kinetic: ca.SX,
    output: Mapping[str, ca.SX],
    drives: Mapping[str, ca.SX],
    *,
    guess: Callable[[ca.SX], Sequence[ca.SX | float]] | None = None,
    damping: ca.SX | float = 0.0,
    parameters: Any = None,  # `others` that are spread from a dictionary would have to fit another type
    **others: Any,
) -> sc.MechanicalSystem:
    """Write Lagrange's equations of a kinetic energy in v.

    Every input pushes along its entry of `drives`, a function of q; `damping` is Rayleigh's function of v. Without a
    `guess` all coordinates are zero.
    """
    gamma = ca.SX.sym("gamma", len(output), sc.MAX_REFERENCE_ORDER + 1)
    return sc.MechanicalSystem(
        name=name,
        coordinates=of,
        parameters=parameters or sc.Parameters(),
        inputs=named(" ".join(drives), "N"),
        outputs=named(" ".join(output)),
        mass=ca.sparsify(ca.hessian(kinetic, of.v)[0]),
        output=ca.vertcat(*output.values()),
        input_matrix=-ca.jacobian(ca.vertcat(*drives.values()), of.q),
        force=-ca.gradient(ca.SX(damping), of.v),
        gamma=gamma,
        guess=DERIVED if guess is None else ca.vertcat(*guess(gamma[:, 0])),
        **others,
    )


def rate(position: ca.SX, of: sc.Coordinates) -> ca.SX:
    """Velocity of a place."""
    return ca.jtimes(position, of.q, of.v)


def square(vector: ca.SX) -> ca.SX:
    return ca.sumsqr(vector)


def constant(value: float, like: Jet) -> Jet:
    return Jet.constant(np.full(like.value.shape, value), like.order)


def cos_sin(angle: Jet) -> tuple[Jet, Jet]:
    """c' = -s a' and s' = c a', coefficient by coefficient."""
    a = angle.coefficients
    c, s = [np.cos(a[0])], [np.sin(a[0])]
    for k in range(1, len(a)):
        terms = [(j * a[j], c[k - j], s[k - j]) for j in range(1, k + 1)]
        c.append(-sum(d * y for d, _, y in terms) / k)
        s.append(sum(d * x for d, x, _ in terms) / k)
    return Jet(np.stack(c)), Jet(np.stack(s))


def implicit(residual: Callable[..., Sequence[Jet]], guess: Sequence[np.ndarray], like: Jet) -> list[Jet]:
    """Solve equations between jets: Newton's method for the values, then one more order with every sweep."""
    unknowns = [constant(0.0, like) + value for value in guess]
    for _ in range(30 + 2 * like.order):
        still = _slopes(residual, unknowns, None)
        J = np.stack([_slopes(residual, unknowns, k) - still for k in range(len(unknowns))], axis=-1)
        r = np.stack([each.coefficients for each in residual(*unknowns)], axis=-1)
        step = np.linalg.solve(J[None], r[..., None])[..., 0]
        unknowns = [Jet(x.coefficients[: len(step)] - step[..., k]) for k, x in enumerate(unknowns)]
    return unknowns


def _slopes(residual: Callable[..., Sequence[Jet]], unknowns: Sequence[Jet], moving: int | None) -> np.ndarray:
    """Rates of the residuals while one unknown moves at unit rate, and the path as it does; shape (N, rows)."""
    at = [Jet(np.stack([x.value, np.full_like(x.value, float(k == moving))])) for k, x in enumerate(unknowns)]
    return np.stack([each.coefficients[1] for each in residual(*at)], axis=-1)
