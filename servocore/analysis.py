"""`analyse`: the class of a servo constraint problem, and the route that suits it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from servocore.checks.before_run import (
    ADVICE,
    FLAT,
    MINIMUM_PHASE,
    SINGULAR,
    internal_dynamics,
    require_feasible,
)
from servocore.checks.failure_causes import SINGULAR_CONDITION, out_of_reach, singular, singular_in_words
from servocore.checks.motion import motion_of
from servocore.errors import IntegrationFailed, InvalidModel, InvalidReference
from servocore.model.scene import Scene
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array, at_instants
from servocore.numerics.components import condition_numbers
from servocore.problem import Problem
from servocore.stepping.exact_evaluation import exact_unknowns
from servocore.structure.derivative_array import DerivativeArray
from servocore.structure.inversion import system_jacobian, system_jacobian_entries

_SURVEY_POINTS = 201
_STRIDE = 8  # of these instants between those of a first look


@dataclass(frozen=True)
class StructureReport:
    """The results of `analyse`; `print` shows them as a page.

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
        Of the internal dynamics linearized at rest.
    remedy : str
        Changes of the equations that the analysis needed.
    reason : str
        Why the problem is singular, with the time if a reference is known.
    rank_loss : str
        Where along the reference the constraints lose rank, so that two motions go on from there.
    hint : str
        Other choices for the model, see `Scene`.
    advice : str
        Which route is enough, and the hint where the problem is singular or its internal dynamics are not damped.
    """

    name: str
    degrees_of_freedom: int
    inputs: int
    outputs: int
    index: int | None = None
    equation_offsets: tuple[tuple[str, int], ...] = ()
    variable_offsets: tuple[tuple[str, int], ...] = ()
    internal_degrees_of_freedom: int | None = None
    internal_states: tuple[str, ...] = ()
    condition: float = np.inf
    classification: str = SINGULAR
    eigenvalues: tuple[complex, ...] = ()
    remedy: str = ""
    reason: str = ""
    rank_loss: str = ""
    hint: str = ""

    @property
    def advice(self) -> str:
        """Which route is enough, and other choices of a model where it is singular or not damped."""
        hint = "" if self.classification in (FLAT, MINIMUM_PHASE) else self.hint
        return "; ".join(filter(None, (ADVICE[self.classification], hint)))

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
        names = [name for name, offset in offsets if offset == order]
        listed = ", ".join(names) if len(names) <= 6 else f"{', '.join(names[:4])} and {len(names) - 4} more"
        shown.append(f"{order}: {listed}")
    return "; ".join(shown)


def analyse(subject: Scene | MechanicalSystem, *, model: str | None = None) -> StructureReport:
    """Analyse a servo constraint problem before it is solved.

    The signature method of Pryce gives index and internal degrees of freedom; the internal dynamics, if any, are
    linearized at rest. For a scene the limits and the system Jacobian are watched along its reference.

    Parameters
    ----------
    subject : Scene or MechanicalSystem
        A scene with its parameters and reference, or a system at its home.
    model : str, optional
        Model of the scene; its smallest when not given.

    Returns
    -------
    StructureReport
        Never raises for a singular problem: that is a classification, with the reason.
    """
    problem = Problem.of(subject, model)
    instants = 1 if isinstance(subject, MechanicalSystem) else _SURVEY_POINTS  # a system alone rests at its home
    system, left_out = problem.system, problem.left_out
    outline = StructureReport(system.name, system.degrees_of_freedom, len(system.inputs), len(system.outputs))
    outline = replace(outline, hint=subject.hint if isinstance(subject, Scene) else "")
    if isinstance(problem.resolved.outcome, InvalidModel):
        return replace(outline, reason=str(problem.resolved.outcome))
    outline = _with_structure(outline, problem.array, left_out)
    condition, reason, rank_loss = _along_reference(problem, instants)
    outline = replace(outline, condition=condition, reason=reason, rank_loss=rank_loss)
    if reason:
        return outline
    dynamics = internal_dynamics(problem)
    return replace(outline, eigenvalues=dynamics.eigenvalues, classification=dynamics.kind)


def _with_structure(outline: StructureReport, array: DerivativeArray, left_out: str) -> StructureReport:
    structure = array.signature
    what_was_done = f"redundant constraints left out: {left_out}" if left_out else ""
    return replace(
        outline,
        index=structure.index,
        equation_offsets=tuple(zip(structure.equations.equations, structure.equation_offsets, strict=True)),
        variable_offsets=tuple(zip(array.names, structure.variable_offsets, strict=True)),
        internal_degrees_of_freedom=structure.degrees_of_freedom,
        internal_states=tuple(name + "'" * order for name, order in array.named_states),
        remedy="; ".join(remedy for remedy in (what_was_done, structure.equations.remedy) if remedy),
    )


def _largest_conditions(problem: Problem, unknowns: Array, jets: Array) -> Array:
    """Return the condition numbers of the system Jacobian at instants, zero where not computed.

    They take most of the analysis of a large system. Along a path they vary smoothly, but for singular instants, which
    are peaks as well: between the instants of a first look those beside its local maxima are computed.
    """
    (entries, parts), conditions = system_jacobian_entries(problem.array), np.zeros(len(jets))
    at = np.arange(0, len(jets), _STRIDE)
    for look in range(2):
        found = at_instants(entries, unknowns[:, at], jets=jets[at], p=problem.p)[0]
        conditions[at] = first = condition_numbers(parts, found)
        if not look:
            peaks = at[(first > np.append(0.0, first[:-1])) & (first >= np.append(first[1:], 0.0))]
            beside = np.abs(np.arange(len(jets))[:, None] - peaks).min(axis=1) < _STRIDE
            at = np.flatnonzero(beside | ~np.isfinite(unknowns).all(axis=0))
    return conditions


def _along_reference(problem: Problem, instants: int) -> tuple[float, str, str]:
    """Return the worst condition of the system Jacobian and, if there is one, why or where the path is singular."""
    array, reference = problem.array, problem.reference
    try:
        require_feasible(problem)
        times = np.linspace(reference.start_time, reference.end_time, instants)
        jets = reference.jet(times, array.reference_order)
    except InvalidReference as error:
        return np.inf, str(error), ""
    unknowns, rank_loss = exact_unknowns(problem, times)[0], ""
    if problem.flat:
        with suppress(IntegrationFailed):
            motion = motion_of(problem, times, unknowns)
            unknowns = motion.states
            rank_loss = "; ".join(str(each) for each in motion.passages if each.constraints)
    conditions = _largest_conditions(problem, unknowns, jets)
    if not (conditions < SINGULAR_CONDITION).all():
        k = int((~(conditions < SINGULAR_CONDITION)).argmax())
        matrix = np.asarray(system_jacobian(problem.array)(unknowns[:, k], jets[k].T, problem.p))
        singularity = "" if np.isfinite(matrix).all() else singular(problem)
        reason = (
            out_of_reach(problem) or singularity or singular_in_words(problem, float(times[k]), unknowns[:, k], matrix)
        )
        return float(conditions[k]), reason, ""
    return float(conditions.max()), "", rank_loss
