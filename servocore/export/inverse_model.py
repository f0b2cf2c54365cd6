"""`InverseModel`: what is exported of a scene, as one value. Everything else here writes it down in some language.

Its `Mathematics` is a handful of CasADi functions, written as C that needs nothing but <math.h>: pure, with no memory
between calls, no globals, no allocation, and a bounded number of iterations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.export.c_functions import c_source, scratch_of
from servocore.export.native_model import Bound, NativeModel
from servocore.model.quantity import Quantity


@dataclass(frozen=True, eq=False)
class Mathematics:
    """Functions of flat arguments; a path is (m, orders), column after column, parameters p.

    Attributes
    ----------
    identifier : str
        What the names of the functions begin with in C.
    functions : mapping of str to casadi.Function
        ``begin`` (path, p, time, move of the internal states) -> (state, outputs, margins, residual), and its
        ``begin_tangent`` (..., d path, d p) -> (d state, d outputs). Without a state ``quick`` (path, p, time) ->
        (margins, outputs), NaN where ``begin`` has to be asked. With a state ``advance`` (state, paths at the nodes,
        h, p, time at the beginning) -> (state, outputs, margins, residual), and its ``advance_tangent`` (..., d state,
        d paths, d p) -> (d state, d outputs).
    outputs : tuple of Quantity
        What they compute.
    limits : tuple of Bound
        What the margins belong to.
    orders : int
        How many derivatives of the path they take, the path itself included.
    state_size : int
        Numbers that a step hands to the next; 0 where every instant stands alone.
    nodes : tuple of float
        Fractions of a step at which the path is needed.
    depends : ndarray of bool, shape (outputs, m * orders)
        Which outputs depend on which numbers of the path.
    """

    identifier: str
    functions: Mapping[str, ca.Function]
    outputs: tuple[Quantity, ...]
    limits: tuple[Bound, ...]
    orders: int
    state_size: int
    nodes: tuple[float, ...]
    depends: npt.NDArray[np.bool_]

    @property
    def operations(self) -> int:
        """Instructions of the quick function, or of a step without its iterations."""
        return int(next(iter(self.functions.values())).n_instructions())

    def source(self) -> tuple[str, str]:
        """Return header and C source ``IDENTIFIER_mathematics``; all names in them begin with the identifier."""
        return c_source(f"{self.identifier}_mathematics", self.functions.values())

    def only(self, names: Sequence[str]) -> Mathematics:
        """Return the same with those functions only that are named."""
        return replace(self, functions={name: function for name, function in self.functions.items() if name in names})

    def scratch(self) -> dict[str, int]:
        """Return how much working memory the functions take, by kind."""
        return scratch_of(self.functions.values())


@dataclass(frozen=True, eq=False, kw_only=True)
class InverseModel(NativeModel):
    """The inverse model of a scene, ready to be written down.

    Attributes
    ----------
    mathematics : Mathematics
        What it computes.
    components : int
        Of the path.
    method : str
        What steps internal dynamics; empty where there are none.
    """

    mathematics: Mathematics
    components: int
    method: str
