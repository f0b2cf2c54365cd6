"""Inputs of a scene with internal dynamics, prepared once: explicit steps of order eight, and machine code.

Of many cases, too, with other parameters and other paths, for `Batch`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from servocore.errors import IntegrationFailed, InvalidModel, InvalidReference
from servocore.model.scene import Scene, require_scene
from servocore.numerics.compiled_calls import Array, Places
from servocore.numerics.stepped_runs import Instants
from servocore.problem import Problem
from servocore.references.base import Reference, numbers_of
from servocore.solution import Solution
from servocore.solvers.route import require_inside, require_stable, require_tolerance
from servocore.solvers.solve import solve
from servocore.stepping.explicit_steps import ExplicitSteps, compile_explicit_steps
from servocore.stepping.prescribed_initial_values import start_unknowns

_FEWEST, _GROWTH, _MOST = 6, 1.25, 20_000  # steps that are tried
_ASTRAY = 1e-3  # of the peak of an input: so much beside the checked solution is another motion
_COMPARED = 51  # instants at which a case is compared with twice as many steps
_MOST_DOUBLINGS = 6  # of the steps that the scene itself takes


class DynamicInversion:
    """The inputs of a scene with internal dynamics, prepared once and integrated by every call.

    `ExactInversion` solves every instant independently; internal dynamics have to be integrated from their start. Once,
    the equations are compiled, `solve` runs the scene with all its checks, and the number of steps that keeps a
    tolerance of the inputs is determined. A call then runs machine code: it takes some hundredths of a millisecond,
    also at new instants.

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
        Names of the columns that a call returns.
    steps : int
        Of order eight, from the start of the path to its end.

    Raises
    ------
    InvalidModel
        If the model has no internal dynamics or unstable ones, or if their rates take iterations.
    IntegrationFailed
        If explicit steps do not keep the tolerance, as with stiff dynamics.
    ServocoreError
        As `solve`.

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
        require_tolerance(tolerance)
        self._problem = problem = Problem.of(scene, model, start)
        self._tolerance, self._native = tolerance, native
        if problem.flat:
            raise InvalidModel(f"{scene.name} has no internal dynamics: ExactInversion computes its inputs")
        require_stable(problem)
        self.inputs = tuple(quantity.name for quantity in problem.system.inputs)
        self._steps: ExplicitSteps = compile_explicit_steps(problem.resolved, problem.reference.formula, native)
        checked = solve(scene, model=model, start=start)
        self._start = self._starts([problem.reference], problem.p[None])[0]
        self._known: dict[bytes, Instants] = {}
        self.steps = self._enough(checked)
        self._run = self._steps.run([problem.reference], self.steps, problem.p, self._start)

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
        instants = self._instants(times)
        inputs, sound = self._steps.runs(self._run, instants)
        if not sound:
            require_inside(self._problem.reference, instants.t)
            raise IntegrationFailed(f"{self._problem.system.name}: the inputs belong to no motion that can be")
        return inputs[: len(self.inputs)].T.reshape(*times.shape, len(self.inputs))

    def _instants(self, times: Array) -> Instants:
        """Return times as instants; the last ones are kept, for callers often use the same table of times again."""
        key = times.tobytes()
        known = self._known.get(key)
        if known is None:
            t = np.frombuffer(key)  # and not the array, which the caller may change
            if self._steps.formula is None:
                require_inside(self._problem.reference, t)  # before the table is read
            known = self._steps.instants([self._problem.reference], t)
            self._known = {key: known}
        return known

    def of_cases(self, names: tuple[str, ...], references: Sequence[Reference], t: Array, p: Array) -> Array:
        """Return quantities of many cases, for `Batch`.

        Every case is compared with a run of twice as many steps, and takes these where it does not keep the tolerance.

        Parameters
        ----------
        names : tuple of str
            The quantities, as `solve` reports them.
        references : sequence of Reference
            One a case, or one for all.
        t : ndarray, shape (N,)
            Times in s within the paths.
        p : ndarray, shape (cases, size)
            Parameter values of each case.

        Returns
        -------
        ndarray, shape (cases, names, N)
            NaN for a case that is not solved.

        Raises
        ------
        InvalidReference
            If a time lies outside a path.
        """
        paths = [references[case % len(references)] for case in range(len(p))]
        inputs = np.full((len(p), len(names), len(t)), np.nan)
        groups: dict[object, list[int]] = {}
        for case, path in enumerate(paths):
            if len(t) and not (t.min() >= path.start_time and t.max() <= path.end_time):
                raise InvalidReference(
                    f"case {case} of a batch: its path runs from {path.start_time:g} s to {path.end_time:g} s, and the"
                    f" times from {t.min():g} s to {t.max():g} s"
                )
            groups.setdefault((path.formula, path.start_time, path.end_time), []).append(case)
        for group in groups.values():
            steps = compile_explicit_steps(self._problem.resolved, paths[group[0]].formula, self._native, names)
            self._solve(steps, inputs, np.array(group), [paths[case] for case in group], t, p[group])
        return inputs

    def _solve(
        self, steps: ExplicitSteps, inputs: Array, cases: Places, paths: list[Reference], t: Array, p: Array
    ) -> None:
        """Write the results of cases with paths of one kind into `inputs`; steps are doubled for those that need it."""
        compared = np.linspace(paths[0].start_time, paths[0].end_time, _COMPARED)
        start, count, size = self._starts(_of(paths, range(len(paths))), p), self.steps, len(self.inputs)
        left = np.flatnonzero(np.isfinite(start).all(axis=1))
        for _ in range(_MOST_DOUBLINGS):
            if not len(left):
                return
            tried = _of(paths, left)
            instants = steps.instants(tried, compared)
            errors = self._judged(steps, tried, count, p[left], start[left], instants)[1]
            good = errors <= self._tolerance
            taken = left[good]
            if len(taken):
                chosen = _of(paths, taken)
                values = steps.runs(steps.run(chosen, count, p[taken], start[taken]), steps.instants(chosen, t))[0]
                signs, wanted = np.split(values[:, size:], [-inputs.shape[1]], axis=1)
                inputs[cases[taken]] = np.where((signs > 0.0).all(axis=(1, 2), keepdims=True), wanted, np.nan)
            left, count = left[~good], 2 * count

    def _starts(self, paths: list[Reference], p: Array) -> Array:
        """Return the first states of the internal dynamics, (cases, states), NaN where none are found."""
        problem, order = self._problem, self._problem.array.reference_order
        jets = np.stack([path.jet(path.start_time, order) for path in paths])
        found = start_unknowns(problem, np.tile(jets, (len(p) // len(paths), 1, 1)), p)[0]
        return np.ascontiguousarray(found[problem.array.places(problem.array.states)].T)

    def _judged(
        self, steps: ExplicitSteps, paths: list[Reference], count: int, p: Array, start: Array, instants: Instants
    ) -> tuple[Array, Array]:
        """Return inputs (..., inputs, N) by twice so many steps, and their largest relative change from so many."""
        with np.errstate(over="ignore", invalid="ignore"):  # so many steps may be unstable
            runs = (steps.runs(steps.run(paths, count * many, p, start), instants)[0] for many in (1, 2))
            coarse, fine = (values[..., : len(self.inputs), :] for values in runs)
            peaks = np.maximum(np.abs(fine).max(axis=-1), 1e-300)
            return fine, np.asarray((np.abs(fine - coarse).max(axis=-1) / peaks).max(axis=-1))

    def _enough(self, checked: Solution) -> int:
        """Return how many steps keep the tolerance, from comparisons with twice as many."""
        reference, inputs = self._problem.reference, len(self.inputs)
        instants, exact, count = self._instants(checked.t), checked.values[:, :inputs].T, float(_FEWEST)
        while count < _MOST:
            fine, error = self._judged(self._steps, [reference], round(count), self._problem.p, self._start, instants)
            if error <= self._tolerance:
                if not (np.abs(fine - exact) <= _ASTRAY * np.abs(exact).max(axis=1, keepdims=True)).all():
                    name = self._problem.system.name
                    raise IntegrationFailed(f"{name}: explicit steps lead to another motion than solve")
                return round(count)
            count = count * _GROWTH if error < 1e3 * self._tolerance else 2 * count
        raise IntegrationFailed(
            f"{self._problem.system.name}: {_MOST} explicit steps do not keep a tolerance of {self._tolerance:g}: the"
            " internal dynamics are stiff, and solve with RadauIIA steps them"
        )


def _of(paths: list[Reference], cases: Iterable[int]) -> list[Reference]:
    """Return the paths of some cases; one that all of them share once."""
    chosen = [paths[case] for case in cases]
    return chosen[:1] if all(path is chosen[0] for path in chosen) else chosen
