"""Inputs on any form by any method, prepared once: whole runs of long steps, read between them.

All steps of a run, with Newton's method in each, are one call of CasADi's interpreter or of machine code. Steps may be
long, since the method's own polynomial answers between them; `solve` takes a step for every reported instant instead,
and checks every run.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from numbers import Integral

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import (
    InconsistentStart,
    IntegrationFailed,
    InvalidModel,
    InvalidReference,
    InvalidSetting,
    require_formulation,
    require_kind,
    require_method,
)
from servocore.formulations.base import Formulation
from servocore.formulations.reduced import Reduced
from servocore.methods.base import Method
from servocore.model.scene import Scene, require_scene
from servocore.numerics.compiled_calls import Array, Places, call_of, side_by_side
from servocore.numerics.just_in_time import in_machine_code
from servocore.numerics.memoization import made_once
from servocore.numerics.newton import NEWTON_TOLERANCE
from servocore.problem import Problem
from servocore.references.base import Reference, numbers_of, time_grid
from servocore.solution import Solution
from servocore.solvers.fixed_step import BETTER_METHOD, FixedStep
from servocore.solvers.route import require_inside, require_stable, require_tolerance
from servocore.solvers.runs import first_state
from servocore.solvers.solve import solve
from servocore.stepping.program import Program, program_of
from servocore.stepping.step_functions import compile_bare_step

_FEWEST, _GROWTH, _MOST = 4, 1.15, 2000  # elements that are tried
_DIVERGED = 100.0  # times the least error, with several times as many elements: round-off grows
_LOOSE = 3e-3  # of the root of a tolerance, for corrections of Newton's method
_MOST_LOOPS = 32  # functions of whole runs that are kept


def prepare(
    scene: Scene,
    formulation: Formulation,
    method: Method,
    *,
    elements: int | None = None,
    tolerance: float | None = None,
    model: str | None = None,
    start: Mapping[str, float] | None = None,
    native: bool | None = None,
) -> PreparedInversion:
    """Prepare runs of a form by a method, to be called with instants, parameters and paths.

    Once, `solve` runs the scene on the reduced form with all its checks, and the fewest elements are determined
    with which all inputs agree with it to the tolerance. Local error control would fail on forms of index 3, where
    steps that vary add an error that does not fall with them.

    Parameters
    ----------
    scene : Scene
        With its reference and parameters; its internal dynamics, if any, must be stable.
    formulation, method : Formulation, Method
        Form, of index one or more, and method: the more stages, the longer its steps may be.
    elements : int, optional
        Number of steps from start to end of a path, whatever the error.
    tolerance : float, optional
        Largest error of any input, relative to its peak, at any instant; 1e-6 when neither is given.
    model : str, optional
        Model of the scene; its smallest when not given.
    start : mapping of str to float, optional
        Initial values of the internal dynamics, as for `solve`.
    native : bool, optional
        Whether as machine code; see `ExactInversion`.

    Returns
    -------
    PreparedInversion
        A function of instants, parameters and a path.

    Raises
    ------
    InvalidSetting
        If both elements and a tolerance are given, or a value is out of range.
    InvalidModel
        If the form has nothing to integrate, or the internal dynamics are unstable.
    IntegrationFailed
        If no number of elements keeps the tolerance, with the least error found.
    ServocoreError
        As `solve`.

    Examples
    --------
    >>> import numpy as np
    >>> import servocore as sc
    >>> crane = sc.scenes.rotary_crane()
    >>> run = sc.prepare(crane, sc.Projected(), sc.RadauIIA(7), elements=40)
    >>> run.inputs, run(np.linspace(0.0, 20.0, 201)).shape, bool(run.error < 1e-4)
    (('M_b', 'F', 'M_w'), (201, 3), True)
    >>> run([0.0, 10.0], {"load_mass": 80.0}).shape
    (2, 3)
    """
    require_scene(scene, "prepare")
    require_formulation(formulation)
    require_method(method, routes=False)
    if elements is not None:
        require_kind(elements, Integral, "the number of elements", "a whole number", InvalidSetting)
        if tolerance is not None or not 0 < elements <= _MOST:
            raise InvalidSetting(f"prepare takes a tolerance, or 1 to {_MOST} elements: not {tolerance} and {elements}")
    tolerance = 1e-6 if tolerance is None else tolerance
    require_tolerance(tolerance)
    problem = Problem.of(scene, model, start)
    if not problem.dae(formulation).x.numel():
        raise InvalidModel(f"{scene.name} has nothing to integrate on this form: ExactInversion computes its inputs")
    require_stable(problem)
    exact = solve(scene, Reduced(), BETTER_METHOD, model=model, start=start)
    newton = NEWTON_TOLERANCE
    if elements is None:
        elements, newton = _fewest(problem, FixedStep(formulation, method, native=False), exact, tolerance)
    return PreparedInversion(problem, FixedStep(formulation, method, native), exact, int(elements), newton)


def _fewest(problem: Problem, route: FixedStep, exact: Solution, tolerance: float) -> tuple[int, float]:
    """Return the fewest elements that keep a tolerance, and the largest correction of Newton's method that does."""
    best, count = None, float(_FEWEST)
    while count <= _MOST and (best is None or best.error > tolerance):
        with suppress(InconsistentStart):  # steps so long that the past of a multistep method has no solution
            found = PreparedInversion(problem, route, exact, round(count))
            best = found if best is None or found.error < best.error else best
            if found.error > _DIVERGED * best.error and count > 4 * best.elements:
                break
        count = max(count * _GROWTH, count + 1)
    if best is None or best.error > tolerance:
        least = "" if best is None else f", the error is {best.error:.2g} of the peaks with {best.elements}"
        raise IntegrationFailed(
            f"{problem.name}, {route.method.name}: no number of elements keeps a tolerance of"
            f" {tolerance:g}{least}; take a method with more stages, or a larger tolerance: round-off grows"
            " as elements get shorter"
        )
    # Errors of Newton's method are the square of its last correction, which an iteration less often keeps small.
    newton = max(_LOOSE * tolerance**0.5, NEWTON_TOLERANCE)
    loose = PreparedInversion(problem, route, exact, best.elements, newton)
    return best.elements, newton if loose.error <= tolerance else NEWTON_TOLERANCE


_bare_step = made_once(compile_bare_step)


@partial(made_once, most=_MOST_LOOPS)
def _whole(program: Program, elements: int, newton: float) -> ca.Function:
    """Return a whole run as one function, (state, gamma, h, p) -> entries of the states at both ends of every step.

    They are NaN after a step that is not solved or ends with a wrong sign.
    """
    step, observe, (_, entries) = _bare_step(program.discretization, newton), program.observe, _dense_output(program)
    given = [ca.SX.sym("argument", *observe.size_in(k)) for k in range(3)]
    sound = ca.SX(0)
    for channel, value in zip(program.channels, ca.vertsplit(observe.call(given)[0]), strict=True):
        if channel.positive and not ca.depends_on(value, given[1]):
            sound += ca.if_else(value > 0, 0.0, np.nan)
    verdict = ca.Function("sc_verdict", given[::2], [sound])
    state, gamma, h, p = (ca.MX.sym("argument", rows, columns) for rows, columns in map(step.size_in, range(4)))
    gamma = ca.MX.sym("gamma", gamma.size1(), gamma.size2() * elements)
    after = step.mapaccum("sc_elements", elements)(state, gamma, ca.repmat(h, 1, elements), ca.repmat(p, 1, elements))
    signs = verdict.map(elements)(after, ca.repmat(p, 1, elements))
    solved = ca.horzcat(state[entries], after[entries, :] + ca.repmat(signs, len(entries), 1))
    return ca.Function("sc_run", [state, gamma, h, p], [solved])


class PreparedInversion:
    """Inputs of a scene on a form, integrated by every call; made by `prepare`.

    Calls check convergence and, at the ends of steps, signs; `solve` checks a path and parameters. The path of a call
    may have another duration, which is divided into as many elements.

    Parameters
    ----------
    problem : Problem
        With the scene's own parameters and path.
    route : FixedStep
        Form and method.
    exact : Solution
        Inputs on the scene's own path, to measure the error.
    elements : int
        Number of steps from start to end.
    newton : float
        Largest scaled correction at which Newton's method ends.

    Attributes
    ----------
    inputs : tuple of str
        Names of the columns that a call returns.
    elements : int
        Number of steps from start to end.
    newton : float
        Largest scaled correction at which Newton's method ends.
    error : float
        Largest error of the inputs on the scene's own path, relative to their peaks, at 201 instants.
    program : Program
        The compiled form and method.
    whole : casadi.Function
        A whole run, interpreted.
    """

    def __init__(
        self, problem: Problem, route: FixedStep, exact: Solution, elements: int, newton: float = NEWTON_TOLERANCE
    ) -> None:
        self.inputs = tuple(quantity.name for quantity in problem.system.inputs)
        self.elements = elements
        self.program = program = program_of(problem, route.formulation, route.method)
        self.newton, self.whole = newton, _whole(program, elements, newton)
        self._code = in_machine_code(self, ("whole",), program.name, route.native)
        self._route = route
        self._problem, self._own = problem, self._posed(problem)
        self._known: dict[tuple[bytes, float, float], tuple[Places, Array]] = {}
        inputs = exact.values[:, : len(self.inputs)]
        with np.errstate(over="ignore", invalid="ignore"):  # so few elements may lead astray
            off = np.abs(self._read(self.whole, problem, self._own, exact.t) - inputs).max(axis=0)
            self.error = float(np.nan_to_num(off / np.maximum(np.abs(inputs).max(axis=0), 1e-300), nan=np.inf).max())

    def __call__(
        self,
        t: npt.ArrayLike,
        parameters: Mapping[str, float] | None = None,
        path: Reference | None = None,
    ) -> Array:
        """Integrate, and return the inputs at the times `t`.

        Parameters
        ----------
        t : array_like, shape (N,) or ()
            Times in s between start and end of the path, in any order.
        parameters : mapping of str to float, optional
            Values by name; the scene's own for those that are not given.
        path : Reference, optional
            The scene's own when not given.

        Returns
        -------
        ndarray, shape (N, inputs) or (inputs,)
            In the units of the scene's inputs.

        Raises
        ------
        InvalidModel
            If there is no such parameter, or a value lies outside its bounds.
        InvalidReference
            If a path does not fit or lacks derivatives, or a time lies outside it.
        InconsistentStart, IntegrationFailed
            If no initial values are found, a step is not solved, or a quantity has a sign that it must not have.
        """
        problem, posed, times = self._problem, self._own, numbers_of(t, "the times of inputs")
        if parameters or path is not None:
            problem = self._changed(parameters or {}, path)
            posed = self._posed(problem)
        require_inside(problem.reference, times)
        best = self._code.best(self.elements) or self
        found = self._read(best.whole, problem, posed, times.ravel())
        if not np.isfinite(found).all():
            # This names instant, quantity and causes.
            self._route.run(problem, time_grid(problem.reference, problem.reference.duration / self.elements))
            raise IntegrationFailed(f"{self.program.name}: the inputs are not finite numbers")
        return found.reshape(*times.shape, len(self.inputs))

    def _changed(self, parameters: Mapping[str, float], path: Reference | None) -> Problem:
        """Return the problem with other parameters and another path."""
        problem, declared = self._problem, self._problem.system.parameters
        values = declared.values({**dict(zip(declared.names, problem.p.tolist(), strict=True)), **parameters})
        path = problem.reference if path is None else path
        require_kind(path, Reference, "the path", "a Reference", InvalidReference)
        if path.dimension != problem.reference.dimension:
            raise InvalidReference(
                f"{problem.name} needs a path with {problem.reference.dimension} components, not {path.dimension}"
            )
        return replace(problem, p=values, reference=path)

    def _posed(self, problem: Problem) -> tuple[Array, Array, float, Array]:
        """Return the first state, the jets of the path at all nodes, h and p."""
        program, reference = self.program, problem.reference
        h = reference.duration / self.elements
        first, _ = first_state(problem, program, h)
        nodes = program.node_times(time_grid(reference, h)[1:], h)
        return first, np.asfortranarray(side_by_side(reference.jet(nodes, program.order))), h, problem.p

    def _read(self, run: ca.Function, problem: Problem, posed: tuple[Array, Array, float, Array], t: Array) -> Array:
        """Return the inputs at times within the path, (N, inputs), by one run; NaN after a step that is not solved."""
        (states,) = call_of(run)(*posed)
        step, weights = self._weights(problem.reference, t)
        return np.asarray(np.einsum("nij,jn->ni", weights, states[:, step]))

    def _weights(self, reference: Reference, t: Array) -> tuple[Places, Array]:
        """Return the steps at times, (N,), and the weights of the states at their ends, (N, inputs, entries).

        The last are kept: callers often use the same times again.
        """
        h = reference.duration / self.elements
        key = t.tobytes(), h, reference.start_time
        known = self._known.get(key)
        if known is None:
            place = (t - key[2]) / h
            step = np.clip(np.ceil(place), 0, self.elements).astype(np.intp)
            # The first state is that at the end of a step before the path.
            fractions = np.where(step > 0, place - step + 1, 1.0)
            dense, entries = _dense_output(self.program)
            shape = len(self.inputs), len(entries)
            weights = [call_of(dense)(fraction, h)[0].reshape(shape, order="F") for fraction in fractions]
            known = step, np.array(weights).reshape(-1, *shape)
            self._known = {key: known}
        return known


@made_once
def _dense_output(program: Program) -> tuple[ca.Function, list[int]]:
    """Compile (fraction, h) -> weights of the inputs within a step, and list the entries of the state they belong to.

    Raises
    ------
    InvalidSetting
        If the dense output of the method is not linear in its state.
    """
    step, names = program.discretization, [unknown.name for unknown in program.dae.unknowns]
    wanted = ca.vertcat(step.x, step.z)[[names.index(f"u.{each.name}") for each in program.array.system.inputs]]
    moved = ca.substitute(wanted, step.state, step.between)
    by_state = ca.jacobian(moved, step.state)
    if ca.depends_on(by_state, step.state):
        raise InvalidSetting(f"{program.name}: prepare needs a method whose dense output is linear in its state")
    entries = sorted(set(by_state.sparsity().get_triplet()[1]))
    weights = ca.densify(by_state[:, entries])
    return ca.Function("sc_weights", [step.fraction, step.step], [weights]), entries
