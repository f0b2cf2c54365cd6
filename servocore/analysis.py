"""`analyse`: what kind of servo constraint problem a scene is, and which route is enough for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from servocore.numerics.calls import Call
from servocore.structure.derivative_array import DerivativeArray, derivative_array
from servocore.errors import InvalidModel, InvalidReference
from servocore.checks.limits import require_feasible
from servocore.structure.zero_dynamics import DAMPED, internal_eigenvalues
from servocore.structure.inversion import compile_inversion
from servocore.checks.branches import rank_losses
from servocore.problem import prepared
from servocore.model.scene import Scene
from servocore.structure.structural_analysis import equilibrated, system_jacobian
from servocore.model.symbols import Array
from servocore.model.system import MechanicalSystem

FLAT = "flat"
MINIMUM_PHASE = "minimum phase"
WEAKLY_MINIMUM_PHASE = "weakly minimum phase"
NON_MINIMUM_PHASE = "non-minimum phase"
SINGULAR = "singular here"

_SINGULAR_CONDITION = 1e12
_SURVEY_POINTS = 201

ADVICE = {
    FLAT: "Reduced: the inputs follow from the reference and its derivatives at every instant, to round-off",
    MINIMUM_PHASE: "Reduced with a method that integrates the internal dynamics forward in time",
    WEAKLY_MINIMUM_PHASE: "Reduced with a method that integrates the internal dynamics, which are not damped",
    NON_MINIMUM_PHASE: "BoundaryValue: forward in time the unstable internal dynamics let errors grow exponentially",
    SINGULAR: "another path, other parameters or another model",
}


@dataclass(frozen=True)
class StructureReport:
    """What `analyse` finds; printing it gives a page for humans.

    Attributes
    ----------
    name : str
        The system analysed.
    degrees_of_freedom, inputs, outputs : int
        Of the mechanical system.
    index : int or None
        Structural index of the equations (1) with the servo constraints; None where the analysis does not apply.
    equation_offsets, variable_offsets : tuple of (str, int)
        Offsets c and d of the signature method by name.
    internal_degrees_of_freedom : int or None
        Dimension of the internal dynamics: how many initial values the inverse problem leaves free.
    internal_states : tuple of str
        Variables chosen as states, a prime for every derivative.
    condition : float
        Largest condition number of the equilibrated system Jacobian along the reference, or at the home
        configuration if no reference is known.
    classification : str
        "flat", "minimum phase", "weakly minimum phase" (not damped), "non-minimum phase" or "singular here".
    eigenvalues : tuple of complex
        Of the internal dynamics linearised at rest.
    remedy : str
        What had to be done to the equations before the analysis applied.
    reason : str
        Why the problem is singular, with the time if a reference is known.
    rank_loss : str
        Where along the reference the constraints lose rank, so that two motions go on from there.
    advice : str
        Which route is enough.
    """

    name: str
    degrees_of_freedom: int
    inputs: int
    outputs: int
    index: int | None
    equation_offsets: tuple[tuple[str, int], ...]
    variable_offsets: tuple[tuple[str, int], ...]
    internal_degrees_of_freedom: int | None
    internal_states: tuple[str, ...]
    condition: float
    classification: str
    eigenvalues: tuple[complex, ...] = ()
    remedy: str = ""
    reason: str = ""
    rank_loss: str = ""

    @property
    def advice(self) -> str:
        """Which route is enough."""
        return ADVICE[self.classification]

    def __str__(self) -> str:
        rows = [
            ("degrees of freedom", str(self.degrees_of_freedom)),
            ("inputs, outputs", f"{self.inputs}, {self.outputs}"),
            ("index", "unknown" if self.index is None else str(self.index)),
            ("internal dynamics", _dimension(self)),
            ("eigenvalues", ", ".join(f"{value:.4g}" for value in self.eigenvalues)),
            ("classification", self.classification),
            ("reason", self.reason),
            ("loss of rank", self.rank_loss),
            ("remedy", self.remedy),
            ("condition", f"{self.condition:.3g}"),
            ("equations", _offsets(self.equation_offsets)),
            ("variables", _offsets(self.variable_offsets)),
            ("advice", self.advice),
        ]
        return "\n".join([self.name, *(f"  {label:<20}{text}" for label, text in rows if text)])


def _dimension(report: StructureReport) -> str:
    if report.internal_degrees_of_freedom is None:
        return "unknown"
    states = f" ({', '.join(report.internal_states)})" if report.internal_states else ""
    return f"{report.internal_degrees_of_freedom} degrees of freedom{states}"


def _offsets(offsets: tuple[tuple[str, int], ...]) -> str:
    """Group names by offset: `4: q.x, q.y; 2: q.s`."""
    orders = sorted({order for _, order in offsets}, reverse=True)
    shown = []
    for order in orders:
        names = [name for name, own in offsets if own == order]
        listed = ", ".join(names) if len(names) <= 6 else f"{', '.join(names[:4])} and {len(names) - 4} more"
        shown.append(f"{order}: {listed}")
    return "; ".join(shown)


def analyse(subject: Scene | MechanicalSystem, *, model: str | None = None) -> StructureReport:
    """Analyse a servo constraint problem before it is solved.

    The signature method of Pryce gives index and internal degrees of freedom; the internal dynamics, if any, are
    linearised at rest. For a scene the limits and the system Jacobian are watched along its reference.

    Parameters
    ----------
    subject : Scene or MechanicalSystem
        What to analyse; a scene with its own parameters and reference, a system at its home.
    model : str, optional
        Model of the scene; its smallest when not given.

    Returns
    -------
    StructureReport
        Never raises for a singular problem: that is a classification, with the reason.
    """
    if isinstance(subject, MechanicalSystem):
        return _report(subject, np.array(subject.home_parameters), None)
    base = subject.model(model)
    p = base.parameters.values(subject.parameters)
    return _report(base, p, subject)


def _report(system: MechanicalSystem, p: Array, scene: Scene | None) -> StructureReport:
    complete = system
    system, dropped = prepared(system, p)
    left_out = f"redundant constraints left out: {complete.listed_constraints(dropped)}" if dropped else ""
    outline = StructureReport(
        name=system.name,
        degrees_of_freedom=system.degrees_of_freedom,
        inputs=len(system.inputs),
        outputs=len(system.outputs),
        index=None,
        equation_offsets=(),
        variable_offsets=(),
        internal_degrees_of_freedom=None,
        internal_states=(),
        condition=np.inf,
        classification=SINGULAR,
    )
    try:
        array = derivative_array(system)
    except InvalidModel as error:
        return replace(outline, reason=str(error))
    found = array.signature
    outline = replace(
        outline,
        index=found.index,
        equation_offsets=tuple(zip(found.equations.equations, found.equation_offsets, strict=True)),
        variable_offsets=tuple(zip(array.names, found.variable_offsets, strict=True)),
        internal_degrees_of_freedom=found.degrees_of_freedom,
        internal_states=tuple(array.names[j] + "'" * order for j, order in array.states),
        remedy="; ".join(each for each in (left_out, found.equations.remedy) if each),
    )
    condition, reason, rank_loss = _along_reference(array, p, scene)
    outline = replace(outline, condition=condition, reason=reason, rank_loss=rank_loss)
    if reason:
        return outline
    eigenvalues = internal_eigenvalues(array, p)
    return replace(outline, eigenvalues=eigenvalues, classification=_classified(eigenvalues))


def _classified(eigenvalues: tuple[complex, ...]) -> str:
    if not eigenvalues:
        return FLAT
    if not np.isfinite(eigenvalues).all():
        return SINGULAR
    growth = max(value.real - DAMPED * abs(value) for value in eigenvalues)
    decay = max(value.real + DAMPED * abs(value) for value in eigenvalues)
    if growth > 0.0:
        return NON_MINIMUM_PHASE
    return MINIMUM_PHASE if decay < 0.0 else WEAKLY_MINIMUM_PHASE


def internal_dynamics(scene: Scene, model: str | None = None) -> tuple[str, float]:
    """Return the classification of a scene's internal dynamics and their fastest growth rate in 1/s.

    Unlike `analyse` it does not look along the reference.
    """
    base = scene.model(model)
    p = base.parameters.values(scene.parameters)
    eigenvalues = _eigenvalues(prepared(base, p)[0], tuple(p))
    return _classified(eigenvalues), max((value.real for value in eigenvalues), default=0.0)


@lru_cache(maxsize=256)
def _eigenvalues(system: MechanicalSystem, p: tuple[float, ...]) -> tuple[complex, ...]:
    return internal_eigenvalues(derivative_array(system), np.array(p))


def _along_reference(array: DerivativeArray, p: Array, scene: Scene | None) -> tuple[float, str, str]:
    """Return the worst condition of the system Jacobian and, if there is one, why or where the path is singular."""
    system = array.system
    if scene is None:
        times, gamma = np.zeros(1), np.zeros((1, array.reference_order + 1, len(system.outputs)))
        gamma[0, 0] = system.home
    else:
        try:
            require_feasible(scene.reference, system, scene.limits, p)
            times = np.linspace(scene.reference.start_time, scene.reference.end_time, _SURVEY_POINTS)
            gamma = scene.reference.jet(times, array.reference_order)
        except InvalidReference as error:
            return np.inf, str(error), ""
    invert, condition = _survey_functions(array)
    worst, found = 0.0, []
    for time, jet in zip(times, gamma, strict=True):
        values, _, _ = invert(jet.T, p)
        here = condition(values, jet, p)
        if not here < _SINGULAR_CONDITION:
            reason = f"{system.name} is singular at t = {time:.6g} s: the system Jacobian has condition {here:.2g}"
            return here, reason, ""
        worst = max(worst, here)
        found.append(values)
    if scene is None or array.states:
        return worst, "", ""  # with internal dynamics the configurations are not those of the motion
    places = [array.unknowns.index((k, 0)) for k in range(len(system.coordinates))]
    losses = rank_losses(system, scene.reference, p, times, np.array(found)[:, places])
    return worst, "", "; ".join(map(str, losses))


@lru_cache(maxsize=32)
def _survey_functions(array: DerivativeArray) -> tuple[Call, Callable[[Array, Array, Array], float]]:
    """Return the exact inversion, and the condition of the system Jacobian as a function of its result."""
    system, found = array.system, array.signature
    reference = system.gamma[:, : array.reference_order + 1]
    entries = array.column(array.unknowns)
    J = ca.substitute(system_jacobian(found), found.equations.y, array.y[:, :3])
    evaluate = Call(ca.Function("sc_J", [entries, reference, system.p], [ca.densify(J)]))

    def condition(values: Array, jet: Array, p: Array) -> float:
        (matrix,) = evaluate(values, jet.T, p)
        return condition_number(matrix)

    return Call(compile_inversion(array)), condition


def condition_number(matrix: Array) -> float:
    """Return the condition number of a matrix after its rows and columns are scaled to unit maximum."""
    if not np.isfinite(matrix).all():
        return float("inf")
    values = np.linalg.svd(equilibrated(matrix), compute_uv=False)
    return float(values[0] / values[-1]) if values[-1] > 0.0 else float("inf")
