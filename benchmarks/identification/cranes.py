"""Random cranes, their logs, and plants with effects that the model lacks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

import servocore as sc
from servocore.effects.position_loops import measured_in

COMMON = ("trolley_mass", "load_mass", "winch_inertia", "trolley_friction", "winch_friction", "viscous_share")
KINDS = {
    "rotary_crane": ("bridge_inertia", "bridge_friction", *COMMON),
    "overhead_crane": COMMON,
    "gantry_crane": ("bridge_mass", "bridge_friction", *COMMON),
}
WRONG = ("friction", "wind", "elastic rope", "Stribeck", "unequal shares")
"""What the model lacks: all friction, an effect of the scene, or the kind of friction that its drives have."""

_STRIBECK, _SLOW = 0.3, 0.05  # of dry friction more at rest, gone at some rate in m/s or rad/s
_UNEQUAL = (0.5, -0.5, 0.5)  # change of the viscous friction of each drive


@dataclass(frozen=True)
class OtherFriction:
    """A model whose drives have more friction than `friction` says."""

    make: Callable[[], sc.MechanicalSystem]
    drives: tuple[str, ...]
    stribeck: bool

    def __call__(self) -> sc.MechanicalSystem:
        """Assemble the model."""
        system = self.make()
        p, (_, y) = system.parameters, measured_in(system, self.drives)
        rates, more = ca.jtimes(y, system.q, system.v), []
        for k, name in enumerate(each for each in p.names if each.endswith("_friction")):
            rate = rates[k]
            peak = _STRIBECK * ca.exp(-((rate / _SLOW) ** 2)) * ca.tanh(rate / p["creep"])
            more.append(p[name] * (peak if self.stribeck else _UNEQUAL[k] * p["viscous_share"] * rate))
        force = ca.mtimes(ca.jacobian(y, system.q).T, ca.vertcat(*more))
        return replace(system, force=system.force - force)


def multisine(scene: sc.Scene, random: np.random.Generator, duration: float = 20.0) -> sc.Reference:
    """Return seven random harmonics about home, from rest to rest, at most 1.2 m and 0.9 m/s^2 in every direction."""
    home = np.array(scene.model().home)
    t = np.arange(0.0, duration + 1e-9, 0.02)
    grown = np.clip(np.minimum(t, duration - t) / 2.0, 0.0, 1.0)
    window = grown**5 * (126 - 420 * grown + 540 * grown**2 - 315 * grown**3 + 70 * grown**4)
    positions = np.tile(home, (len(t), 1))
    for k in range(len(home)):
        order = np.arange(1, 8)
        size, phase = random.uniform(0.3, 1.0, 7) / order**0.7, random.uniform(0, 2 * np.pi, 7)
        sway = window * (size[:, None] * np.sin(2 * np.pi * order[:, None] * t / duration + phase[:, None])).sum(axis=0)
        faster = np.gradient(np.gradient(sway, t), t)
        positions[:, k] += sway * min(1.2 / np.abs(sway).max(), 0.9 / np.abs(faster).max())
    return sc.sampled(t[::2], positions[::2])


def crane(kind: str, random: np.random.Generator) -> tuple[sc.Scene, sc.Scene]:
    """Return a random plant, parameters times 1/1.5 to 1.5, and the scene as it is believed, wrong by up to 22 %."""
    base: sc.Scene = getattr(sc.scenes, kind)().with_effects("friction")
    default = base.parameter_values()
    true = {name: default[name] * 1.5 ** random.uniform(-1, 1) for name in KINDS[kind]}
    believed = {name: value * (1 + random.uniform(-0.22, 0.22)) for name, value in true.items()}
    return base.with_parameters(**true), base.with_parameters(**believed)


def sensors(family: str, random: np.random.Generator) -> dict[str, Any]:
    """Return the sensors of a family: good ones (A) or coarse ones (B)."""
    if family == "A":
        return {"step": float(random.choice([0.001, 0.002, 0.005])), "noise": random.uniform(0.003, 0.02)}
    faults = {"resolution": 2e-4, "delay": random.uniform(0.0, 0.008), "outliers": 0.01, "missing": 0.03}
    return {"step": float(random.choice([0.005, 0.01])), "noise": random.uniform(0.005, 0.03), **faults}


def changed(plant: sc.Scene, wrong: str) -> sc.Scene:
    """Return a plant with an effect that the model lacks."""
    if wrong in ("", "friction"):
        return plant
    if wrong in ("Stribeck", "unequal shares"):
        (make,) = plant.models.values()
        return replace(plant, models={wrong: OtherFriction(make, plant.effects.measured, wrong == "Stribeck")})
    return plant.with_effects(wrong)


def without_friction(kind: str, believed: sc.Scene) -> tuple[sc.Scene, tuple[str, ...]]:
    """Return the scene that lacks all friction, and the names of its parameters."""
    own: sc.Scene = getattr(sc.scenes, kind)()
    names = tuple(name for name in KINDS[kind] if name in own.model().parameters.names)
    values = believed.parameter_values()
    return own.with_parameters(**{name: values[name] for name in names}), names
