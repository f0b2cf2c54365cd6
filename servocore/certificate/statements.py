"""Statements about a proved motion: bounds of quantities, by enclosures on boxes that are halved, and of errors."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import casadi as ca
import numpy as np

from servocore.certificate.chebyshev import UNIT, Arithmetic, Model, arithmetic, magnitude, norm
from servocore.certificate.equations import Equations
from servocore.certificate.proof import Proof, smallest_peaks
from servocore.certificate.walk import Walk
from servocore.model.limits import Limit, Named, RunQuantity, reported_quantities
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once
from servocore.numerics.step_operations import JUMPS, holds_any
from servocore.problem import LEFT_OUT_HOLDS, ResolvedSystem
from servocore.references.base import time_grid
from servocore.solution import Solution
from servocore.stepping.readings import with_rates
from servocore.structure.derivative_array import DerivativeArray

Verdict = Literal["proved", "undecided", "refuted"]
VERDICTS: tuple[Verdict, ...] = ("proved", "undecided", "refuted")
"""In their order: of several statements the worst counts."""

LIMIT = "limit of "
"""Beginning of statements on limits."""

DEFINITE = "mass matrix definite on all motions that the constraints allow"
"""A statement."""

_HALVINGS, _MOST = 44, 4000  # of a box, and boxes at once: a value that touches its bound is never decided
_HALVED_RUNS = 4  # how often intervals are halved for integrals
_ANY = 1e9  # an angle that is less has no jump
_SPIKE = 2.0  # times the largest value at the instants: beyond it, these do not show the input
_UNSHOWN = "the instants do not show it"
_FLOOR = 1e-6  # of the largest input: one that is less may be round-off


@dataclass(frozen=True)
class Statement:
    """One thing that is proved, refuted or left undecided.

    Attributes
    ----------
    what : str
        What is stated.
    verdict : str
        "proved", "refuted" or "undecided".
    sentence : str
        Where it fails and by how much, or what was found.
    time : float or None
        When it fails.
    begin, end : float
        From when to when, in s.
    """

    what: str
    verdict: Verdict
    sentence: str = ""
    time: float | None = None
    begin: float = -math.inf
    end: float = math.inf

    def __str__(self) -> str:
        return f"{self.verdict}: {self.what}" + (f" ({self.sentence})" if self.sentence else "")


def worst(statements: Iterable[Statement]) -> Statement:
    """Return the first of the statements with the worst verdict."""
    return max(statements, key=lambda each: VERDICTS.index(each.verdict))


@dataclass(frozen=True)
class ErrorBound:
    """A bound of the error of an input.

    Attributes
    ----------
    at_instants, between : float
        In the unit of the input: at the instants that are reported, and of the enclosure at any time.
    peak : float
        Largest magnitude of the input, in its unit.
    unit : str
        Of all three.
    """

    at_instants: float
    between: float
    peak: float
    unit: str

    @property
    def relative(self) -> float:
        """The bound at instants as a share of the peak."""
        return self.at_instants / self.peak


Claim: TypeAlias = tuple[str, Limit]
"""The statement that a claim is part of, and a quantity that must stay within bounds."""


@made_once
def claims_of(resolved: ResolvedSystem) -> tuple[Claim, ...]:
    """Return the claims about every motion of a system: signs, constraints left out as redundant, and masses."""
    claims = [
        (f"{each.name} positive", Limit(each.name, each.unit, 0.0, each.wrong_sign, Named(each.name)))
        for each in reported_quantities(resolved.system).values()
        if each.positive
    ]
    for k in range(resolved.left_out.numel()):
        share, text = resolved.left_out_shares[k], f"constraint {k + 1} of them does not hold"
        off = Limit("", "of its size", -LEFT_OUT_HOLDS, text, lambda _, share=share: share, upper=LEFT_OUT_HOLDS)
        claims.append(("redundant constraints hold", off))
    for pivot in ca.vertsplit(_pivots(resolved.system)):
        positive = Limit("", "kg.m2", 0.0, "the mass matrix is negative", lambda _, pivot=pivot: pivot)
        claims.append((DEFINITE, positive))
    return tuple(claims)


def _pivots(system: MechanicalSystem) -> ca.SX:
    """Return the pivots of M + w G^T G by elimination, in units of the nominal magnitudes of the coordinates.

    M is definite on all velocities that the holonomic constraints allow if that matrix is, for any w: on the kernel of
    G the second term vanishes. It is definite if all pivots are positive. The weight makes both equally large.
    """
    scale = ca.diag(ca.DM(system.coordinates.nominal))
    M, G = ca.mtimes(ca.mtimes(scale, system.mass), scale), ca.mtimes(system.G, scale)
    sizes = ca.Function("sc_sizes", [system.q, system.p, system.time], [ca.trace(M), ca.sumsqr(G)])
    size_M, size_G = (float(each) for each in sizes(*system.home_configuration(), np.zeros(system.time.numel())))
    pivots, *_ = ca.ldl(M + size_M / (size_G or 1.0) * ca.mtimes(G.T, G))
    return pivots


@made_once
def walk_of_limits(equations: Equations, limits: tuple[Limit, ...]) -> Walk:
    """Return limited quantities, or their rates, as a walk."""
    return Walk(ca.vertcat(*_readings(equations, limits)), equations.symbols)


def _readings(equations: Equations, limits: Sequence[Limit]) -> list[ca.SX]:
    return with_rates(equations.array, [(each.on(equations.array.system), each.rate) for each in limits])[0]


@made_once
def known(equations: Equations, limit: Limit) -> bool:
    """Whether the equations enclose all derivatives that a limit compares, of the path and of unknowns."""
    enclosed = {each.element_hash() for each in ca.vertsplit(equations.symbols)}
    return all(each.element_hash() in enclosed for each in ca.symvar(*_readings(equations, [limit])))


Decision: TypeAlias = tuple[Verdict, Array, float, tuple[float, float]]
"""Whether a quantity keeps its bounds; where it fails or is not decided the arguments of the walk and the quantity, NaN
if that is not known; bounds of the quantity where it is proved to keep its own."""


def decided(ring: Arithmetic, boxes: Model, walk: Walk, k: int, models: Model, limit: Limit) -> Decision:
    """Decide whether the k-th quantity of a walk stays within bounds on all boxes, halving those on which it may not.

    They are halved by the variable that it varies most with; `models` are those of the quantity on the boxes.
    """
    least, most = np.inf, -np.inf
    for halvings in range(_HALVINGS):
        low, high = ring.span(models)
        kept = (low > limit.bound) & (high < limit.upper)
        least, most = min(least, low.min(initial=np.inf, where=kept)), max(most, high.max(initial=-np.inf, where=kept))
        if kept.all():
            break
        boxes, models = boxes[..., ~kept], models[..., ~kept]
        values, noise = ring.values(models), models[-1] + (len(models) + 7) * UNIT * norm(models[:-1])
        beyond = np.maximum(limit.bound - values, values - limit.upper)
        certain = (beyond.max(axis=0) > noise) & np.isfinite(noise)
        last = halvings == _HALVINGS - 1 or len(noise) > _MOST
        lost = certain if certain.any() else last | ~np.isfinite(boxes[-1]).all(axis=0)
        if lost.any():
            worst = np.where(lost, beyond, -np.inf)
            node, box = (int(each) for each in np.unravel_index(int(worst.argmax()), worst.shape))
            value = float(values[node, box]) if np.isfinite(noise[box]) else np.nan
            at = ring.at_nodes[node] @ boxes[:-1, :, box]
            return "refuted" if certain.any() else "undecided", at, value, (least, most)
        c = models[:-1] / np.maximum(norm(models[:-1]), 1e-300)
        boxes = ring.halved(boxes, int(np.argmax([norm(c[order > 0]).sum() for order in ring.orders])))
        models = walk(ring, boxes)[:, k]
    return "proved", np.zeros(0), np.nan, (least, most)


def stated(proof: Proof, claims: Sequence[Claim], jumps: Collection[float] = ()) -> list[Statement]:
    """Decide claims, and those about every motion, between the instants too: a statement is proved if all its are."""
    claims = [*claims, *claims_of(proof.problem.resolved)]
    # Walks are kept, whatever the bounds are.
    bare = {each: replace(each, bound=-math.inf, upper=math.inf) for _, each in claims if not each.over_run}
    limits = [limit for limit, each in bare.items() if known(proof.equations, each)]
    walk, ring = walk_of_limits(proof.equations, tuple(bare[limit] for limit in limits)), proof.ring
    boxes = proof.enclosures[..., proof.within]
    models = walk(ring, boxes)
    decisions = {limit: decided(ring, boxes, walk, k, models[:, k], limit) for k, limit in enumerate(limits)}
    turning = [
        limit for k, limit in enumerate(limits)
        if decisions[limit][0] != "proved" and limit.counts_turns(proof.problem.system)
        and decided(ring, boxes, walk, k, models[:, k], replace(limit, bound=-_ANY, upper=_ANY))[0] != "proved"
    ]  # fmt: skip
    found, text = dict[str, Statement](), "it depends on higher derivatives of the path than the inputs do"
    if not proof.problem.flat:
        text = "rates of inputs are not enclosed where there are internal dynamics"
    for what, limit in claims:
        statement = Statement(what, "undecided", text)
        if added := limit.over_run:
            statement = _of_run(proof, what, limit, added)
        elif limit in turning:
            statement = Statement(what, "undecided", "it comes to half a turn, and is known up to whole turns")
        elif limit in decisions:
            statement = _of_all_times(proof, what, limit, decisions[limit], jumps)
        found[what] = worst([found.get(what, statement), statement])
    return [*found.values(), *_step_statement(proof.problem.system)]


@made_once
def _step_statement(system: MechanicalSystem) -> list[Statement]:
    """State that a potential or masses with steps are not understood: a step of energy is an impulse.

    The equations hold the derivative, which is zero but at the step.
    """
    if not holds_any(ca.vertcat(system.potential, ca.vec(ca.densify(system.mass))), JUMPS):
        return []
    text = "the potential or a mass has a step, of which the equations of motion know nothing"
    return [Statement("no impulses", "undecided", text)]


def _of_all_times(proof: Proof, what: str, limit: Limit, decision: Decision, jumps: Collection[float]) -> Statement:
    verdict, at, value, extent = decision
    if verdict == "proved" and limit.rate and jumps:
        text = f"inputs jump at t = {min(jumps):.6g} s, where rates have no bound"
        return Statement(what, "undecided", text, min(jumps))
    if verdict == "proved":
        text = "it stays from {} to {}".format(*map(limit.with_unit, extent)) if limit.quantity else ""
        return Statement(what, verdict, text)
    if what == DEFINITE and proof.problem.system.G.nnz():
        verdict = "undecided"  # the matrix may be negative on motions that the constraints exclude
    names, time = proof.problem.system.parameters.names, float(at[-1])  # the last argument, and before it parameters
    place = ", ".join([f"t = {time:.6g} s", *(f"{names[k]} = {at[k - len(names) - 1]:.6g}" for k in proof.boxed)])
    bound = limit.bound if value - limit.bound < limit.upper - value else limit.upper
    text = f"{'it is' if verdict == 'refuted' else 'not decided: it is about'} {limit.with_unit(value)} at {place},"
    side = "beyond" if verdict == "refuted" else "from"
    text += f" {limit.with_unit(abs(value - bound))} {side} the bound of {limit.with_unit(bound)}"
    text += f", {limit.reason}" if limit.reason else ""
    if not np.isfinite(value):
        text = f"{'it has no bound' if proof.joined.all() else 'the motion is not proved'} at {place}"
    return Statement(what, verdict, text, time)


def _of_run(proof: Proof, what: str, limit: Limit, added: RunQuantity) -> Statement:
    """Decide a limit of what the run adds up, from enclosures of the integral over all intervals.

    The mean of the Chebyshev polynomial of order k over time is 1/(1 - k^2) for even k, else 0; terms that parameters
    change count by their magnitudes. Rounding is bounded as that of values, and of sums by the sum of all magnitudes.
    The bounds are infinite, or no numbers, where the motion is not proved.
    """
    ring, inside = proof.ring, proof.within
    boxes, widths = proof.enclosures[..., inside], (proof.end - proof.begin)[inside]
    # Halves of parameters have no common time: boxes with parameters stay whole.
    for _ in range(0 if proof.boxed else _HALVED_RUNS):
        boxes, widths = ring.halved(boxes, 0), np.tile(widths / 2.0, 2)
    k, alone = ring.orders[0], (ring.orders[1:] == 0).all(axis=0)
    found = walk_of_limits(proof.equations, (limit,))(ring, boxes)[:, 0]
    c, middle = found[:-1], (alone / np.where(k % 2, np.inf, 1.0 - k**2)) @ found[:-1]
    radius = found[-1] + norm(c[~alone]) + (len(c) + 8) * UNIT * norm(c)
    off = (radius + 4.0 * len(widths) * UNIT * (np.abs(middle) + radius)) @ widths
    total = middle @ widths + np.array([-1.0, 1.0]) * (1.0 + 1e-9) * off
    low, high = added.of_sum(total, proof.problem.reference.duration).tolist()
    kept = limit.bound <= low and high <= limit.upper and known(proof.equations, limit)
    verdict: Verdict = "proved" if kept else "refuted" if low > limit.upper or high < limit.bound else "undecided"
    between = f"from {limit.with_unit(low)} to {limit.with_unit(high)} over the run"
    text = f"it is {between}" if np.isfinite([low, high]).all() else "the motion is not proved at all times"
    return Statement(what, verdict, text)


# At instants -------------------------------------------------------------------------------------------------------


def compared(
    proof: Proof, solution: Solution | None, tolerance: float
) -> tuple[dict[str, ErrorBound], list[Statement], list[Claim]]:
    """Bound errors of inputs, at the instants of a solution or of a default run, and state the consequence.

    Inputs and coordinates of a solution are right, and it is claimed that no input goes far beyond its values at the
    instants; where equations switch inputs have no value to compare with. Of a motion that is not proved to its end
    only the claim is left: a value far beyond refutes it wherever the motion is joined, with what is reported where it
    is not.
    """
    inputs, places = proof.problem.system.inputs, proof.equations.inputs
    t = time_grid(proof.problem.reference, None) if solution is None else solution.t
    calm = ~proof.jumping[np.searchsorted(proof.end[:-1], t, side="right")]
    t = t[calm]
    if not len(t):
        return {}, [Statement("inputs at instants", "undecided", "inputs may jump at every instant")], []
    array, names = proof.equations.array, [each.name for each in inputs]
    reported_as = {k: reported_name(array, array.determined[k]) for k in proof.equations.motion}
    moved = [k for k, name in reported_as.items() if solution is not None and name in solution]
    names += [reported_as[k] for k in moved]
    unknowns = proof.at(proof.enclosures[:, [*places, *moved]], t)
    middle, radius = unknowns[0], magnitude(unknowns[1:])
    reported = middle if solution is None else np.stack([solution[name][calm] for name in names])
    middle = np.where(np.isfinite(radius), middle, reported)  # the instants show what is not proved, too
    apart, peaks = np.abs(reported - middle), np.abs(middle).max(axis=1)
    least = [max(_FLOOR * peaks[: len(inputs)].max(initial=0.0), 1e-300)] * len(inputs)
    peaks = np.maximum(peaks, [*least, *smallest_peaks(proof.problem, [array.determined[k] for k in moved])])
    between = proof.x[-1, places][:, ~proof.jumping].max(axis=1)
    bounds, found, claims = dict[str, ErrorBound](), list[Statement](), list[Claim]()
    for k, each in enumerate(inputs):
        peak, what = float(peaks[k]), f"{each.name} between instants at most twice its peak at instants"
        bounds[each.name] = ErrorBound(float((apart + radius)[k].max()), float(between[k]), peak, each.unit)
        spike = Limit(each.name, each.unit, -_SPIKE * peak, _UNSHOWN, Named(each.name), upper=_SPIKE * peak)
        claims += [] if proof.boxed else [(what, spike)]
    if not proof.joined.all():
        return {}, [], claims
    if solution is not None:
        low, high = ((apart + side * radius) / peaks[:, None] for side in (-1.0, 1.0))
        verdict: Verdict = "proved" if high.max() <= tolerance else "refuted" if low.max() > tolerance else "undecided"
        place, at = np.unravel_index(int(high.argmax()), high.shape)
        text = f"{names[int(place)]} is off by at most {high.max():.2g} of its peak, at t = {t[at]:.6g} s"
        found.append(Statement(f"inputs and coordinates within {tolerance:g} of peaks", verdict, text, float(t[at])))
    return bounds, found, claims


def reported_name(array: DerivativeArray, unknown: tuple[int, int]) -> str:
    """Return the name by which a solution may report an unknown, empty for a derivative."""
    j, order = unknown
    return "" if order else array.names[j].partition(".")[2]


def enclosed(proof: Proof, limits: Sequence[Limit], t: Array) -> Array:
    """Return bounds (limits, N, 2) of limited quantities at times, over all parameters of the box."""
    ring, walk = arithmetic((0, *proof.ring.degrees[1:])), walk_of_limits(proof.equations, tuple(limits))
    bounds = np.stack(ring.span(walk(ring, proof.at(proof.enclosures, t))), axis=-1)
    return np.where(np.isfinite(bounds).all(axis=-1, keepdims=True), bounds, [-np.inf, np.inf])
