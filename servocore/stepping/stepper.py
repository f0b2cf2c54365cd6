"""`Stepper`: the step function of a problem, to be called instant by instant."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from servocore.errors import InvalidReference, InvalidSetting, require_formulation, require_method, require_positive
from servocore.formulations.base import Formulation
from servocore.methods.base import Method
from servocore.model.scene import Scene, require_scene
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.references.base import numbers_of
from servocore.stepping.program import Program, StepReport, program_of


@dataclass(frozen=True, eq=False)
class Stepper:
    """The step function of a problem, to be called instant by instant.

    Parameters
    ----------
    scene : Scene
        The scene.
    formulation, method : Formulation, Method
        Formulation and method.
    step : float
        Step size in s.
    model : str, optional
        Model of the scene; the default one when not given.
    native : bool
        Whether to compile the program to machine code with a C compiler: results are identical, steps some five times
        faster, after a compilation of seconds.

    Examples
    --------
    >>> import servocore as sc
    >>> crane = sc.scenes.rotary_crane()
    >>> stepper = sc.Stepper(crane, sc.Projected(), sc.BackwardEuler(), step=0.01)
    >>> state, report = stepper.start(crane.reference.jet(0.0, stepper.start_order))
    >>> state, report = stepper.advance(state, crane.reference.jet(0.01, stepper.start_order))
    """

    scene: Scene
    formulation: Formulation
    method: Method
    step: float
    model: str | None = None
    native: bool = False
    problem: Problem = field(init=False)
    program: Program = field(init=False)

    def __post_init__(self) -> None:
        require_scene(self.scene, "Stepper")
        require_formulation(self.formulation)
        require_method(self.method, routes=False)
        require_positive(self.step, "the step", "a time in s")
        problem = Problem.of(self.scene, self.model)
        object.__setattr__(self, "problem", problem)
        object.__setattr__(self, "program", program_of(problem, self.formulation, self.method, self.native))

    @property
    def system(self) -> MechanicalSystem:
        """The system that is stepped: the model without redundant constraints."""
        return self.problem.system

    @property
    def parameters(self) -> Array:
        """Parameter values, shape (n_p,)."""
        return self.problem.p

    @property
    def index(self) -> int:
        """Index of the form that is stepped: 0 if instants are independent."""
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

        Returns
        -------
        tuple of (ndarray, StepReport)
            The state at the initial time, and a report.
        """
        jets = self._jets(reference_jet, len(self.start_instants), self.start_order)
        # h = 0 for a start with one instant only, which must not form difference quotients.
        return self.program.begin(jets, self.parameters, self.step if jets.ndim == 3 else 0.0)

    def advance(self, state: Array, reference_jet: Array) -> tuple[Array, StepReport]:
        """Return the state one step later.

        Parameters
        ----------
        state : ndarray
            From `start` or from the previous step; it is not changed.
        reference_jet : ndarray, shape (orders, m), or (nodes, orders, m) for a method with several nodes
            Reference at the new instant (at the nodes of the step).

        Returns
        -------
        tuple of (ndarray, StepReport)
            The state at the new instant, and a report.

        Raises
        ------
        InvalidSetting
            If the state has another shape than those of this stepper.
        InvalidReference
            If the jet has too few derivatives, or another shape.
        """
        jets = self._jets(reference_jet, len(self.nodes), self.program.order)
        if np.shape(state) != (self.program.state_size,):
            raise InvalidSetting(f"a state has shape ({self.program.state_size},), not {np.shape(state)}")
        return self.program.advance(state, jets[None] if jets.ndim == 2 else jets, self.step, self.parameters)

    def _jets(self, jets: Array, instants: int, order: int) -> Array:
        """Return reference jets as an array; raises `InvalidReference` if they are too few or of another shape."""
        numbers = numbers_of(jets, "reference jets")
        components = len(self.system.outputs)
        # More derivatives than needed are allowed, so that one jet serves all routes.
        if numbers.ndim not in (2, 3) or numbers.shape[-1] != components or numbers.shape[-2] <= order:
            raise InvalidReference(
                f"a reference jet of {self.system.name} has shape ({order + 1}, {components}) or more rows, once or for"
                f" each of {instants} instants, not {numbers.shape}"
            )
        if numbers.ndim == 3 and len(numbers) != instants:
            raise InvalidReference(f"jets at {instants} instants are needed, not at {len(numbers)}")
        return numbers

    def values(self, state: Array, reference_jet: Array, *, fraction: float = 1.0) -> dict[str, float]:
        """Return the observed values at the instant of a state, or within its last step, by name.

        Parameters
        ----------
        state : ndarray
            From `advance`.
        reference_jet : ndarray, shape (start_order + 1, m)
            Reference at that instant.
        fraction : float
            Of the last step: 0 at its beginning, 1 at its end. In between the method's own polynomial is evaluated,
            through the stages of `RadauIIA`, through the history of `BDF`. For exact inversions take a step instead.

        Returns
        -------
        dict of str to float
            In the units of the scene's model.
        """
        if fraction != 1.0:
            state = self.program.moved(state, fraction, self.step)
        values = self.program.values(state, np.asarray(reference_jet), self.parameters)
        return dict(zip((channel.name for channel in self.program.channels), map(float, values), strict=True))
