"""Configurations and times of flexible bodies that tests compare with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from servocore.model.rotationless.flexible import Beam
from servocore.model.rotationless.parts import Frame, turned
from servocore.numerics.compiled_calls import Array
from servocore.references.base import Reference
from servocore.scenes.elastic_bar import PARAMETERS


def wave_time(parameters: Mapping[str, float]) -> float:
    """Return L/c, the time in s that a wave needs from one end of the bar to the other."""
    return parameters["length"] * float(np.sqrt(parameters["line_mass"] / parameters["axial_stiffness"]))


def unstrained(beam: Beam, place: Frame) -> list[tuple[ca.SX, ca.SX]]:
    """Return the configuration of a beam without strains that begins at a frame: (position, directors) of nodes."""
    step, curved = beam.length / beam.elements, float(np.linalg.norm(beam.curvature))
    turn: Any = turned(beam.curvature, ca.asin(curved * step)) if curved else ca.SX.eye(3)
    nodes = [(place.origin, place.directors)]
    for _ in range(beam.elements):
        origin, directors = nodes[-1]
        after = ca.mtimes(directors, turn)
        middle = (directors + after) / 2
        nodes.append((origin + step * ca.solve(middle.T, ca.SX([0, 0, 1])), after))
    return nodes


def dalembert(
    t: Array, reference: Reference, parameters: Mapping[str, float], section: float | None = None
) -> dict[str, Array]:
    """Exact solution of the continuous bar at one of its sections, when the free end follows the path.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times in s, also before the start of the path and after its end.
    reference : Reference
        Path of the free end, with two derivatives, at rest before and after.
    parameters : mapping of str to float
        All four parameters.
    section : float, optional
        X in m, distance from the free end; the driven end, X = L, when not given.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        u, force through the section in N, positive in tension: at the driven end the input; w, its displacement in m.
    """
    length, axial_stiffness, line_mass, end_mass = (parameters[name] for name in PARAMETERS.names)
    speed = np.sqrt(axial_stiffness / line_mass)
    delay = (length if section is None else section) / speed
    early, late = (np.moveaxis(reference.jet(t + shift, 2)[..., 0], -1, 0) for shift in (delay, -delay))
    difference, total = early - late, early + late
    return {
        "u": axial_stiffness / (2 * speed) * difference[1] + end_mass / 2 * total[2],
        "w": total[0] / 2 + speed * end_mass / (2 * axial_stiffness) * difference[1],
    }
