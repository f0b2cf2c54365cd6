"""The elastic bar solved in space instead of time: from the tracked end, where everything is known, to the driven one.

The free end X = 0 of a bar follows a path and carries a mass m; the force at X = L that achieves this is the unknown.
Stepping in time needs higher derivatives of the path, the finer the bar is divided
(a chain of N masses has index 2 N + 1). But at X = 0 displacement, velocity v = gamma' and force N = m gamma'' are
known for *all* times, so the wave equation

    N_t = E A v_X,    rho A v_t = N_X

is a well-posed initial value problem in X over the whole horizon. Its characteristics run at the speed
c = sqrt(E A/(rho A)); on a grid with dX = c dt the leapfrog scheme

    v(X + dX, t) = (v(X, t + dt) + v(X, t - dt))/2 + (N(X, t + dt) - N(X, t - dt))/(2 Z)
    N(X + dX, t) = (N(X, t + dt) + N(X, t - dt))/2 + Z (v(X, t + dt) - v(X, t - dt))/2,    Z = rho A c,

follows them exactly: no error but round-off, however coarse the grid. Eliminating N gives the usual
v(X + dX, t) + v(X - dX, t) = v(X, t + dt) + v(X, t - dt). Displacement w and impulse, the integral of N over time,
obey the same equations. Values at t + dt make the answer begin L/c before the path does (pre-actuation), values at
t - dt make it end L/c after.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidReference, InvalidSetting, require_positive
from servocore.references.base import Reference

Array = npt.NDArray[np.float64]

_AT_REST = 1e-9  # of the path's mean speed


@dataclass(frozen=True, eq=False)
class BarMotion:
    """Motion of a bar on a grid in space and time.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times in s, from more than L/c before the path to more than L/c after it.
    X : ndarray, shape (pieces + 1,)
        Distances from the tracked end in m; the last is the driven end.
    displacement, velocity, force : ndarray, shape (pieces + 1, N)
        In m, m/s and N, the force positive in tension.
    """

    t: Array
    X: Array
    displacement: Array
    velocity: Array
    force: Array

    @property
    def input(self) -> Array:
        """Force on the driven end in N, shape (N,)."""
        return np.asarray(self.force[-1])


def march_bar(
    reference: Reference,
    *,
    length: float,
    axial_stiffness: float,
    line_mass: float,
    end_mass: float = 0.0,
    pieces: int = 100,
) -> BarMotion:
    """March a uniform elastic bar from its tracked free end to its driven end.

    Parameters
    ----------
    reference : Reference
        Path of the free end, one component in m, with two derivatives; at rest before its start and after its end.
    length, axial_stiffness, line_mass, end_mass : float
        L in m, E A in N, rho A in kg/m, and the mass m at the free end in kg.
    pieces : int
        Steps in space. They set the grid of the result (dt = L/(c pieces)), not its accuracy.

    Returns
    -------
    BarMotion
        Exact at its grid points up to round-off.

    Raises
    ------
    InvalidReference
        If the path has not one component, or does not start and end at rest.
    InvalidSetting
        If a length, stiffness or mass is not positive (the end mass may be zero), or there is no piece.
    """
    for name, value in (("length", length), ("axial stiffness", axial_stiffness), ("line mass", line_mass)):
        require_positive(value, f"the {name} of a bar", "a number")
    require_positive(end_mass, "the end mass of a bar", "a number", or_zero=True)
    if not (isinstance(pieces, int) and pieces >= 1):
        raise InvalidSetting(f"a bar is marched in one or more whole pieces, not {pieces}")
    if reference.dimension != 1:
        raise InvalidReference(f"the end of a bar follows a path with 1 component, this one has {reference.dimension}")
    require_rest(reference, "a bar")
    wave_speed = float(np.sqrt(axial_stiffness / line_mass))
    impedance = line_mass * wave_speed
    dt = length / (wave_speed * pieces)
    before = pieces + 1
    t = reference.start_time + dt * np.arange(-before, np.ceil(reference.duration / dt) + before + 1)
    w, v, a = reference.jet(t, 2)[:, :, 0].T
    sections = [np.array([[w, end_mass * v], [v, end_mass * a]])]
    for _ in range(pieces):
        sections.append(_one_piece(sections[-1], impedance))
    (displacement, _), (velocity, force) = np.stack(sections, axis=2)
    X = length * np.arange(pieces + 1) / pieces
    return BarMotion(t=t, X=X, displacement=displacement, velocity=velocity, force=force)


def _one_piece(values: Array, impedance: float) -> Array:
    """Carry (w, impulse) and (v, N), shape (2, 2, times), one piece further; outside the horizon the bar is at rest."""
    padded = np.pad(values, ((0, 0), (0, 0), (1, 1)), mode="edge")
    later, sooner = padded[..., 2:], padded[..., :-2]
    return (later + sooner) / 2.0 + (later - sooner)[:, ::-1] / 2.0 * [[1.0 / impedance], [impedance]]


def require_rest(reference: Reference, what: str) -> None:
    """Raise `InvalidReference` if a path does not rest before its start and after its end."""
    ends = np.array([reference.start_time, reference.end_time])
    scale = float(np.abs(np.diff(reference.jet(ends, 0)[:, 0], axis=0)).max()) / reference.duration
    outside = ends + np.array([-1.0, 1.0]) * reference.duration
    for time, speed in zip(outside, np.abs(reference.jet(outside, 1)[:, 1]).max(axis=1), strict=True):
        if speed > _AT_REST * max(scale, 1e-300):
            raise InvalidReference(f"{what} is marched from rest to rest, but its path still moves at t = {time:g} s")
