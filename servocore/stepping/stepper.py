"""`compile_program` and `Stepper`: a scene, a formulation and a method become one step function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

import casadi as ca
import numpy as np

from servocore.dae import Dae
from servocore.structure.derivative_array import DerivativeArray, compile_array_solver, derivative_array
from servocore.errors import InvalidSetting
from servocore.checks.limits import compile_margins, limit_texts, limits_order
from servocore.formulations import Formulation, Reduced
from servocore.methods import Discretisation, Method
from servocore.methods.base import instantaneous
from servocore.numerics.machine_code import in_machine_code
from servocore.numerics.square_systems import compile_solver, largest
from servocore.stepping.program import Channel, Program, StepReport
from servocore.problem import prepared
from servocore.model.scene import Limit, Scene
from servocore.stepping.initial_values import compile_start, start_instants
from servocore.model.symbols import Array, Quantity
from servocore.model.system import MechanicalSystem


@lru_cache(maxsize=64)
def compile_program(
    system: MechanicalSystem,
    formulation: Formulation,
    method: Method,
    limits: tuple[Limit, ...] = (),
    follow_branch: bool = False,
) -> Program:
    """Compile a model with a formulation and a method; repeated calls return the same program.

    With `follow_branch` an exact inversion starts from where the instant before was heading instead of the model's
    guess.
    """
    dae = formulation.dae(system)
    # Without differential states every instant stands alone: a step is a start.
    pointwise = dae.x.numel() == 0
    discretisation = instantaneous(dae) if pointwise else method.discretise(dae)
    array = formulation.array(system) if isinstance(formulation, Reduced) else derivative_array(system)
    start_order = max(array.reference_order, dae.reference_order, limits_order(system, limits), 2)
    known = _observed(system)
    start = compile_start(array, dae, discretisation, start_order)
    if pointwise:
        step = _compile_following_step(array, start_order) if follow_branch else _compile_pointwise_step(start)
    else:
        step = _compile_step(discretisation)
    return Program(
        name=f"{dae.name}, {method.name}" if not pointwise else dae.name,
        start=start,
        step=step,
        observe=_compile_observe(system, dae, discretisation, known, start_order),
        margins=compile_margins(system, limits, start_order),
        guess_residual=_compile_guess_residual(discretisation),
        rescale=ca.Function(
            "sc_rescale", [discretisation.state, discretisation.ratio], [ca.densify(discretisation.rescaled)]
        ),
        between=ca.Function(
            "sc_between",
            [discretisation.state, discretisation.fraction, discretisation.step],
            [ca.densify(discretisation.between)],
        ),
        index=dae.index,
        order=start_order if pointwise else dae.reference_order,
        start_order=start_order,
        nodes=discretisation.nodes,
        start_instants=start_instants(array, discretisation),
        channels=tuple(Channel(each.name, each.unit, each.description, each.wraps, each.positive) for each, _ in known),
        parameters=system.parameters.names,
        equations=discretisation.labels,
        limits=limit_texts(limits),
    )


def _observed(system: MechanicalSystem) -> list[tuple[Quantity, ca.SX]]:
    """List inputs, observables, servo outputs, then coordinates whose names are still free."""
    listed = [
        *((each, system.u[k]) for k, each in enumerate(system.inputs)),
        *system.observables.items(),
        *((each, system.output[k]) for k, each in enumerate(system.outputs)),
        *((each, system.q[k]) for k, each in enumerate(system.coordinates.quantities)),
    ]
    seen: dict[str, tuple[Quantity, ca.SX]] = {}
    for quantity, expression in listed:
        seen.setdefault(quantity.name, (quantity, expression))
    return list(seen.values())


def _compile_step(step: Discretisation) -> ca.Function:
    solver = compile_solver("sc_solve", step.equations, [step.next_state])
    return _with_step_arguments("sc_step", step, lambda givens: list(solver(givens)))


def _compile_following_step(array: DerivativeArray, order: int) -> ca.Function:
    """Invert exactly, starting from where the instant before was heading.

    Without internal dynamics its state is all unknowns, derivatives included. Where two motions meet, the one that goes
    on with the same velocity and acceleration is the nearer, by a power of h.
    """
    solver = compile_array_solver(array)
    system = array.system
    state, h = ca.MX.sym("state", len(array.unknowns)), ca.MX.sym("h")
    gamma, p = ca.MX.sym("gamma", system.gamma.size1(), order + 1), ca.MX.sym("p", system.p.numel())
    known = dict(zip(array.unknowns, ca.vertsplit(state), strict=True))
    ahead = [
        value + h * known.get((j, k + 1), 0) + h**2 / 2 * known.get((j, k + 2), 0) for (j, k), value in known.items()
    ]
    found = solver(gamma[:, : array.reference_order + 1], p, ca.vertcat(*ahead))
    return ca.Function("sc_step", [state, gamma, h, p], list(found))


def _compile_pointwise_step(start: ca.Function) -> ca.Function:
    state, h = ca.MX.sym("state", start.numel_out(0)), ca.MX.sym("h")
    gamma, p = ca.MX.sym("gamma", *start.size_in(0)), ca.MX.sym("p", start.numel_in(2))
    return ca.Function("sc_step", [state, gamma, h, p], list(start(gamma, h, p)))


def _compile_guess_residual(step: Discretisation) -> ca.Function:
    equations = step.equations
    residual = ca.substitute(equations.residual, equations.unknowns, equations.guess) / equations.residual_scale
    evaluate = ca.Function("sc_residual", [equations.givens], [ca.densify(residual)])
    return _with_step_arguments("sc_guess_residual", step, lambda givens: [evaluate(givens)])


def _with_step_arguments(name: str, step: Discretisation, evaluate: Callable[[ca.MX], list[ca.MX]]) -> ca.Function:
    """Give a function of the flat givens the arguments (state, gamma, h, p)."""
    state = ca.MX.sym("state", step.state.numel())
    gamma = ca.MX.sym("gamma", *step.reference.shape)
    h = ca.MX.sym("h")
    p = ca.MX.sym("p", step.equations.givens.numel() - state.numel() - gamma.numel() - 1)
    return ca.Function(name, [state, gamma, h, p], evaluate(ca.vertcat(state, ca.vec(gamma), h, p)))


def _compile_observe(
    system: MechanicalSystem,
    dae: Dae,
    step: Discretisation,
    known: list[tuple[Quantity, ca.SX]],
    order: int,
) -> ca.Function:
    names = ("q", "v", "lam", "u")
    symbols = ca.vertcat(*[getattr(system, name) for name in names])
    physical = ca.vertcat(*[dae.physical[name] for name in names])
    expressions = ca.vertcat(*[expression for _, expression in known])
    violations = _violations(system)
    expressions, violations = ca.substitute([expressions, violations], [symbols], [physical])
    unknowns = ca.vertcat(dae.x, dae.z)
    expressions, violations = ca.substitute([expressions, violations], [unknowns], [ca.vertcat(step.x, step.z)])
    gamma = system.gamma[:, : order + 1]
    return ca.Function(
        "sc_observe", [step.state, gamma, system.p], [ca.densify(expressions), ca.densify(violations)], {"cse": True}
    )


def _violations(system: MechanicalSystem) -> ca.SX:
    """Return |c|, |dc/dt|, |g|, |dg/dt| in the maximum norm."""
    groups = (
        system.output - system.gamma[:, 0],
        ca.mtimes(system.C, system.v) - system.gamma[:, 1],
        system.constraints,
        ca.mtimes(system.G, system.v),
    )
    return ca.vertcat(*[largest(group) for group in groups])


@dataclass(frozen=True, eq=False)
class Stepper:
    """The step function of a problem, to be called instant by instant.

    Parameters
    ----------
    scene : Scene
        What to step.
    formulation, method : Formulation, Method
        How.
    step : float
        Step size in s.
    model : str, optional
        Model of the scene; the default one when not given.
    native : bool
        Whether a C compiler shall turn the program into machine code: the same numbers to the last bit, some five
        times faster, after seconds of compiling, once a process. Such a program cannot be saved.

    Examples
    --------
    >>> stepper = Stepper(crane, Projected(), BackwardEuler(), step=0.01)
    >>> state, report = stepper.start(crane.reference.jet(0.0, stepper.start_order))
    >>> state, report = stepper.advance(state, crane.reference.jet(0.01, stepper.start_order))
    """

    scene: Scene
    formulation: Formulation
    method: Method
    step: float
    model: str | None = None
    native: bool = False
    system: MechanicalSystem = field(init=False)
    program: Program = field(init=False)
    parameters: Array = field(init=False)

    def __post_init__(self) -> None:
        if not 0.0 < self.step < float("inf"):
            raise InvalidSetting(f"the step must be positive and finite, not {self.step} s")
        base = self.scene.model(self.model)
        p = base.parameters.values(self.scene.parameters)
        system = prepared(base, p)[0]
        program = compile_program(system, self.formulation, self.method, self.scene.limits, self.scene.follow_branch)
        object.__setattr__(self, "program", in_machine_code(program) if self.native else program)
        object.__setattr__(self, "system", system)
        object.__setattr__(self, "parameters", p)

    @property
    def index(self) -> int:
        """Index of the form that is stepped: 0 where every instant stands alone."""
        return self.program.index

    @property
    def start_order(self) -> int:
        """Highest derivative of the reference that `start` needs; enough for `advance` and `values` too."""
        return self.program.start_order

    @property
    def start_instants(self) -> tuple[float, ...]:
        """Instants, in steps from the initial time, at which `start` needs the reference."""
        return self.program.start_instants

    @property
    def nodes(self) -> tuple[float, ...]:
        """Fractions of the step at which `advance` needs the reference."""
        return self.program.nodes

    def start(self, reference_jet: Array) -> tuple[Array, StepReport]:
        """Return the consistent initial state.

        Parameters
        ----------
        reference_jet : ndarray, shape (start_order + 1, m), or (instants, start_order + 1, m)
            Reference at the initial time; for a method with several `start_instants`, at each of them. With the
            first form such a method starts from exact values instead, and its first inputs are less accurate.
        """
        jets = np.asarray(reference_jet)
        return self.program.begin(jets, self.parameters, self.step if jets.ndim == 3 else 0.0)

    def advance(self, state: Array, reference_jet: Array) -> tuple[Array, StepReport]:
        """Return the state one step later.

        Parameters
        ----------
        state : ndarray
            From `start` or from the previous step; it is not changed.
        reference_jet : ndarray, shape (orders, m), or (nodes, orders, m) for a method with several nodes
            Reference at the new instant (at the nodes of the step).
        """
        jets = np.asarray(reference_jet)
        return self.program.advance(state, jets[None] if jets.ndim == 2 else jets, self.step, self.parameters)

    def values(self, state: Array, reference_jet: Array, *, fraction: float = 1.0) -> dict[str, float]:
        """Return what the state says of its own instant, by name; or of an instant within its last step.

        Parameters
        ----------
        state : ndarray
            From `advance`.
        reference_jet : ndarray, shape (start_order + 1, m)
            Reference at the instant asked for.
        fraction : float
            Of the last step: 0 at its beginning, 1 at its end. In between the method's own polynomial is evaluated,
            through the stages of `RadauIIA`, through the history of `BDF`. Exact inversions answer by another step.
        """
        if fraction != 1.0:
            state = self.program.moved(state, fraction, self.step)
        values = self.program.values(state, np.asarray(reference_jet), self.parameters)
        return dict(zip((each.name for each in self.program.channels), map(float, values), strict=True))
