"""`Scene`: models of one thing in different size, its limits, a default reference and a closed form."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import casadi as ca

from servocore.errors import InvalidModel, InvalidReference
from servocore.model.symbols import Parameters
from servocore.model.system import MechanicalSystem
from servocore.numerics.calls import Array
from servocore.references.base import Reference

ModelFactory = Callable[[], MechanicalSystem]
"""Makes a model. Factories that compare equal make one model; one without a hash makes a new one every time."""

ClosedForm = Callable[[Array, Mapping[str, float]], dict[str, Array]]
"""(reference jets (N, orders, m), parameter values) -> arrays (N,) by name."""

IndependentSolution = Callable[[Array, Reference, Mapping[str, float]], dict[str, Array]]
"""(times (N,), reference, parameter values) -> arrays (N,) by name, computed without this library's solvers."""


@dataclass(frozen=True)
class Limit:
    """Where a scene ends: a quantity of the reference that must stay above a bound.

    Parameters
    ----------
    quantity, unit : str
        What is compared, such as ``distance of the trolley from the slewing axis`` in ``m``.
    bound : float
        The quantity must be larger than this.
    reason : str
        What happens at the bound, as part of a sentence: ``the rope goes slack``.
    expression : callable
        (gamma (m, orders), parameters) -> the quantity as a CasADi expression.
    at_instants_only : bool
        Whether the path may break the limit between the instants of a grid.
    """

    quantity: str
    unit: str
    bound: float
    reason: str
    expression: Callable[[ca.SX, Parameters], ca.SX]
    at_instants_only: bool = False


@dataclass(frozen=True, eq=False)
class Scene:
    """A servo constraint problem with everything that a user would otherwise have to find out.

    Parameters
    ----------
    name : str
        Identifier, such as ``rotary_crane``.
    models : mapping of str to callable
        Factories of its models, smallest first: the first is the default. Each is called once, by whichever scene
        asks first; a factory with settings is best a frozen dataclass with `__call__`, so that equal settings compare
        equal.
    reference : Reference
        The path to follow.
    closed_form : callable, optional
        Exact answer by name for reference jets with `closed_form_order` derivatives.
    independent_solution : callable, optional
        For scenes with internal dynamics, which no formula of the jets answers: their own differential equation,
        derived by hand and integrated to near round-off by SciPy.
    limits : tuple of Limit
        Where the scene ends.
    parameters : mapping of str to float
        Values that differ from the defaults.
    follow_branch : bool
        Whether every instant of the exact inversion starts from where the one before was heading instead of the
        model's guess: where several configurations belong to one output, a run then stays on the branch on which it
        started, and goes on smoothly where two branches meet.
    """

    name: str
    models: Mapping[str, ModelFactory]
    reference: Reference
    closed_form: ClosedForm | None = None
    closed_form_order: int = 4
    independent_solution: IndependentSolution | None = None
    limits: tuple[Limit, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    follow_branch: bool = False

    @property
    def default_model(self) -> str:
        """Name of the smallest model."""
        return next(iter(self.models))

    def model(self, name: str | None = None) -> MechanicalSystem:
        """Return the model called `name`, or the default one, the same object every time.

        Raises
        ------
        InvalidModel
            If there is no such model.
        """
        name = name or self.default_model
        if name not in self.models:
            raise InvalidModel(f"{self.name} has no model {name}; it has {', '.join(self.models)}")
        factory = self.models[name]
        return _made(factory) if isinstance(factory, Hashable) else factory()

    def with_reference(self, reference: Reference) -> Scene:
        """Return the scene with another path; raises `InvalidReference` if its dimension does not fit."""
        wanted = len(self.model().outputs)
        if reference.dimension != wanted:
            raise InvalidReference(
                f"{self.name} needs a path with {wanted} components, this one has {reference.dimension}"
            )
        return replace(self, reference=reference)

    def with_parameters(self, **values: float) -> Scene:
        """Return the scene with other parameter values; raises `InvalidModel` for bad names or values."""
        merged = {**self.parameters, **values}
        self.model().parameters.values(merged)
        return replace(self, parameters=merged)

    def parameter_values(self) -> dict[str, float]:
        """All parameters by name."""
        parameters = self.model().parameters
        return dict(zip(parameters.names, map(float, parameters.values(self.parameters)), strict=True))

    def exact(self, t: Array) -> dict[str, Array]:
        """Evaluate the exact answer at the times `t`; raises `InvalidModel` if the scene has none."""
        if self.independent_solution is not None:
            return self.independent_solution(t, self.reference, self.parameter_values())
        if self.closed_form is None:
            raise InvalidModel(f"{self.name} has no closed form")
        return self.closed_form(self.reference.jet(t, self.closed_form_order), self.parameter_values())


# What was resolved and compiled for a system is found again by the system itself: scenes made twice, by
# `with_reference` or by calling `cars(3)` again, must give the same object. The bound only keeps a program that makes
# factories without end from filling the memory.
@lru_cache(maxsize=256)
def _made(factory: ModelFactory) -> MechanicalSystem:
    return factory()
