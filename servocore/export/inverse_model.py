"""`InverseModel`: the exported inverse model of a scene, as one value from which other modules write source files.

Its `Mathematics` is a set of CasADi functions, written as C that includes <math.h> only: pure functions without
globals or allocation, and with a bounded number of iterations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.export.native_model import Bound, NativeModel
from servocore.model.quantity import Quantity


@dataclass(frozen=True, eq=False)
class Mathematics:
    """Functions of flat arguments; a path is (m, orders), column after column, parameters p.

    Attributes
    ----------
    functions : mapping of str to casadi.Function
        ``begin`` (path, p, time, move of the internal states) -> (state, outputs, margins, residual), and its
        ``begin_tangent`` (..., d path, d p) -> (d state, d outputs). Without a state ``quick`` (path, p, time) ->
        (margins, outputs), NaN where ``begin`` must be called. With a state ``advance`` (state, paths at the nodes,
        h, p, time at the beginning) -> (state, outputs, margins, residual), and its ``advance_tangent`` (..., d state,
        d paths, d p) -> (d state, d outputs).
    outputs : tuple of Quantity
        Computed quantities.
    limits : tuple of Bound
        The bounds of the margins.
    orders : int
        Number of derivatives of the path among the arguments, the path itself included.
    state_size : int
        Numbers kept from step to step; 0 where instants are independent.
    nodes : tuple of float
        Fractions of a step at which the path is needed.
    depends : ndarray of bool, shape (outputs, m * orders)
        Which outputs depend on which numbers of the path.
    """

    functions: Mapping[str, ca.Function]
    outputs: tuple[Quantity, ...]
    limits: tuple[Bound, ...]
    orders: int
    state_size: int
    nodes: tuple[float, ...]
    depends: npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False, kw_only=True)
class InverseModel(NativeModel):
    """The inverse model of a scene, ready to be written to files.

    Attributes
    ----------
    mathematics : Mathematics
        Its functions.
    components : int
        Of the path.
    method : str
        Name of the method for internal dynamics; empty where there are none.
    """

    mathematics: Mathematics
    components: int
    method: str
