"""Ranks of the Jacobians of a system, which tests of models ask for."""

from __future__ import annotations

import casadi as ca
import numpy as np

import servocore as sc


def has_independent_rows_at_home(system: sc.MechanicalSystem) -> bool:
    """Whether no holonomic constraint or servo output follows from the others at home."""
    rows = ca.substitute(ca.vertcat(system.G, system.C), system.time, ca.SX.zeros(system.time.shape))
    jacobian = np.asarray(ca.Function("rows", [system.q, system.p], [rows])(*system.home_configuration()))
    return bool(np.linalg.matrix_rank(jacobian) == len(jacobian))
