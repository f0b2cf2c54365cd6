"""`InverseModel`: what is exported of a scene, as one value. Everything else here writes it down in some language.

Its `Mathematics` is a handful of CasADi functions, written as C that needs nothing but <math.h>: pure, with no memory
between calls, no globals, no allocation, and a bounded number of iterations.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.export.variables import INTERNAL_STEP, Causality, Variable
from servocore.model.quantity import Quantity


@dataclass(frozen=True)
class Bound:
    """What a limit sets to a quantity, and where the quantity stands.

    Attributes
    ----------
    quantity, unit, reason : str
        As of `Limit`; the reason may be empty.
    bound : float
        The number.
    side : float
        1 if the quantity must stay above it, -1 if below.
    row : int
        Which of the limits on what moves it belongs to; -1 for limits of the path.
    rate : bool
        Whether it is the rate of something, which is none where that has no direction.
    """

    quantity: str
    unit: str
    reason: str
    bound: float
    side: float
    row: int
    rate: bool = False

    @property
    def text(self) -> str:
        """The bound as a sentence without its end."""
        why = f"{self.reason}: " if self.reason else ""
        which = "above" if self.side > 0.0 else "below"
        return f"{why}{self.quantity} must stay {which} {self.bound:g} {self.unit}"


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
        (outputs, margins), NaN where ``begin`` has to be asked. With a state ``advance`` (state, paths at the nodes,
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
        return replace(self, functions={name: each for name, each in self.functions.items() if name in names})

    def scratch(self) -> dict[str, int]:
        """Return how much working memory the functions take, by kind."""
        return scratch_of(self.functions.values())


def c_source(name: str, functions: Iterable[ca.Function]) -> tuple[str, str]:
    """Return header and C source of functions, in files of a name."""
    generator = ca.CodeGenerator(f"{name}.c", {"with_header": True, "casadi_int": "int"})
    for function in functions:
        generator.add(function)
    with tempfile.TemporaryDirectory(prefix="servocore_") as folder:
        generator.generate(f"{folder}/")
        header, source = (Path(folder, f"{name}.{ending}").read_text(encoding="utf-8") for ending in "hc")
    return header, source


def scratch_of(functions: Collection[ca.Function]) -> dict[str, int]:
    """Return how much working memory the largest of some functions takes, by kind."""
    sizes = {"arguments": "sz_arg", "results": "sz_res", "integers": "sz_iw", "numbers": "sz_w"}
    return {kind: max(getattr(each, size)() for each in functions) for kind, size in sizes.items()}


@dataclass(frozen=True, eq=False)
class InverseModel:
    """The inverse model of a scene, ready to be written down.

    Attributes
    ----------
    identifier : str
        The scene's name as an identifier of C.
    title, model : str
        Names of scene and model.
    description : str
        One line.
    mathematics : Mathematics
        What it computes.
    variables : tuple of Variable
        Inputs, outputs, parameters and internal states, in the order of their numbers; without input_time.
    components : int
        Of the path.
    method : str
        What steps internal dynamics; empty where there are none.
    timed : bool
        Whether the equations hold the time.
    start_time, duration : float
        Of a default experiment, in s: along the scene's own path, from 0 where its equations do not hold the time.
    """

    identifier: str
    title: str
    model: str
    description: str
    mathematics: Mathematics
    variables: tuple[Variable, ...]
    components: int
    method: str
    timed: bool
    start_time: float
    duration: float

    @property
    def limits(self) -> tuple[Bound, ...]:
        """Where the scene ends."""
        return self.mathematics.limits

    @property
    def settings(self) -> tuple[Variable, ...]:
        """Parameters that are not the scene's: internal_step, and moves of the internal states."""
        return tuple(e for e in self.of("parameter") if e.fixed or e.name == INTERNAL_STEP)

    def of(self, causality: Causality) -> tuple[Variable, ...]:
        """Return the variables of one causality."""
        return tuple(each for each in self.variables if each.causality == causality)

    def token(self, *more: str) -> str:
        """Return an identifier that changes when, and only when, variables, mathematics or `more` do."""
        digest = hashlib.sha256(repr(self.variables).encode())
        for text in (*self.mathematics.source(), repr(self.limits), *more):
            digest.update(text.encode())
        code = digest.hexdigest()
        return f"{{{code[:8]}-{code[8:12]}-{code[12:16]}-{code[16:20]}-{code[20:32]}}}"
