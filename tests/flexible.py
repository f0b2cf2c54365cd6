"""Configurations and times of flexible bodies that tests compare with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from servocore.model.rotationless.flexible import Beam
from servocore.model.rotationless.parts import Frame, turned


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
