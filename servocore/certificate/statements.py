"""Statements about a proved motion: quantities stay within bounds, by enclosures on boxes that are halved."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.certificate.chebyshev import UNIT, Arithmetic, norm
from servocore.certificate.equations import Equations
from servocore.certificate.proof import Proof
from servocore.certificate.walk import Walk
from servocore.model.limits import Limit, Named, reported_quantities
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.numerics.expressions import highest_derivative
from servocore.numerics.memoization import made_once
from servocore.problem import LEFT_OUT_HOLDS, ResolvedSystem

Verdict = Literal["proved", "refuted", "undecided"]

LIMIT = "limit of "
"""Beginning of statements on limits."""

_HALVINGS, _MOST = 44, 4000  # of a box, and boxes at once: a value that touches its bound is never decided
_HALVED_FIRST = 8  # how often boxes are halved where enclosures are wide, as of a magnitude that turns
_HALVED_RUNS = 0, 4, 7  # how often intervals are halved for integrals, the next number where one is undecided
_POSITIVE = 1e-300  # a pivot that is not zero


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


@dataclass(frozen=True, eq=False)
class Claim:
    """A quantity that must stay within bounds.

    Attributes
    ----------
    what : str
        The statement that it is part of.
    limit : Limit
        The quantity and its bounds.
    told : str
        What is the case where it leaves its bounds; when empty its value is told.
    refutable : bool
        Whether the statement is false then.
    """

    what: str
    limit: Limit
    told: str = ""
    refutable: bool = True


@made_once
def claims_of(resolved: ResolvedSystem) -> tuple[Claim, ...]:
    """Return what is claimed of every motion of a system: signs, constraints left out as redundant, and masses."""
    signed = [each for each in reported_quantities(resolved.system).values() if each.positive]
    claims = [
        Claim(f"{each.name} positive", Limit(each.name, each.unit, 0.0, each.wrong_sign, Named(each.name)))
        for each in signed
    ]
    for k in range(resolved.left_out.numel()):
        share = partial(_entry, resolved.left_out_shares, k)
        off = Limit("", "", -LEFT_OUT_HOLDS, "", share, upper=LEFT_OUT_HOLDS)
        claims.append(Claim("redundant constraints hold", off, f"constraint {k + 1} of them does not hold"))
    pivots, free = _pivots(resolved.system), not resolved.system.G.nnz()
    what = "mass matrix definite on all motions that the constraints allow"
    for k in range(pivots.numel()):
        pivot = Limit("", "", _POSITIVE, "", partial(_entry, pivots, k))
        claims.append(Claim(what, pivot, "the mass matrix is negative", free))
    return tuple(claims)


def _entry(expressions: ca.SX, k: int, system: MechanicalSystem) -> ca.SX:  # noqa: ARG001 - called with the system
    return expressions[k]


def _pivots(system: MechanicalSystem) -> ca.SX:
    """Return the pivots of M + w G^T G by elimination, in units of the nominal magnitudes of the coordinates.

    M is definite on all velocities that the holonomic constraints allow if that matrix is, for any w > 0: on the kernel
    of G the second term vanishes. It is definite if all pivots are positive. The weight makes both equally large.
    """
    scale = ca.diag(ca.DM(system.coordinates.nominal))
    M, G = ca.mtimes(ca.mtimes(scale, system.mass), scale), ca.mtimes(system.G, scale)
    largest = [ca.mmax(ca.fabs(ca.vertcat(ca.SX(1, 1), ca.vec(ca.densify(each))))) for each in (M, G)]
    sizes = ca.Function("sc_sizes", [system.q, system.p, system.time], largest)
    size_M, size_G = (float(each) for each in sizes(*system.home_configuration(), np.zeros(system.time.numel())))
    pivots, *_ = ca.ldl(M + size_M / (size_G**2 or 1.0) * ca.mtimes(G.T, G))
    return pivots


@made_once
def _unbounded(limit: Limit) -> Limit:
    return replace(limit, bound=-math.inf, upper=math.inf)


@made_once
def walk_of_limits(equations: Equations, limits: tuple[Limit, ...]) -> Walk:
    """Return limited quantities, or their rates, as a walk."""
    return equations.walk([(limit.on(equations.array.system), limit.rate) for limit in limits])


@made_once
def known(equations: Equations, limit: Limit) -> bool:
    """Whether the equations enclose all derivatives of the path that a limit compares."""
    system = equations.array.system
    return highest_derivative(limit.on(system), system.gamma) + limit.rate <= equations.path_order


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes of time and parameters with enclosures of the unknowns, the path and the parameters on them.

    Attributes
    ----------
    ring : Arithmetic
        Of the models.
    c, r : ndarray, shape (terms, arguments, boxes) and (arguments, boxes)
        The models.
    low, high : ndarray, shape (boxes, variables)
        Corners of the boxes.
    """

    ring: Arithmetic
    c: Array
    r: Array
    low: Array
    high: Array

    def place(self, box: int, node: int) -> Array:
        """Return time and parameters of a node of a box."""
        low, high = self.low[box], self.high[box]
        return np.asarray((low + high) / 2.0 + (high - low) / 2.0 * self.ring.nodes[node])

    def of(self, chosen: npt.NDArray[np.bool_]) -> Boxes:
        """Return some of the boxes."""
        return Boxes(self.ring, self.c[..., chosen], self.r[:, chosen], self.low[chosen], self.high[chosen])

    def halved(self, c: Array) -> Boxes:
        """Return the halves of the boxes, each by the variable that polynomials (terms, N, boxes) vary most with."""
        degrees, size = self.ring.degrees, np.maximum(norm(c), 1e-300)
        orders = np.indices([d + 1 for d in degrees]).reshape(len(degrees), -1)
        by = np.argmax([(norm(c[order > 0]) / size).sum(axis=0) for order in orders], axis=0)
        parts = list[tuple[Array, ...]]()
        for k in range(len(degrees)):
            own = self.of(by == k)
            for late, model in enumerate(self.ring.halved((own.c, own.r), k)):
                corners = own.low.copy(), own.high.copy()
                corners[1 - late][:, k] = (own.low[:, k] + own.high[:, k]) / 2.0
                parts.append((*model, *corners))
        return Boxes(self.ring, *_together(parts))


def boxes_of(proofs: Sequence[Proof]) -> Boxes:
    """Return the intervals of proofs within the path as boxes."""
    parts = list[tuple[Array, ...]]()
    for proof in proofs:
        inner = [k for k, each in enumerate(proof.intervals) if not each.outside]
        sides = ([getattr(proof.intervals[k], name) for k in inner] for name in ("begin", "end"))
        corners = (
            np.column_stack([times, *(np.full(len(inner), box[end]) for box in proof.boxed.values())])
            for end, times in enumerate(sides)
        )
        parts.append((proof.enclosures[0][..., inner], proof.enclosures[1][:, inner], *corners))
    return Boxes(proofs[0].ring, *_together(parts))


def _together(parts: Sequence[tuple[Array, ...]]) -> Iterator[Array]:
    return (np.concatenate(some, axis) for some, axis in zip(zip(*parts, strict=True), (2, 1, 0, 0), strict=True))


@dataclass
class Decision:
    """Whether a quantity keeps its bounds.

    Attributes
    ----------
    verdict : str
        As that of a statement.
    at : ndarray or None
        Time and parameters where it fails, or where that is not decided.
    value : float
        The quantity there.
    least, most : float
        Bounds of the quantity where it is proved to keep its bounds.
    """

    verdict: Verdict = "proved"
    at: Array | None = None
    value: float = np.nan
    least: float = np.inf
    most: float = -np.inf


def decided(boxes: Boxes, walk: Walk, lower: Array, upper: Array) -> list[Decision]:
    """Decide whether quantities (N,) stay within bounds on all boxes, halving those on which one may not."""
    ring, found = boxes.ring, [Decision() for _ in lower]
    lower, upper, open_ = lower[:, None], upper[:, None], np.ones(len(lower), dtype=bool)
    for halvings in range(_HALVINGS):
        c, r = walk(ring, (boxes.c, boxes.r))
        low, high = ring.span((c, r))
        kept = (low >= lower) & (high <= upper)
        least, most = low.min(axis=1, initial=np.inf, where=kept), high.max(axis=1, initial=-np.inf, where=kept)
        for k, each in enumerate(found):
            each.least, each.most = min(each.least, float(least[k])), max(each.most, float(most[k]))
        some = np.asarray(~kept[open_].all(axis=0))
        if not some.any():
            break
        boxes, c, r, kept = boxes.of(some), c[..., some], r[:, some], kept[:, some]
        values, noise = ring.values(c), r + (len(c) + 8) * UNIT * norm(c)
        beyond = np.maximum(lower - values, values - upper)
        certain = (beyond.max(axis=0) > noise) & np.isfinite(noise)
        # Where the radius is more than what the polynomial varies by, halves tell nothing new.
        wide = ~(norm(c[1:]) >= r / 4.0) & (~np.isfinite(boxes.r).all(axis=0) | (halvings >= _HALVED_FIRST))
        lost = certain | ~kept & (wide | (halvings == _HALVINGS - 1) | (kept.shape[1] > _MOST))
        for k in np.flatnonzero(open_ & lost.any(axis=1)).tolist():
            open_[k] = not certain[k].any()
            worst = np.where(lost[k] if open_[k] else certain[k], beyond[:, k], -np.inf)
            node, box = (int(each) for each in np.unravel_index(int(worst.argmax()), worst.shape))
            found[k].verdict, found[k].at = "undecided" if open_[k] else "refuted", boxes.place(box, node)
            found[k].value = float(values[node, k, box]) if np.isfinite(noise[k, box]) else np.nan
        again = (~kept & ~lost)[open_].any(axis=0)
        if not again.any():
            break
        boxes = boxes.of(again).halved(c[:, open_][..., again])
    return found


def statements_of(proofs: Sequence[Proof], claims: Sequence[Claim], jumps: Collection[float] = ()) -> list[Statement]:
    """Decide claims between the instants too: each statement is proved if all its claims are."""
    equations = proofs[0].equations
    names = ["t", *(proofs[0].problem.system.parameters.names[k] for k in proofs[0].boxed)]
    limits = {each: _unbounded(each.limit) for each in claims if known(equations, _unbounded(each.limit))}
    walk = walk_of_limits(equations, tuple(limits.values()))  # it is kept, whatever the bounds are
    bounds = (np.array([getattr(each.limit, name) for each in limits]) for name in ("bound", "upper"))
    decisions = dict(zip(limits, decided(boxes_of(proofs), walk, *bounds), strict=True))
    found = dict[str, Statement]()
    for each in claims:
        decision, time = decisions.get(each, Decision("undecided")), None
        if each not in decisions:
            sentence = "it depends on higher derivatives of the path than the inputs do"
        elif each.limit.rate and jumps and decision.verdict == "proved":
            decision, time = Decision("undecided"), min(jumps)
            sentence = f"inputs jump at t = {time:.6g} s, where rates have no bound"
        elif decision.at is None:
            extent = map(each.limit.with_unit, (decision.least, decision.most))
            sentence = "it stays from {} to {}".format(*extent) if not each.told else ""
        else:
            sentence, time = _failure(each, decision, names), float(decision.at[0])
        verdict = "undecided" if decision.verdict == "refuted" and not each.refutable else decision.verdict
        before = found.get(each.what)
        if before is None or before.verdict == "proved" or (before.verdict, verdict) == ("undecided", "refuted"):
            found[each.what] = Statement(each.what, verdict, sentence, time)
    return list(found.values())


def run_statements(proofs: Sequence[Proof], limits: Sequence[Limit]) -> list[Statement]:
    """Decide limits of what the run adds up, from enclosures of the integrals over all intervals."""
    proof, path, statements = proofs[0], proofs[0].problem.reference, list[Statement]()
    for limit in limits:
        assert limit.over_run is not None
        low, high, kept, refuted = -np.inf, np.inf, False, False
        # Halves of parameters have no common time: boxes with parameters stay whole.
        for halvings in _HALVED_RUNS if not proof.boxed and not proof.unproved else (0,):
            sums = [_integral(each, walk_of_limits(each.equations, (limit,)), halvings) for each in proofs]
            bounds = [[float(limit.over_run.of_sum(each, path.duration)) for each in ends] for ends in sums]
            low, high = min(least for least, _ in bounds), max(most for _, most in bounds)
            refuted = any(least > limit.upper or most < limit.bound for least, most in bounds)
            kept = limit.bound <= low and high <= limit.upper and known(proof.equations, limit)
            if refuted or kept:
                break
        verdict: Verdict = "refuted" if refuted else "proved" if kept else "undecided"
        between = f"from {limit.with_unit(low)} to {limit.with_unit(high)} over the run"
        text = f"it is {between}" if np.isfinite([low, high]).all() else "the motion is not proved at all times"
        statements.append(Statement(f"{LIMIT}{limit.quantity}", verdict, text))
    return statements


def _integral(proof: Proof, walk: Walk, halvings: int) -> tuple[float, float]:
    """Return bounds of the integral of a quantity over the run, for all parameters of the box.

    The mean of the Chebyshev polynomial of order k over time is 1/(1 - k^2) for even k, else 0; terms that parameters
    change count by their magnitudes. Rounding is bounded as that of values, and of sums by the sum of all magnitudes.
    """
    if proof.unproved:
        return -np.inf, np.inf
    boxes = boxes_of([proof])
    for _ in range(halvings):
        boxes = boxes.halved(boxes.c)
    orders = np.indices([d + 1 for d in boxes.ring.degrees]).reshape(len(boxes.ring.degrees), -1)
    k, alone = orders[0], (orders[1:] == 0).all(axis=0)
    means = np.where(k % 2 == 0, 1.0 / np.where(k % 2 == 0, 1.0 - k**2, 1.0), 0.0)
    (c, r), widths = walk(boxes.ring, (boxes.c, boxes.r)), boxes.high[:, 0] - boxes.low[:, 0]
    c = c[:, 0]
    middle = (means * alone) @ c
    radius = r[0] + np.abs(c[~alone]).sum(axis=0) + (len(c) + 8) * UNIT * norm(c)
    total, slack = float(middle @ widths), 4.0 * len(widths) * UNIT * float(np.abs(middle) @ widths)
    off = float(radius @ widths) * (1.0 + 1e-9) + slack
    return total - off, total + off


def _failure(claim: Claim, decision: Decision, names: Sequence[str]) -> str:
    assert decision.at is not None
    limit, value, undecided = claim.limit, decision.value, decision.verdict == "undecided"
    time, *given = (f"{name} = {each:.6g}" for name, each in zip(names, decision.at, strict=True))
    place = ", ".join([f"{time} s", *given])
    if not np.isfinite(value):
        return f"the motion is not proved at {place}"
    if claim.told:
        return f"{'not decided whether ' * undecided}{claim.told} at {place}"
    bound = limit.bound if value - limit.bound < limit.upper - value else limit.upper
    why = f", {limit.reason}" if limit.reason else ""
    return (
        f"{'not decided: it is about' if undecided else 'it is'} {limit.with_unit(value)} at {place},"
        f" {limit.with_unit(abs(value - bound))} from the bound of {limit.with_unit(bound)}{why}"
    )
