"""Several independent copies of a system as one system."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

import servocore as sc
from servocore.model.system import MAX_REFERENCE_ORDER


def copies(system: sc.MechanicalSystem, count: int) -> sc.MechanicalSystem:
    """Return `count` copies of a system with constraints and a guess; they have the parameters in common."""
    n, m, m_h = len(system.coordinates), len(system.inputs), system.lam.numel()
    coordinates = sc.Coordinates(
        *(replace(each, name=f"{each.name}_{i}") for i in range(count) for each in system.coordinates.quantities)
    )
    gamma = ca.SX.sym("gamma", count * m, MAX_REFERENCE_ORDER + 1)
    one = ca.Function(
        "one",
        [system.q, system.v, system.p, system.gamma],
        [
            system.mass,
            system.output,
            system.input_matrix,
            system.potential,
            system.force,
            system.constraints,
            system.guess,
        ],
    )
    own = [(slice(i * n, (i + 1) * n), slice(i * m, (i + 1) * m)) for i in range(count)]
    parts = [one(coordinates.q[k], coordinates.v[k], system.p, gamma[j, :]) for k, j in own]
    mass, output, input_matrix, potential, force, constraints, guess = zip(*parts, strict=True)
    return sc.MechanicalSystem(
        name=f"{count} times {system.name}",
        coordinates=coordinates,
        parameters=system.parameters,
        inputs=tuple(replace(each, name=f"{each.name}_{i}") for i in range(count) for each in system.inputs),
        outputs=tuple(replace(each, name=f"{each.name}_{i}") for i in range(count) for each in system.outputs),
        mass=ca.diagcat(*mass),
        output=ca.vertcat(*output),
        input_matrix=ca.diagcat(*input_matrix),
        potential=sum(potential),
        force=ca.vertcat(*force),
        constraints=ca.vertcat(*constraints),
        multipliers=ca.SX.sym("lam", count * m_h),
        gamma=gamma,
        guess=ca.vertcat(*guess),
        home=system.home * count,
    )


def cranes(count: int) -> tuple[sc.Scene, list[sc.Scene]]:
    """Return `count` gantry cranes in one scene, each with a path of its own, and each as a scene of its own."""
    crane = sc.scenes.gantry_crane()
    reference = crane.reference
    first, last = reference.jet(np.array([reference.start_time, reference.end_time]), 0)[:, 0]
    ends = [last - 0.5 * (last - first) * i / count for i in range(count)]
    system = copies(crane.model(), count)
    path = sc.rest_to_rest(tuple(np.tile(first, count)), tuple(np.concatenate(ends)), reference.duration)
    alone = [crane.with_reference(sc.rest_to_rest(tuple(first), tuple(end), reference.duration)) for end in ends]
    return sc.Scene(system.name, {"points": lambda: system}, path), alone
