"""Fekete points: twenty particles that repel each other on the unit sphere and are damped, of the test set of Bari.

Written from its report (Bendtsen and Thomsen; release 2.4 of the set): p'' = -p'/2 + 2 lam p + sum (p - p_j)/d_j^2,
|p|^2 = 1, from rest to t = 1000, where all has come to rest in an equilibrium; 160 unknowns with the multipliers of
the constraints and of their rates. `END` are the positions that the set publishes, by Radau5 at 1e-12.
"""

from __future__ import annotations

from functools import cache
from itertools import combinations

import casadi as ca
import numpy as np
from outside.ivp import free
from outside.paths import Steady

import servocore as sc
from servocore.dae import Dae, Equation, Unknown
from servocore.numerics.compiled_calls import Array

COUNT, DAMPING, DURATION = 20, 0.5, 1000.0
_RINGS = ((3, 3 / 8, 1 / 13, 1), (7, 1 / 8, 1 / 29, 1), (6, -2 / 15, 1 / 7, 1), (4, -3 / 10, 1 / 17, 0))
"""Particles on a circle of latitude, their latitude and first longitude in pi, and number of the first particle."""


def start() -> Array:
    """Return the positions at the beginning, shape (20, 3)."""
    points = []
    for count, latitude, turn, first in _RINGS:
        longitude = 2 * np.pi * np.arange(first, first + count) / count + np.pi * turn
        up = np.full(count, np.pi * latitude)
        points.append(np.column_stack([np.cos(longitude) * np.cos(up), np.sin(longitude) * np.cos(up), np.sin(up)]))
    return np.vstack(points)


def _repulsion(square: ca.SX) -> ca.SX:
    """Return the energy of two particles at the square of a distance."""
    return -ca.log(square) / 2


@cache
def particles() -> sc.MechanicalSystem:
    """Return the particles as a mechanical system with an input that stays zero."""
    q = sc.Coordinates(*(sc.Quantity(f"p_{k}.{axis}", "m") for k in range(1, COUNT + 1) for axis in "xyz"))
    points = ca.vertsplit(q.q, 3)
    pairs = [(_repulsion, ca.sumsqr(a - b)) for a, b in combinations(points, 2)]
    return free(
        "fekete points", q, 0, mass=ca.SX.eye(3 * COUNT), potential=sc.Potential(0.0, pairs), force=-DAMPING * q.v,
        constraints=ca.vertcat(*(ca.sumsqr(point) - 1 for point in points)), guess=ca.SX(start().ravel()),
        home=(float(start()[0, 0]),),
    )  # fmt: skip


def scene() -> sc.Scene:
    """Return the scene, for `simulate`."""
    return sc.Scene("fekete", {"points": particles}, Steady.of((float(start()[0, 0]),), (0.0,), DURATION))


def at_rest() -> dict[str, float]:
    """Return the whole initial state by name."""
    names = particles().coordinates.names
    return dict(zip(names, start().ravel().tolist(), strict=True)) | {f"{name}_dot": 0.0 for name in names}


def consistent() -> Array:
    """Return all unknowns of the stabilized form at the beginning: at rest, held by the multipliers."""
    system, points = particles(), start()
    forces = -np.asarray(ca.Function("bias", [system.q, system.v], [system.bias])(points.ravel(), np.zeros(60)))
    multipliers = (forces.reshape(-1, 3) * points).sum(axis=1) / 2
    return np.concatenate([points.ravel(), np.zeros(60), multipliers, np.zeros(COUNT)])


@cache
def stabilized() -> Dae:
    """Return the test set's formulation of index 2 (Gear, Gupta and Leimkuhler): 120 and 40 unknowns."""
    system = particles()
    n, m, mu = len(system.coordinates), system.lam.numel(), ca.SX.sym("mu", system.lam.numel())
    kinds = [(f"q.{name}", 0) for name in system.coordinates.names] + [
        (f"q.{name}", 1) for name in system.coordinates.names
    ]
    others = [f"{kind}.{k + 1}" for kind in ("lam", "mu") for k in range(m)]
    return Dae(
        name="stabilized, fekete points",
        x=ca.vertcat(system.q, system.v),
        z=ca.vertcat(system.lam, mu),
        H=ca.SX.eye(2 * n),
        f=ca.vertcat(system.v - ca.mtimes(system.G.T, mu), -system.bias - ca.mtimes(system.G.T, system.lam)),
        h=ca.vertcat(system.constraints, ca.mtimes(system.G, system.v)),
        gamma=ca.SX.sym("gamma", 1, 1),
        p=ca.SX(0, 1),
        unknowns=(*(Unknown(*kind) for kind in kinds), *(Unknown(name) for name in others)),
        equations=tuple(Equation(f"row {k}", level) for k, level in enumerate([1] * n + [2] * n + [0] * m + [1] * m)),
        physical={},
        index=2,
    )


END = np.array([
    -0.4070263380333202, 0.3463758772791802, 0.8451942450030429, 0.7752934752521549e-01, -0.2628662719972299,
    0.9617122871829146, 0.7100577833343567, 0.1212948055586120, 0.6936177005172217, 0.2348267744557627,
    0.7449277976923311, 0.6244509285956391, -0.4341114738782885, 0.8785430442262876, 0.1992720444237660,
    -0.9515059600312596, 0.2203508762787005, 0.2146669498274008, -0.6385191643609878, -0.4310833259390688,
    0.6375425027722121, -0.1464175087914336, -0.9380871635228862, 0.3139337298744690, 0.5666974065069942,
    -0.6739221885076542, 0.4740073135462156, 0.9843259538440293, -0.1696995357819996, -0.4800504290609090e-01,
    0.1464175087914331, 0.9380871635228875, -0.3139337298744656, -0.7092757549979014, 0.5264062637139616,
    -0.4688542938854929, -0.8665731819284478, -0.4813878059756024, -0.1315929352982178, -0.2347897778700538,
    -0.8594340408013130, -0.4541441287957579, 0.5530976940074118, -0.7674370265615124, -0.3242273140037833,
    0.7711050969896927, 0.6357041816577034, 0.3573685519777001e-01, 0.7103951209379591, 0.2403570431280519,
    -0.6614886725910596, -0.3038208738735660e-01, 0.4501923293640461, -0.8924145871442046, -0.5772996158107093,
    -0.1766763414971813, -0.7971892020969544, 0.2414481766969039, -0.3416456818373135, -0.9082846503446250,
]).reshape(COUNT, 3)  # fmt: skip
