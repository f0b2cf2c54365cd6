"""Inversions of many cases in one call: other parameters, other paths, arrays in and arrays out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidModel, InvalidReference, InvalidSetting, ServocoreError, require_kind
from servocore.model.scene import Scene, require_scene
from servocore.model.symbols import Parameter
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.references.base import Reference, numbers_of
from servocore.solvers.dynamic_inversion import DynamicInversion
from servocore.solvers.solve import solve
from servocore.stepping.observation import observed
from servocore.stepping.prescribed_initial_values import require_start
from servocore.stepping.readings import exact_quantities


class Batch:
    """Exact inversion of many cases of one scene at the same instants.

    A case has parameter values of its own, a path of its own, or both. Machine code evaluates all instants of all
    cases at the cost per instant of a single case, in as many threads as there are processors. A call does not check
    limits: request the limited quantities and compare. With internal dynamics it steps every case as
    `DynamicInversion` does, from its start, and compares with smaller steps. `solve` solves and checks every case as
    `servocore.solve` does, and takes as long.

    Parameters
    ----------
    scene : Scene
        Without internal dynamics, or with stable ones.
    quantities : sequence of str, optional
        Names of quantities that `solve` reports; the inputs when not given.
    model : str, optional
        Model of the scene; its smallest when not given.
    tolerance : float
        With internal dynamics: largest error of any input, relative to its peak.
    start : mapping of str to float, optional
        With internal dynamics: their initial values, as for `solve`.
    native : bool, optional
        Whether as machine code; see `ExactInversion`.

    Attributes
    ----------
    names : tuple of str
        Quantities along the last axis of a result.

    Raises
    ------
    InvalidModel
        If the scene follows a branch, or has no quantity of a name.
    ServocoreError
        As `DynamicInversion` for a scene with internal dynamics.

    Examples
    --------
    >>> import numpy as np
    >>> import servocore as sc
    >>> batch = sc.Batch(sc.scenes.rotary_crane(), ("M_b", "F", "l"))
    >>> values = batch(np.linspace(0.0, 20.0, 201), parameters={"load_mass": np.linspace(50.0, 150.0, 1000)})
    >>> values.shape
    (1000, 201, 3)
    >>> batch.solve({"load_mass": [80.0, 120.0]}, steps=40).shape
    (2, 41, 3)
    """

    def __init__(
        self,
        scene: Scene,
        quantities: Sequence[str] | None = None,
        model: str | None = None,
        *,
        tolerance: float = 1e-6,
        start: Mapping[str, float] | None = None,
        native: bool | None = None,
    ) -> None:
        require_scene(scene, "Batch")
        self._problem = problem = Problem.of(scene, model, start)
        self._scene, self._solve_case = scene, partial(solve, model=model, start=start, native=native)
        if problem.follow_branch:
            raise InvalidModel(f"{scene.name} follows a branch: its cases are solved one by one, with solve")
        if problem.start:
            require_start(problem)
        known = {quantity.name for quantity, _ in observed(problem.system)}
        self.names = tuple(quantities or (quantity.name for quantity in problem.system.inputs))
        wrong = [name for name in self.names if name not in known]
        if wrong:
            raise InvalidModel(f"{scene.name} reports no {', '.join(wrong)}; it has {', '.join(sorted(known))}")
        self._dynamic: DynamicInversion | None = None
        if not problem.flat:
            self._dynamic = DynamicInversion(scene, model, tolerance=tolerance, start=start, native=native)
        else:
            positive = (quantity.name for quantity, _ in problem.resolved.must_be_positive)
            self._evaluation = exact_quantities(problem.resolved, (*self.names, *positive), native)
            self._evaluation.by_expression.prepare(problem.reference)

    def __call__(
        self,
        t: npt.ArrayLike,
        parameters: Mapping[str, npt.ArrayLike] | None = None,
        paths: Sequence[Reference] | None = None,
    ) -> Array:
        """Evaluate all cases at the times `t`.

        Parameters
        ----------
        t : array_like, shape (N,)
            Times in s, the same for all cases.
        parameters : mapping of str to array_like, shape (cases,) or ()
            Values in SI units; the scene's value for a parameter that is not given.
        paths : sequence of Reference, optional
            One a case; the scene's own path for all when not given.

        Returns
        -------
        ndarray, shape (cases, N, quantities)
            NaN where an instant is not solved, or on another branch of the equations than the one wanted; with internal
            dynamics, for a case that does not keep the tolerance.

        Raises
        ------
        InvalidModel
            If there is no such parameter, or a value lies outside its bounds.
        InvalidReference
            If a path lacks derivatives; with internal dynamics, if a time lies outside a path.
        InvalidSetting
            If parameters and paths are of different number.
        """
        times = numbers_of(t, "the times of a batch").reshape(-1)
        p, references = self._cases(parameters, paths)
        if self._dynamic is not None:
            return self._dynamic.of_cases(self.names, references, times, p).transpose(0, 2, 1)
        if not (times.size and len(p)):
            return np.empty((len(p), times.size, len(self.names)))
        inputs = self._evaluation.of_cases(references, times, p)[0]
        values, signs = inputs[:, : len(self.names)], inputs[:, len(self.names) :]
        # Written so that NaN counts as the wrong branch.
        if not (signs > 0.0).all():
            values = np.where((signs > 0.0).all(axis=1, keepdims=True), values, np.nan)
        return values.transpose(0, 2, 1)

    def solve(
        self,
        parameters: Mapping[str, npt.ArrayLike] | None = None,
        paths: Sequence[Reference] | None = None,
        *,
        steps: int = 200,
    ) -> Array:
        """Solve all cases as `servocore.solve` does each by default, with all its checks.

        Parameters
        ----------
        parameters : mapping of str to array_like, shape (cases,) or ()
            As for a call.
        paths : sequence of Reference, optional
            As for a call.
        steps : int
            Into how many steps each path is divided; instants lie evenly from its start to its end.

        Returns
        -------
        ndarray, shape (cases, steps + 1, quantities)
            The results of `servocore.solve` for each case.

        Raises
        ------
        ServocoreError
            Of the kind that `servocore.solve` raises for the first case that it refuses, with its number from 0 on.
        InvalidSetting
            If there is not one step or more, or parameters and paths are of different number.
        """
        require_kind(steps, int, "the steps of a batch", "a whole number", InvalidSetting)
        if steps < 1:
            raise InvalidSetting(f"a path is divided into one step or more, not {steps}")
        p, references = self._cases(parameters, paths)
        values_of_cases = np.empty((len(p), steps + 1, len(self.names)))
        for case, row in enumerate(p.tolist()):
            values = zip(self._problem.system.parameters.names, row, strict=True)
            path = references[case % len(references)]
            scene = replace(self._scene, parameters=dict(values), reference=path)
            try:
                solution = self._solve_case(scene, step=path.duration / steps)
            except ServocoreError as error:
                raise type(error)(f"case {case} of a batch: {error}") from None
            values_of_cases[case] = np.column_stack([solution[name] for name in self.names])
        return values_of_cases

    def _cases(
        self, parameters: Mapping[str, npt.ArrayLike] | None, paths: Sequence[Reference] | None
    ) -> tuple[Array, list[Reference]]:
        """Return parameters (cases, size), and one path a case or one for all; the problem's where none are given."""
        references, given = [*(paths or (self._problem.reference,))], parameters or {}
        quantities = {name: k for k, name in enumerate(self._problem.system.parameters.names)}
        columns = {name: np.asarray(values, dtype=np.float64) for name, values in given.items()}
        for name, values in columns.items():
            if name not in quantities:
                raise InvalidModel(f"{self._problem.name} has no parameter {name}; it has {', '.join(quantities)}")
            _require_allowed(self._problem.system.parameters.declared[quantities[name]], values)
        sizes = {values.size for values in columns.values() if values.ndim}
        if len(sizes) > 1 or any(values.ndim > 1 for values in columns.values()):
            raise InvalidSetting("parameters of a batch are single values, or rows of one length")
        p = np.tile(self._problem.p, (*(sizes or (len(references),)), 1))
        for name, values in columns.items():
            p[:, quantities[name]] = values
        for reference in references:
            require_kind(reference, Reference, "each path of a batch", "a Reference", InvalidReference)
        if paths and len(references) != len(p):
            raise InvalidSetting(f"a batch of {len(p)} sets of parameters has one path a set, not {len(references)}")
        return p, references


def _require_allowed(parameter: Parameter, values: Array) -> None:
    """Raise `InvalidModel` for the first value of a parameter that it must not have, with the number of its case."""
    allowed = np.isfinite(values) & (values >= parameter.lower) & (values <= parameter.upper)
    if not allowed.all():
        case = int(np.argmin(allowed))
        try:
            parameter.check(float(values.ravel()[case]))
        except InvalidModel as error:
            raise InvalidModel(f"case {case} of a batch: {error}" if values.ndim else str(error)) from None
