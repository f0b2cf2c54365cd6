"""The motion of a model along a path by whatever route suits it: instant by instant, or over all of the path."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from servocore.effects.model_inversion import Inverted, inverted
from servocore.effects.position_loops import measured_in
from servocore.model.scene import Scene
from servocore.numerics.compiled_calls import mapped
from servocore.problem import Problem
from servocore.solvers.solve import solve


def followed(scene: Scene, measured: tuple[str, ...], count: int) -> Inverted:
    """Return inputs and positions of drives that make a model follow the path of its scene.

    Those of a model with internal dynamics are the ones of `servocore.solve`: by integration of the internal dynamics,
    or where these are unstable by stable inversion, which begins before the path and ends after it.

    Parameters
    ----------
    scene : Scene
        The model, with the path.
    measured : tuple of str
        Quantities that the drives measure, by name.
    count : int
        Instants along the path.

    Raises
    ------
    IntegrationFailed
        If the motion is not found.
    """
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - kept out of the run time of an FMU

    problem = Problem.of(scene)
    if problem.flat:
        return inverted(problem, measured, count)
    system = problem.system
    found = solve(replace(scene, limits=()), step=problem.reference.duration / (count - 1), checks=False)
    rows = np.column_stack([found[each.name] for each in (*system.coordinates.quantities, *system.inputs)])
    q, inputs = np.split(rows, [len(system.coordinates)], axis=1)
    v = make_interp_spline(found.t, q, k=5).derivative()(found.t)
    quantities, y = measured_in(system, measured)
    read = ca.Function("sc_followed", [system.q, system.v], [y, ca.jtimes(y, system.q, system.v)])
    positions, rates = (each.reshape(-1, len(found.t), order="F").T for each in mapped(read, len(found.t))(q.T, v.T))
    wraps = [quantity.wraps for quantity in quantities]
    positions[:, wraps] = np.unwrap(positions[:, wraps], axis=0)
    return Inverted(problem, measured, found.t, inputs, positions - positions[0], rates, np.append(q[0], v[0]), q[-1])
