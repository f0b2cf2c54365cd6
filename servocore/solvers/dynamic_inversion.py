"""Inputs of a scene with internal dynamics, prepared once: explicit steps of order eight, and machine code."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from servocore.checks.internal_dynamics import NON_MINIMUM_PHASE, internal_dynamics
from servocore.errors import IntegrationFailed, InvalidModel, InvalidReference, InvalidSetting, require_real
from servocore.formulations.reduced import Reduced
from servocore.methods.backward_euler import BackwardEuler
from servocore.methods.collocation import RadauIIA
from servocore.model.scene import Scene, require_scene
from servocore.numerics.calls import Array
from servocore.problem import Problem
from servocore.references.base import numbers_of
from servocore.solution import Solution
from servocore.solvers.loop import begin
from servocore.solvers.solve import solve
from servocore.stepping.compilation import given_start_of, program_of
from servocore.stepping.explicit_steps import Along, ExplicitSteps, compile_explicit_steps

_FEWEST, _GROWTH, _MOST = 6, 1.25, 20_000  # steps that are tried
_INSTANTS = 201  # at which they are compared
_ASTRAY = 1e-3  # of the peak of an input: so much beside the checked solution is another motion


class DynamicInversion:
    """The inputs of a scene with internal dynamics, prepared once and integrated by every call.

    Where `ExactInversion` has every instant by itself, internal dynamics have to be integrated from their start. What
    can be done once is done once: the equations are compiled, `solve` looks at the scene with all its checks, and
    the number of steps is found that keeps a tolerance of the inputs. A call then takes a tenth of a millisecond.

    Parameters
    ----------
    scene : Scene
        With internal dynamics that are stable.
    model : str, optional
        Model of the scene; its smallest when not given.
    tolerance : float
        Largest error of any input, relative to its peak.
    start : mapping of str to float, optional
        Initial values of the internal dynamics, as for `solve`.
    native : bool, optional
        Whether as machine code; see `ExactInversion`.

    Attributes
    ----------
    inputs : tuple of str
        Names of the columns of what a call returns.
    steps : int
        Of order eight, from the start of the path to its end.

    Raises
    ------
    InvalidModel
        If the model has no internal dynamics or unstable ones, or if their rates take iterations.
    IntegrationFailed
        If explicit steps do not keep the tolerance, as with stiff dynamics.
    ServocoreError
        Whatever `solve` refuses the scene for.

    Examples
    --------
    >>> import numpy as np
    >>> import servocore as sc
    >>> inputs = sc.DynamicInversion(sc.scenes.passive_joint_arm(), tolerance=1e-6)
    >>> inputs(np.linspace(0.0, 2.0, 201)).shape
    (201, 1)
    """

    def __init__(
        self,
        scene: Scene,
        model: str | None = None,
        *,
        tolerance: float = 1e-6,
        start: Mapping[str, float] | None = None,
        native: bool | None = None,
    ) -> None:
        require_scene(scene, "DynamicInversion")
        require_real(tolerance, "the tolerance", "a number", InvalidSetting)
        if not 0.0 < tolerance < 1.0:
            raise InvalidSetting(f"the tolerance must lie between 0 and 1, not {tolerance}")
        self._problem = problem = Problem.of(scene, model, start)
        if problem.flat:
            raise InvalidModel(f"{scene.name} has no internal dynamics: ExactInversion computes its inputs")
        if internal_dynamics(problem).kind == NON_MINIMUM_PHASE:
            raise InvalidModel(f"{scene.name} has unstable internal dynamics: solve with BoundaryValue bounds them")
        self.inputs = tuple(each.name for each in problem.system.inputs)
        self._steps: ExplicitSteps = problem.resolved.once(compile_explicit_steps, problem.reference.formula, native)
        checked = solve(scene, Reduced(), RadauIIA(3), model=model, start=start)
        first, _ = begin(
            problem, program_of(problem, Reduced(), BackwardEuler()), 0.0, given_start_of(Reduced(), BackwardEuler())
        )
        self._start = first[: len(problem.array.states)]
        self._known: dict[tuple[int, bytes], Along] = {}
        self.steps = self._enough(checked, tolerance)

    def __call__(self, t: npt.ArrayLike) -> Array:
        """Integrate the internal dynamics, and return the inputs at the times `t`.

        Parameters
        ----------
        t : array_like, shape (N,) or ()
            Times in s between start and end of the path, in any order.

        Returns
        -------
        ndarray, shape (N, inputs) or (inputs,)
            In the units of the scene's inputs.

        Raises
        ------
        InvalidReference
            If a time lies outside the path.
        IntegrationFailed
            If a value is no number, or has a sign that it must not have.
        """
        times = numbers_of(t, "the times of inputs")
        flat, reference = times.reshape(-1), self._problem.reference
        if len(flat) and not (flat.min() >= reference.start_time and flat.max() <= reference.end_time):
            raise InvalidReference(
                f"inputs follow from the motion since the start: times lie between {reference.start_time:g} s and"
                f" {reference.end_time:g} s, not from {flat.min():g} s to {flat.max():g} s"
            )
        found = self._integrated(flat, self.steps)
        if not (found[len(self.inputs) :] > 0.0).all() or not np.isfinite(found).all():
            raise IntegrationFailed(f"{self._problem.system.name}: the inputs belong to no motion that can be")
        return found[: len(self.inputs)].T.reshape(*times.shape, len(self.inputs))

    def _integrated(self, t: Array, count: int) -> Array:
        """Return inputs and what must be positive, (columns, N), by some number of steps."""
        key = count, t.tobytes()
        if key not in self._known:  # tables of instants are asked for again and again
            self._known = {key: self._steps.along(self._problem.reference, t, count)}
        return self._steps.inputs_along(self._known[key], self._problem.p, self._start)

    def _enough(self, checked: Solution, tolerance: float) -> int:
        """Return how many steps keep the tolerance, from comparisons with twice as many."""
        reference, inputs = self._problem.reference, len(self.inputs)
        t, count = np.linspace(reference.start_time, reference.end_time, _INSTANTS), float(_FEWEST)
        exact = checked.values[:: (len(checked.t) - 1) // (_INSTANTS - 1), :inputs].T
        peaks = np.maximum(np.abs(exact).max(axis=1), 1e-300)
        while count < _MOST:
            with np.errstate(over="ignore", invalid="ignore"):  # so many steps may be unstable
                coarse, fine = (self._integrated(t, round(count) * many)[:inputs] for many in (1, 2))
                error = (np.abs(fine - coarse).max(axis=1) / peaks).max()
            if error <= tolerance:
                if not (np.abs(fine - exact).max(axis=1) <= _ASTRAY * peaks).all():
                    name = self._problem.system.name
                    raise IntegrationFailed(f"{name}: explicit steps lead to another motion than solve")
                return round(count)
            count = count * _GROWTH if error < 1e3 * tolerance else 2 * count
        raise IntegrationFailed(
            f"{self._problem.system.name}: {_MOST} explicit steps do not keep a tolerance of {tolerance:g}: the"
            " internal dynamics are stiff, and solve with RadauIIA steps them"
        )
