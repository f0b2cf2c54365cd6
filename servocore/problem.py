"""Holonomic constraints that say what others say already: found, named and left out."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np

from servocore.structure.structural_analysis import specialised
from servocore.model.symbols import Array
from servocore.model.system import MechanicalSystem


@lru_cache(maxsize=256)
def _prepared(system: MechanicalSystem, p: tuple[float, ...]) -> tuple[MechanicalSystem, tuple[int, ...]]:
    values = np.array(p)
    dropped = tuple(redundant_constraints(system, values))
    kept = _without(system, dropped) if dropped else system
    return specialised(kept, values), dropped


@lru_cache(maxsize=64)
def _without(system: MechanicalSystem, dropped: tuple[int, ...]) -> MechanicalSystem:
    return without_constraints(system, list(dropped))


def prepared(system: MechanicalSystem, p: Array) -> tuple[MechanicalSystem, tuple[int, ...]]:
    """Return the system that is solved for the parameter values `p`, and the constraints left out of it.

    Redundant holonomic constraints are left out, and the structure is that of these values (`specialised`).
    """
    return _prepared(system, tuple(float(value) for value in p))


def redundant_constraints(system: MechanicalSystem, p: Array) -> list[int]:
    """Return the holonomic constraints that follow from the others, where all hold near the home configuration.

    Their number is that of the constraints less their rank; which ones are left out is a choice, the last where
    there is one (`servocore.numerics.constraint_ranks`).
    """
    return list(system.constraint_rank(p).redundant)


def without_constraints(system: MechanicalSystem, dropped: list[int]) -> MechanicalSystem:
    """Return the system without some of its holonomic constraints; their multipliers become zero."""
    kept = [k for k in range(system.lam.numel()) if k not in dropped]
    gone = system.lam[dropped]
    observables = {k: ca.substitute(e, gone, ca.SX.zeros(len(dropped))) for k, e in system.observables.items()}
    return replace(
        system,
        constraints=system.constraints[kept],
        multipliers=system.lam[kept],
        observables=observables,
        constraint_names=tuple(system.constraint_names[k] for k in kept if system.constraint_names),
    )
