"""Feedforward for a load on a heavy elastic rope: the rope solved along its length, from the load to the carriage.

At the load, X = 0, position and tension of the rope are known for *all* times, so that the equations of an extensible
rope without bending,

    r_X = (1/|n| + 1/(E A)) n,    n_X = rho A (r_tt + g e_z),    r = gamma,  n = m (gamma'' + g e_z)  at X = 0,

are an initial value problem in X over the whole horizon. It is hyperbolic in both directions, its transverse waves run
at sqrt(|n|/(rho A |r_X|)), its longitudinal ones at sqrt(E A/(rho A)). Here r_tt is the central difference of fourth
order, and X is marched by the classical Runge-Kutta method of fourth order, whose steps are shorter than the slowest
wave travels in 0.6 of a step of time. Fast waves cost nothing: without extension (E A infinite) or without mass the
same march holds, for a massless rope it is one exact step. The forces of the carriage's drives,

    F = m_t (r_tt + g e_z) + n    at X = L,

begin a wave's travel time before the path and end as long after it (pre- and postaction).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from servocore.errors import InvalidReference, InvalidSetting, require_kind, require_positive
from servocore.numerics.compiled_calls import Array
from servocore.references.base import Reference
from servocore.scenes.bar_marching import require_rest
from servocore.scenes.heavy_rope import PARAMETERS

_SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0  # central difference of fourth order
_COURANT = 0.6  # of the way of the slowest wave at the load; Runge-Kutta and the difference are stable up to 1.22
_STABLE = 1.2
_FEWEST = 10  # steps along a path
_MOST = 1e7  # sections times instants: some hundreds of megabytes


@dataclass(frozen=True, eq=False)
class RopeMotion:
    """Motion of a rope on a grid of material points and times.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times in s, from more than a wave's travel time before the path to as long after it.
    X : ndarray, shape (sections,)
        Material coordinate in m, length of the rope without load from the load upwards.
    position, force : ndarray, shape (sections, N, d)
        Place in m, and the force in N that the rope above exerts on the rope below.
    inputs : ndarray, shape (N, d)
        Forces of the carriage's drives in N, by direction.
    travel_time : float
        Time in s that a transverse wave takes along the rope at rest.
    """

    t: Array
    X: Array
    position: Array
    force: Array
    inputs: Array
    travel_time: float


def march_rope(reference: Reference, parameters: Mapping[str, float], step: float = 0.01) -> RopeMotion:
    """March a heavy rope from its load, which follows a path, to its carriage.

    Parameters
    ----------
    reference : Reference
        Path of the load with 2 or 3 components in m, the last upwards; at rest before its start and after its end.
    parameters : mapping of str to float
        Those of `servocore.scenes.heavy_rope.PARAMETERS`; ``rope_mass`` may be 0, ``rope_stiffness`` infinite.
    step : float
        Step in s of the grid in time; errors fall with its fourth power where the path is smooth.

    Returns
    -------
    RopeMotion
        Of the whole rope, and the forces of the drives.

    Raises
    ------
    InvalidReference
        If the path has not 2 or 3 components, does not rest before and after, is so rough that the forces jump, or the
        rope goes slack.
    InvalidSetting
        If a parameter is missing or invalid, or the step is not positive, too long for the path, or so small that the
        grid would not fit into memory.
    """
    require_kind(parameters, Mapping, "the parameters of the march", "values by name", InvalidSetting)
    for name in PARAMETERS.names:
        value = parameters.get(name, np.nan)
        if not (name == "rope_stiffness" and value == np.inf):
            require_positive(value, f"{name} of the march", "a number", or_zero=name in ("trolley_mass", "rope_mass"))
    m_t, m, length, line_mass, axial, g = (float(parameters[name]) for name in PARAMETERS.names)
    require_positive(step, "the step of the march", "a time in s")
    _require_path(reference, order=3 if line_mass else 4)
    if step > reference.duration / _FEWEST:
        raise InvalidSetting(f"the step of the march, {step:g} s, is too long for a path of {reference.duration:g} s")
    up = np.zeros(reference.dimension)
    up[-1] = g
    travel_time = 2.0 * (np.sqrt(m + line_mass * length) - np.sqrt(m)) / np.sqrt(g * line_mass) if line_mass else 0.0
    longest = max(
        2.0 * travel_time, travel_time + length * np.sqrt(line_mass / axial)
    )  # waves of stretched ropes are slow
    margin = int(np.ceil(longest / step)) + 4 * len(_SECOND)
    _require_room(int(reference.duration / step) + 2 * margin)
    t = reference.start_time + step * np.arange(-margin, np.ceil(reference.duration / step) + margin + 1)
    gamma = reference.jet(t, 2)
    r, n = gamma[:, 0], m * (gamma[:, 2] + up)
    _require_taut(t, n[:, -1], 0.0, 0.0)
    pull = np.linalg.norm(n, axis=1).min()
    slowest = np.sqrt(pull / (1.0 + pull / axial) / line_mass) if line_mass else np.inf
    pieces = max(1, int(np.ceil(length / (_COURANT * slowest * step))))
    _require_room(len(t), pieces)
    h = length / pieces
    least = line_mass * (h / (_STABLE * step)) ** 2
    least /= 1.0 - least / axial  # tension at which the march would become unstable

    def rates(r: Array, n: Array) -> tuple[Array, Array]:
        return (1.0 / np.linalg.norm(n, axis=1, keepdims=True) + 1.0 / axial) * n, line_mass * (second(r, step) + up)

    sections = [(r, n)]
    for k in range(pieces):
        r_1, n_1 = rates(r, n)
        r_2, n_2 = rates(r + h / 2 * r_1, n + h / 2 * n_1)
        r_3, n_3 = rates(r + h / 2 * r_2, n + h / 2 * n_2)
        r_4, n_4 = rates(r + h * r_3, n + h * n_3)
        r, n = r + h / 6 * (r_1 + 2 * (r_2 + r_3) + r_4), n + h / 6 * (n_1 + 2 * (n_2 + n_3) + n_4)
        _require_taut(t, np.linalg.norm(n, axis=1), h * (k + 1), least)
        sections.append((r, n))
    position, force = (np.stack(each) for each in zip(*sections, strict=True))
    inputs = m_t * (second(r, step) + up) + n
    return RopeMotion(t, np.linspace(0.0, length, pieces + 1), position, force, inputs, float(travel_time))


def second(values: Array, step: float) -> Array:
    """Return the second derivative of samples (N, d) by central differences; before and after them all is at rest."""
    padded = np.pad(values, ((2, 2), (0, 0)), mode="edge")
    return np.asarray(sum(weight * padded[k : k + len(values)] for k, weight in enumerate(_SECOND)) / step**2)


def _require_room(instants: int, pieces: int = 1) -> None:
    if instants * pieces > _MOST:
        raise InvalidSetting(
            f"the march would have {instants:.3g} instants and {pieces} pieces of rope or more, too many for memory;"
            " choose a larger step"
        )


def _require_path(reference: Reference, order: int) -> None:
    if reference.dimension not in (2, 3):
        raise InvalidReference(f"a load on a rope needs a path with 2 or 3 components, not {reference.dimension}")
    require_rest(reference, "a rope")
    if reference.smoothness < order:
        raise InvalidReference(
            f"the drives of a rope {'with' if order == 3 else 'without'} mass need the path's derivative of order"
            f" {order}, but the path is continuous up to order {reference.smoothness} only: the forces would jump with"
            f" it; a law such as the polynomial of degree {2 * order + 1} is smooth enough"
        )


def _require_taut(t: Array, tension: Array, where: float, least: float) -> None:
    k = int(np.argmin(tension))
    if not tension[k] > least:
        raise InvalidReference(
            f"the rope goes slack at t = {t[k]:.6g} s, {where:.4g} m above the load: its tension falls to"
            f" {tension[k]:.4g} N; lengthen the duration of the path"
        )
