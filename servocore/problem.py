"""`Problem`: a servo constraint problem resolved once, from which solvers, checks and pages start.

`ResolvedSystem` has the results that depend on the system alone (its structure, its derivative array, compiled
functions) and is shared by all problems of that system; `Problem` adds one path and one set of parameter values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import casadi as ca
import numpy as np

from servocore.dae import Dae
from servocore.errors import InvalidModel, require_kind
from servocore.formulations.base import Formulation
from servocore.model.drawing import Drawing
from servocore.model.limits import Limit
from servocore.model.model_validation import probes, require_driving, require_mass
from servocore.model.nominal_magnitudes import decades_of, scaled_to
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array, lock_arrays
from servocore.numerics.components import filled
from servocore.numerics.memoization import made_once
from servocore.numerics.step_operations import operations_in
from servocore.references.base import Reference
from servocore.structure.derivative_array import DerivativeArray, derivative_array
from servocore.structure.signature import Signature, is_regular

LEFT_OUT_HOLDS = 1e-4
"""Of how far its gradient lets a row go: a redundant constraint that is off by more does not hold.

Solvers keep the others better."""

_NO_REACH = 1e-300  # of a row that nothing moves, as a stop that is not touched


@dataclass(frozen=True, eq=False)
class ResolvedSystem:
    """A mechanical system as it is solved: redundant constraints left out, its structure known.

    Attributes
    ----------
    system : MechanicalSystem
        The system without redundant constraints.
    redundant : tuple of int
        Rows of the holonomic constraints that were left out.
    outcome : DerivativeArray or InvalidModel
        The derivative array of the signature method, or the reason why it does not apply.
    left_out : casadi.SX
        These rows, expressions of the system's symbols: around home they follow from the others.
    """

    system: MechanicalSystem
    redundant: tuple[int, ...]
    outcome: DerivativeArray | InvalidModel
    left_out: ca.SX = field(default_factory=lambda: ca.SX(0, 1), repr=False)

    @property
    def left_out_shares(self) -> ca.SX:
        """Residual of each of `left_out`, relative to its change over a motion as large as q."""
        system = self.system
        nominal = ca.DM(system.coordinates.nominal)
        reach = ca.mtimes(ca.fabs(ca.jacobian(self.left_out, system.q)), ca.fmax(ca.fabs(system.q), nominal))
        return ca.densify(self.left_out / ca.fmax(reach, _NO_REACH))

    @property
    def must_be_positive(self) -> list[tuple[Quantity, ca.SX]]:
        """Observables that must be positive, and margins that are positive while redundant constraints hold."""
        signs = [(quantity, each) for quantity, each in self.system.observables.items() if quantity.positive]
        shares = ca.vertsplit(self.left_out_shares) if self.redundant else []
        margins = [
            (Quantity(f"left out {k}", positive=True), LEFT_OUT_HOLDS - ca.fabs(e)) for k, e in enumerate(shares)
        ]
        return signs + margins

    @cached_property
    def mass_varies(self) -> bool:
        """Whether the mass matrix depends on the configuration."""
        return bool(ca.depends_on(self.system.mass, self.system.q))

    def holds(self, operations: set[int]) -> bool:
        """Whether the equations hold one of some operations, such as `KINKS`, given by their numbers in CasADi."""
        return bool(operations & self._operations)

    @cached_property  # asked for by every solve
    def _operations(self) -> set[int]:
        return operations_in(ca.veccat(*equations_of(self.system)))

    @property
    def array(self) -> DerivativeArray:
        """The derivative array; raises `InvalidModel` where the signature method does not apply."""
        if isinstance(self.outcome, InvalidModel):
            raise InvalidModel(str(self.outcome))  # a new one: an exception that is kept keeps all frames it passed
        return self.outcome

    def dae(self, formulation: Formulation) -> Dae:
        """Return the system in a formulation."""
        return _dae(self, formulation)

    def suits(self, p: Array) -> bool:
        """Whether the structure found at the system's home is the structure at the parameter values `p` too."""
        if isinstance(self.outcome, InvalidModel):
            return False
        signature = self.outcome.signature
        return not signature.equations.special and is_regular(signature, p)


_FIELDS = "mass", "potential", "force", "gyroscopic", "constraints", "output", "input_matrix"


def equations_of(system: MechanicalSystem) -> list[ca.SX]:
    """Return all expressions that make up the equations of a system."""
    return [getattr(system, name) for name in _FIELDS]


@made_once
def _dae(resolved: ResolvedSystem, formulation: Formulation) -> Dae:
    return formulation.dae(resolved.system)


@made_once  # solves of one scene on many paths share the compiled functions of its system
def resolve(system: MechanicalSystem, p: tuple[float, ...]) -> ResolvedSystem:
    """Leave out redundant constraints and find the structure of a system at parameter values.

    A parameter can decide about the index: an inclination of zero, a damper of zero. Where the structure is that of the
    system's home, the same object is returned as there.
    """
    if p != system.home_parameters:
        _require_mass(system, np.array(p))
    redundant = system.constraint_rank(np.array(p)).redundant
    if p != system.home_parameters:
        at_home = resolve(system, system.home_parameters)
        if at_home.redundant == redundant and at_home.suits(np.array(p)):
            return at_home
        system = replace(system, home_parameters=p)
    kept = without_constraints(system, redundant) if redundant else system
    outcome: DerivativeArray | InvalidModel
    try:
        _require_driving(kept)
        outcome = derivative_array(kept)
    except InvalidModel as error:
        outcome = error
    return ResolvedSystem(kept, redundant, outcome, _rows(system.constraints, redundant))


def _require_driving(system: MechanicalSystem) -> None:
    """Raise `InvalidModel`, naming them, if some inputs or outputs are dead or follow from others."""
    home, p = system.home_configuration()
    jacobians = ca.Function("jacobians", [system.q, system.p], [system.input_matrix, system.C])
    jacobians_at_probes = [jacobians(*probe) for probe in probes(home, system.coordinates.nominal, p)]
    for k, (kind, quantities) in enumerate((("input", system.inputs), ("output", system.outputs))):
        rows = [filled(jacobians_at_probe[k]) for jacobians_at_probe in jacobians_at_probes]
        names = [quantity.name for quantity in quantities]
        require_driving(system.name, rows, names, kind)


def _require_mass(system: MechanicalSystem, p: Array) -> None:
    """Raise `InvalidModel` unless M is positive semidefinite at home with the parameter values `p`."""
    mass = np.asarray(ca.Function("mass", [system.q, system.p], [system.mass])(system.home_configuration(p)[0], p))
    where = f"with {', '.join(f'{name} = {value:g}' for name, value in zip(system.parameters.names, p, strict=True))}"
    require_mass(system.name, [mass], system.coordinates.names, where)


def without_constraints(system: MechanicalSystem, dropped: tuple[int, ...]) -> MechanicalSystem:
    """Return the system without some of its holonomic constraints; their multipliers become zero."""
    kept = tuple(k for k in range(system.lam.numel()) if k not in dropped)
    multipliers, zeros = system.lam[list(dropped)], ca.SX.zeros(len(dropped))
    observables = {k: ca.substitute(e, multipliers, zeros) for k, e in system.observables.items()}
    return replace(
        system,
        constraints=_rows(system.constraints, kept),
        multipliers=_rows(system.lam, kept),
        observables=observables,
        constraint_names=tuple(system.constraint_names[k] for k in kept if system.constraint_names),
    )


def _rows(column: ca.SX, rows: tuple[int, ...]) -> ca.SX:
    """Return some rows of a column; CasADi itself makes a row of none."""
    return ca.vertcat(ca.SX(0, 1), *[column[k] for k in rows])


@dataclass(frozen=True, eq=False)
class Problem:
    """A scene and one of its models, resolved: the input of `analyse`, `solve`, `simulate` and others.

    Attributes
    ----------
    name : str
        Of the scene.
    resolved : ResolvedSystem
        The system, its structure and its compiled functions.
    p : ndarray, shape (n_p,)
        Parameter values.
    reference : Reference
        The path to follow; at rest at home for a system without a scene.
    limits : tuple of Limit
        Where the scene ends.
    follow_branch : bool
        Whether every instant starts from the one before, see `Scene`.
    left_out : str
        Names of the redundant constraints that were left out, for messages; empty if there were none.
    start : mapping of str to float
        Initial values of the states of the internal dynamics by name; those of the guess, at rest, when empty.
    drawing : callable or None
        Parts that pages draw, see `Scene`.

    Examples
    --------
    >>> import servocore as sc
    >>> problem = sc.Problem.of(sc.scenes.rotary_crane())
    >>> problem.signature.index, problem.dae(sc.Projected()).index
    (5, 3)
    """

    name: str
    resolved: ResolvedSystem
    p: Array
    reference: Reference
    limits: tuple[Limit, ...] = ()
    follow_branch: bool = False
    left_out: str = ""
    start: Mapping[str, float] = field(default_factory=dict)
    drawing: Drawing | None = None

    def __post_init__(self) -> None:
        lock_arrays(self, "p")

    @classmethod
    def of(
        cls, subject: Scene | MechanicalSystem, model: str | None = None, start: Mapping[str, float] | None = None
    ) -> Problem:
        """Resolve a scene, or a system at its home.

        Parameters
        ----------
        subject : Scene or MechanicalSystem
            A scene with its own parameters and reference; a system rests at its home.
        model : str, optional
            Model of the scene; its smallest when not given.
        start : mapping of str to float, optional
            Initial values of the states of the internal dynamics.

        Returns
        -------
        Problem
            Resolved once for the same model and settings.

        Raises
        ------
        InvalidModel
            If the scene has no such model.
        """
        if isinstance(subject, MechanicalSystem):
            system, p = subject, np.array(subject.home_parameters)
            scene = Scene(system.name, {"only": lambda: subject}, _at_rest(system.home))
        else:
            require_kind(subject, Scene, "the problem", "a Scene", InvalidModel)
            scene, system = subject, subject.model(model)
            scene.require_path(system)
            p = system.parameters.values(scene.parameters)
            system = scaled_to(system, decades_of(scene.reference))
        resolved = resolve(system, tuple(p.tolist()))
        left_out = system.listed_constraints(resolved.redundant)
        reference = scene.reference
        if system.time.numel() and reference.dimension == len(system.outputs):
            from servocore.references.timed_path import TimeAugmented  # noqa: PLC0415 - few hold the time

            reference = TimeAugmented.of(reference)
        return cls(
            scene.name, resolved, p, reference, scene.limits, scene.follow_branch, left_out, start or {}, scene.drawing
        )

    @property
    def system(self) -> MechanicalSystem:
        """The system that is solved."""
        return self.resolved.system

    @property
    def array(self) -> DerivativeArray:
        """Its derivative array; raises `InvalidModel` where the signature method does not apply."""
        return self.resolved.array

    @property
    def signature(self) -> Signature:
        """The signature matrix with the structural index; raises as `array` does."""
        return self.array.signature

    @property
    def flat(self) -> bool:
        """Whether no internal dynamics remain: the inputs at an instant follow from the path at that instant."""
        return not self.array.states

    @property
    def path_limits(self) -> tuple[Limit, ...]:
        """The limits that follow from the path alone."""
        return tuple(limit for limit in self.limits if limit.of_path)

    @property
    def motion_limits(self) -> tuple[Limit, ...]:
        """The limits that do not follow from the path alone."""
        return tuple(limit for limit in self.limits if not limit.of_path)

    def dae(self, formulation: Formulation) -> Dae:
        """Return the problem in a formulation, with the index of that form."""
        return self.resolved.dae(formulation)


def _at_rest(place: tuple[float, ...]) -> Reference:
    """Return a path that stays where it is, with all derivatives."""
    from servocore.references.piecewise import PiecewisePolynomial  # noqa: PLC0415 - scenes have paths

    coefficients = np.zeros((1, 100, len(place)))
    coefficients[:, 0] = place
    return PiecewisePolynomial.of(np.array([0.0, 1.0]), coefficients, 99, np.array([place] * 2), (True, True))
