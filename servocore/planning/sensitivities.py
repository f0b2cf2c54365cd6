"""How inputs, and the motion under inputs that stay, change with the parameters: exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from servocore.checks.before_run import require_feasible
from servocore.errors import InvalidModel, InvalidSetting
from servocore.files import csv_text
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene, require_scene
from servocore.numerics.compiled_calls import Array, at_instants, lock_arrays
from servocore.numerics.memoization import made_once
from servocore.planning.flat_system import free_motion, motion_places
from servocore.problem import Problem, ResolvedSystem
from servocore.references.base import time_grid
from servocore.solvers.exact_inversion import prepared_motion

_STEPS = 2000
"""Least number of steps in which the linearized plant is integrated, by the classical method of order four."""

DRIFT = " drift"
"""Suffix of the name of an output's deviation."""


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives by parameters over time: ``found["F", "load_mass"]`` in N/kg.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times in s.
    quantities : tuple of Quantity
        The inputs of the path, and each output with `DRIFT` behind its name: where the load goes instead
        if the inputs stay as they were, by the linearized plant.
    parameters : tuple of str
        Names.
    units : tuple of str
        Of the parameters.
    values : ndarray, shape (N, quantities, parameters)
        The derivatives.
    sizes : ndarray, shape (parameters,)
        The parameters themselves: an effect of one per cent is a hundredth of size times derivative.
    """

    t: Array
    quantities: tuple[Quantity, ...]
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    sizes: Array

    def __post_init__(self) -> None:
        lock_arrays(self, "t", "values", "sizes")

    def __getitem__(self, names: tuple[str, str]) -> Array:
        if not isinstance(names, tuple) or len(names) != 2:
            raise KeyError(f"{names!r} is no pair of a quantity and a parameter, such as found['F', 'load_mass']")
        quantity, parameter = names
        known = [channel.name for channel in self.quantities]
        if quantity not in known or parameter not in self.parameters:
            raise KeyError(f"{quantity}, {parameter}; there are {', '.join(known)} by {', '.join(self.parameters)}")
        return np.asarray(self.values[:, known.index(quantity), self.parameters.index(parameter)])

    def table(self) -> str:
        """Return time and all derivatives as a CSV file; ``F/load_mass`` is that of F by the load's mass.

        Returns
        -------
        str
            With a row of headings; times in s.
        """
        names = [f"{quantity.name}/{parameter}" for quantity in self.quantities for parameter in self.parameters]
        return csv_text(["time", *names], [self.t, self.values.reshape(len(self.t), -1)])


def sensitivities(
    scene: Scene, wrt: Sequence[str] | None = None, *, step: float | None = None, model: str | None = None
) -> Sensitivities:
    """Return exact derivatives of inputs, and of the motion under given inputs, by parameters.

    The inputs follow from the equations and their derivatives at an instant, so that the implicit function theorem
    gives their derivatives; the motion under the inputs of the present parameters follows the linearized plant, from
    the state in which the path starts.

    Parameters
    ----------
    scene : Scene
        Without internal dynamics.
    wrt : sequence of str, optional
        Parameters by name; all of them when not given.
    step : float, optional
        Time between instants in s; must divide the duration of the path, of which it is a 200th when not given.
    model : str, optional
        Model of the scene; its smallest when not given.

    Returns
    -------
    Sensitivities
        Derivatives at the instants.

    Raises
    ------
    InvalidModel
        If the model has internal dynamics, or its equations depend on time.
    InvalidReference
        If the path is out of reach.
    InvalidSetting
        If there is no such parameter, or the step does not fit.

    Examples
    --------
    >>> import servocore as sc
    >>> derivatives = sc.sensitivities(sc.scenes.rotary_crane(), wrt=("load_mass",))
    >>> derivatives["F", "load_mass"].shape == derivatives.t.shape
    True
    """
    require_scene(scene, "sensitivities")
    problem = Problem.of(scene, model)
    if not problem.flat or problem.system.time.numel():
        why = "has internal dynamics" if not problem.flat else "depends on time"
        raise InvalidModel(f"{scene.name} {why}: its inputs do not follow from the path at the same instant")
    declared = {parameter.name: parameter for parameter in problem.system.parameters.declared}
    names = tuple(declared) if wrt is None else tuple([wrt] if isinstance(wrt, str) else wrt)
    for name in names:
        if name not in declared:
            raise InvalidSetting(f"{scene.name} has no parameter {name}; there are {', '.join(declared)}")
    require_feasible(problem)
    t = time_grid(problem.reference, step)
    columns = [list(declared).index(label) for label in names]
    between = -(-_STEPS // (len(t) - 1))
    fine = np.append((t[:-1, None] + np.diff(t)[:, None] * np.arange(2 * between) / (2 * between)).ravel(), t[-1])
    states, inputs, starts = _by_implicit_function(problem, fine, columns)
    drifts = _drifts(problem, fine, states, starts, columns)[::between]
    system = problem.system
    drifted = tuple(replace(quantity, name=quantity.name + DRIFT) for quantity in system.outputs)
    return Sensitivities(
        t=t,
        quantities=(*system.inputs, *drifted),
        parameters=names,
        units=tuple(declared[label].unit for label in names),
        values=np.concatenate([inputs[:: 2 * between], drifts], axis=1),
        sizes=problem.p[columns],
    )


def _by_implicit_function(problem: Problem, t: Array, columns: list[int]) -> tuple[Array, Array, Array]:
    """Return motion and inputs (2 n + m, N), dinputs/dp (N, m, k) and dstate/dp at the first instant (2 n, k)."""
    states = prepared_motion(problem).at(t)
    jets = problem.reference.jet(t, problem.array.reference_order)
    (slopes,) = at_instants(_implicit(problem.resolved), states, jets=jets, p=problem.p)
    slopes = slopes.reshape(len(states), len(t), -1)[:, :, columns]
    places, n = motion_places(problem), len(problem.system.coordinates)
    return states[places], slopes[places[2 * n :]].transpose(1, 0, 2), slopes[places[: 2 * n], 0]


@made_once
def _implicit(resolved: ResolvedSystem) -> ca.Function:
    """Compile (unknowns of the array, gamma, p) -> their derivatives by p."""
    array, system = resolved.array, resolved.system
    column, gamma = array.column(array.unknowns), system.gamma[:, : array.reference_order + 1]
    terms = ca.Function(
        "sc_by_p",
        [column, gamma, system.p],
        [ca.jacobian(array.residual, variables) for variables in (column, system.p)],
    )
    symbols = [ca.MX.sym(f"x{k}", *terms.size_in(k)) for k in range(3)]
    J, right = terms(*symbols)
    return ca.Function("sc_implicit", symbols, [ca.densify(ca.solve(J, -right, "qr"))])


def _drifts(problem: Problem, t: Array, motion: Array, start: Array, columns: list[int]) -> Array:
    """Return doutputs/dp (steps + 1, m, k) under inputs that stay, by the plant linearized along the motion.

    `t` holds the ends and the middle of every step.
    """
    n = len(problem.system.coordinates)
    function = _linearized(problem.resolved)
    matrices = [instant.reshape(instant.shape[0], len(t), -1).transpose(1, 0, 2) for instant in at_instants(
        function, motion[: 2 * n], motion[2 * n :], jets=np.zeros((len(t), 1, 1)), p=problem.p)]  # fmt: skip
    A, b, C, d = matrices[0], matrices[1][:, :, columns], matrices[2], matrices[3][:, :, columns]
    S, steps = start, np.diff(t[::2])
    held = [C[0] @ S + d[0]]
    for k, h in enumerate(steps):
        first = A[2 * k] @ S + b[2 * k]
        second = A[2 * k + 1] @ (S + h / 2 * first) + b[2 * k + 1]
        third = A[2 * k + 1] @ (S + h / 2 * second) + b[2 * k + 1]
        fourth = A[2 * k + 2] @ (S + h * third) + b[2 * k + 2]
        S = S + h / 6 * (first + 2 * second + 2 * third + fourth)
        held.append(C[2 * k + 2] @ S + d[2 * k + 2])
    return np.array(held)


@made_once
def _linearized(resolved: ResolvedSystem) -> ca.Function:
    """Compile (state, u, nothing, p) -> derivatives of state_dot by state and p, and of the outputs by both."""
    state, u, p, rates, outputs = free_motion(resolved)
    results = [ca.jacobian(each, by) for each in (rates, outputs(state, p)) for by in (state, p)]
    nothing = ca.MX.sym("nothing", 1, 1)
    return ca.Function("sc_linearized", [state, u, nothing, p], [ca.densify(result) for result in results])
