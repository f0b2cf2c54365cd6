"""Statements about a proved motion: limits, signs, constraints left out and masses, by enclosures on halved boxes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.certificate.chebyshev import UNIT, Arithmetic, norm
from servocore.certificate.equations import Equations
from servocore.certificate.proof import Interval, Proof
from servocore.certificate.walk import Walk
from servocore.model.limits import Limit
from servocore.numerics.compiled_calls import Array
from servocore.numerics.expressions import highest_derivative
from servocore.numerics.memoization import made_once
from servocore.numerics.step_operations import JUMPS, holds_any
from servocore.problem import LEFT_OUT_HOLDS, Problem

Verdict = Literal["proved", "refuted", "undecided"]

LIMIT = "limit of "
"""Beginning of statements on limits."""

_HALVINGS, _MOST = 44, 4000  # of a box, and boxes at once: a value that touches its bound is never decided
_AT_ONCE = 48
_HALVED_FIRST = 0, 4, 7  # how often intervals are halved, the next number where a limit is undecided otherwise
_LIGHT, _HEAVY = 1e-2, 1e4  # times the largest mass: the weight of constraints beside it
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
    begin, end : float
        From when to when, in s.
    sentence : str
        Where it fails and by how much, or what was found.
    time : float or None
        When it fails.
    """

    what: str
    verdict: Verdict
    begin: float
    end: float
    sentence: str
    time: float | None = None

    def __str__(self) -> str:
        return f"{self.verdict}: {self.what}" + (f" ({self.sentence})" if self.sentence else "")


def summary_of(verdict: Verdict, statements: Sequence[Statement], bound: float, jumps: Sequence[float]) -> str:
    """Return a verdict in one line: the proved statements, or the first to fail; `bound` is of the inputs' errors."""
    failing = [each for each in statements if each.verdict == verdict]
    if verdict != "proved":
        return f"{failing[0]}" + (f"; and {len(failing) - 1} more" if len(failing) > 1 else "")
    begin, end = statements[0].begin, statements[0].end
    limits = ", ".join(each.what.removeprefix(LIMIT) for each in statements if each.what.startswith(LIMIT))
    kept = f"; within the limits of {limits}" if limits else ""
    times = ", ".join(f"{t:.6g} s" for t in jumps)
    return (
        f"proved: one regular motion at all times from {begin:.6g} s to {end:.6g} s, inputs within {bound:.1e} of their"
        f" peaks{kept}{f'; inputs jump at t = {times}' if jumps else ''}"
    )


@dataclass(frozen=True, eq=False)
class Enclosed:
    """Enclosures of quantities on boxes of time and parameters.

    Attributes
    ----------
    ring : Arithmetic
        Of the models.
    c, r : ndarray, shape (terms, quantities, boxes) and (quantities, boxes)
        The models.
    low, high : ndarray, shape (boxes, variables)
        Corners of the boxes.
    """

    ring: Arithmetic
    c: Array
    r: Array
    low: Array
    high: Array

    def of(self, chosen: npt.NDArray[np.bool_]) -> Enclosed:
        """Return the same on some of the boxes."""
        return replace(self, c=self.c[..., chosen], r=self.r[:, chosen], low=self.low[chosen], high=self.high[chosen])

    def halved(self) -> Enclosed:
        """Return the halves of the boxes, each by the variable that its polynomials vary most with."""
        orders = np.indices([d + 1 for d in self.ring.degrees]).reshape(len(self.ring.degrees), -1)
        of_its_own = 1.0 / np.maximum(norm(self.c), 1e-300)
        by = np.stack([(norm(self.c[order > 0]) * of_its_own).sum(axis=0) for order in orders]).argmax(axis=0)
        parts = list[Enclosed]()
        for k in range(len(self.ring.degrees)):
            own = self.of(by == k)
            middle = (own.low[:, k] + own.high[:, k]) / 2.0
            for (c, r), early in zip(self.ring.halved((own.c, own.r), k), (True, False), strict=True):
                low, high = own.low.copy(), own.high.copy()
                (high if early else low)[:, k] = middle
                parts.append(Enclosed(self.ring, c, r, low, high))
        return _joined(parts)


def _joined(parts: Sequence[Enclosed]) -> Enclosed:
    """Return enclosures on the boxes of several."""
    fields = (("c", 2), ("r", 1), ("low", 0), ("high", 0))
    return Enclosed(parts[0].ring, *(np.concatenate([getattr(e, name) for e in parts], axis) for name, axis in fields))


def enclosed(proofs: Sequence[Proof], walk: Walk, halvings: int = 0) -> Enclosed:
    """Return enclosures of the results of a walk on all intervals within the path, halved so often before it."""
    ring, parts = proofs[0].ring, list[Enclosed]()
    for proof in proofs:
        within = [k for k, each in enumerate(proof.intervals) if not each.outside]
        boxes, count = list(proof.boxed.values()), max(_AT_ONCE >> halvings, 1)
        for first in range(0, len(within), count):
            some = within[first : first + count]
            c, r = (part[..., some] for part in proof.enclosures)
            low = np.array([(proof.intervals[k].begin, *(least for least, _ in boxes)) for k in some])
            high = np.array([(proof.intervals[k].end, *(most for _, most in boxes)) for k in some])
            given = Enclosed(ring, c, r, low, high)
            for _ in range(halvings):
                given = given.halved()
            parts.append(Enclosed(ring, *walk(ring, (given.c, given.r)), given.low, given.high))
    return _joined(parts)


@dataclass(frozen=True)
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

    verdict: Verdict
    at: Array | None = None
    value: float = np.nan
    least: float = np.inf
    most: float = -np.inf


def decided(quantities: Enclosed, k: int, lower: float, upper: float) -> Decision:
    """Decide whether quantity k stays from `lower` to `upper` on all boxes, halving those on which it may not."""
    ring = quantities.ring
    some = replace(quantities, c=quantities.c[:, k : k + 1], r=quantities.r[k : k + 1])
    found = doubtful = Decision("proved")
    extent = np.inf, -np.inf
    for _ in range(_HALVINGS):
        least, most = (each[0] for each in ring.span((some.c, some.r)))
        kept = (least >= lower) & (most <= upper)
        extent = least.min(initial=extent[0], where=kept), most.max(initial=extent[1], where=kept)
        some = some.of(~kept)
        if not len(some.low):
            break
        c, r = some.c[:, 0], some.r[0]
        values = ring.values(c)
        noise = r + (len(c) + 8) * UNIT * norm(c)
        beyond = np.maximum(lower - values, values - upper)
        certain = (beyond.max(axis=0) > noise) & np.isfinite(noise)
        among = np.flatnonzero(certain) if certain.any() else np.arange(len(r))
        box = among[int(beyond[:, among].max(axis=0).argmax())]
        node = int(beyond[:, box].argmax())
        place = (some.low[box] + some.high[box]) / 2.0 + (some.high[box] - some.low[box]) / 2.0 * ring.nodes[node]
        value = float(values[node, box]) if np.isfinite(noise[box]) else np.nan
        found = Decision("refuted" if certain.any() else "undecided", place, value)
        # Where the radius is more than what the polynomial varies by, halves tell nothing new.
        useless = ~np.isfinite(r) | (norm(c[1:]) < r / 4.0)
        if certain.any() or useless.all() or len(r) > _MOST:
            break
        doubtful = found if useless.any() else doubtful
        some, found = some.of(~useless).halved(), doubtful
    else:
        found = Decision("undecided", (some.low[0] + some.high[0]) / 2.0, float(some.c[0, 0, 0]))
    return replace(found, least=float(extent[0]), most=float(extent[1]))


# Limits and signs -----------------------------------------------------------------------------------------------------


@made_once
def walk_of_limits(equations: Equations, limits: tuple[Limit, ...], rates: bool) -> Walk:
    """Return the limited quantities, or their rates, as a walk."""
    return equations.walk([limit.on(equations.array.system) for limit in limits], rates)


@made_once
def known(equations: Equations, limit: Limit) -> bool:
    """Whether the equations enclose all derivatives of the path that a limit compares."""
    system = equations.array.system
    return highest_derivative(limit.on(system), system.gamma) + limit.rate <= equations.path_order


def limit_statements(proofs: Sequence[Proof], limits: Sequence[Limit], what: Callable[[Limit], str]) -> list[Statement]:
    """Decide limits between the instants too, each a statement."""
    equations = proofs[0].equations
    path = proofs[0].problem.reference
    begin, end, statements = path.start_time, path.end_time, list[Statement]()
    for rates in (False, True):
        chosen = tuple(limit for limit in limits if limit.rate == rates)
        usable = tuple(limit for limit in chosen if known(equations, limit))
        for limit in chosen:
            if limit not in usable:
                text = "it depends on higher derivatives of the path than the inputs do"
                statements.append(Statement(what(limit), "undecided", begin, end, text))
        if not usable:
            continue
        # Where a magnitude or a tanh turns within an interval, its enclosure is wide: halves of that say nothing new.
        decisions, todo = dict[int, Decision](), list(range(len(usable)))
        for halvings in _HALVED_FIRST:
            quantities = enclosed(proofs, walk_of_limits(equations, usable, rates), halvings)
            decisions |= {k: decided(quantities, k, usable[k].bound, usable[k].upper) for k in todo}
            todo = [k for k in todo if decisions[k].verdict == "undecided" and np.isfinite(decisions[k].value)]
            if not todo:
                break
        for k, limit in enumerate(usable):
            decision = decisions[k]
            if decision.at is None:
                extent = f"it stays from {limit.with_unit(decision.least)} to {limit.with_unit(decision.most)}"
                sentence, time = extent, None
            else:
                sentence, time = _failure(proofs[0], limit, decision), float(decision.at[0])
            statements.append(Statement(what(limit), decision.verdict, begin, end, sentence, time))
    return statements


def run_statements(proofs: Sequence[Proof], limits: Sequence[Limit]) -> list[Statement]:
    """Decide limits of what the run adds up, from enclosures of the integrals over all intervals."""
    path, statements = proofs[0].problem.reference, list[Statement]()
    begin, end = path.start_time, path.end_time
    for limit in limits:
        assert limit.over_run is not None
        low, high, kept, refuted = -np.inf, np.inf, False, False
        # Halves of parameters have no common time: boxes with parameters stay whole.
        for halvings in _HALVED_FIRST if not proofs[0].boxed and not unproved(proofs[0]) else (0,):
            sums = [_integral(each, walk_of_limits(each.equations, (limit,), False), halvings) for each in proofs]
            bounds = [[float(limit.over_run.of_sum(each, end - begin)) for each in ends] for ends in sums]
            low, high = min(least for least, _ in bounds), max(most for _, most in bounds)
            refuted = any(least > limit.upper or most < limit.bound for least, most in bounds)
            kept = limit.bound <= low and high <= limit.upper and known(proofs[0].equations, limit)
            if refuted or kept:
                break
        verdict: Verdict = "refuted" if refuted else "proved" if kept else "undecided"
        between = f"from {limit.with_unit(low)} to {limit.with_unit(high)} over the run"
        text = f"it is {between}" if np.isfinite([low, high]).all() else "the motion is not proved at all times"
        statements.append(Statement(f"{LIMIT}{limit.quantity}", verdict, begin, end, text))
    return statements


def _integral(proof: Proof, walk: Walk, halvings: int) -> tuple[float, float]:
    """Return bounds of the integral of a quantity over the run, for all parameters of the box.

    The mean of the Chebyshev polynomial of order k over time is 1/(1 - k^2) for even k, else 0; terms that parameters
    change count by their magnitudes. Rounding is bounded as that of values, and of sums by the sum of all magnitudes.
    """
    if unproved(proof):
        return -np.inf, np.inf
    boxes = enclosed([proof], walk, halvings)
    orders = np.indices([d + 1 for d in boxes.ring.degrees]).reshape(len(boxes.ring.degrees), -1)
    k, alone = orders[0], (orders[1:] == 0).all(axis=0)
    means = np.where(k % 2 == 0, 1.0 / np.where(k % 2 == 0, 1.0 - k**2, 1.0), 0.0)
    c, widths = boxes.c[:, 0], boxes.high[:, 0] - boxes.low[:, 0]
    middle = (means * alone) @ c
    radius = boxes.r[0] + np.abs(c[~alone]).sum(axis=0) + (len(c) + 8) * UNIT * norm(c)
    total, slack = float(middle @ widths), 4.0 * len(widths) * UNIT * float(np.abs(middle) @ widths)
    off = float(radius @ widths) * (1.0 + 1e-9) + slack
    return total - off, total + off


def _failure(proof: Proof, limit: Limit, decision: Decision) -> str:
    assert decision.at is not None
    if not np.isfinite(decision.value):
        return f"the motion is not proved at t = {decision.at[0]:.6g} s"
    below = decision.value - limit.bound < limit.upper - decision.value
    bound = limit.bound if below else limit.upper
    names = [proof.problem.system.parameters.names[k] for k in proof.boxed]
    given = "".join(f", {name} = {value:.6g}" for name, value in zip(names, decision.at[1:], strict=True))
    verb = "it is" if decision.verdict == "refuted" else "not decided: it is about"
    off = abs(decision.value - bound)
    why = f", {limit.reason}" if limit.reason else ""
    return (
        f"{verb} {limit.with_unit(decision.value)} at t = {decision.at[0]:.6g} s{given}, {limit.with_unit(off)} from"
        f" the bound of {limit.with_unit(bound)}{why}"
    )


# Constraints left out, and masses -------------------------------------------------------------------------------------


def step_statement(problem: Problem) -> list[Statement]:
    """State that a potential or masses with steps are not understood: a step of energy is an impulse.

    The equations hold the derivative, which is zero but at the step.
    """
    system, path = problem.system, problem.reference
    if not holds_any(ca.vertcat(system.potential, ca.vec(ca.densify(system.mass))), JUMPS):
        return []
    text = "the potential or a mass has a step, of which the equations of motion know nothing"
    return [Statement("no impulses", "undecided", path.start_time, path.end_time, text)]


def left_out_statement(proofs: Sequence[Proof]) -> list[Statement]:
    """State that holonomic constraints left out as redundant hold along the motion."""
    problem = proofs[0].problem
    rows = problem.resolved.left_out
    if not rows.numel():
        return []
    equations, system = proofs[0].equations, problem.system
    nominal = ca.DM(system.coordinates.nominal)
    gradient = ca.Function("sc_reach", [system.q, system.p, system.time], [
        ca.densify(ca.mtimes(ca.fabs(ca.jacobian(rows, system.q)), nominal))])  # fmt: skip
    home, p = system.home_configuration()
    reach = np.asarray(gradient(home, p, np.zeros(system.time.numel()))).ravel()
    quantities = enclosed(proofs, equations.walk([rows]))
    path = problem.reference
    for k in range(rows.numel()):
        bound = LEFT_OUT_HOLDS * reach[k]
        decision = decided(quantities, k, -bound, bound)
        if decision.verdict != "proved":
            assert decision.at is not None
            text = f"constraint {k + 1} of them is off by {abs(decision.value):.3g} at t = {decision.at[0]:.6g} s"
            return [Statement("redundant constraints hold", decision.verdict, path.start_time, path.end_time, text)]
    return [Statement("redundant constraints hold", "proved", path.start_time, path.end_time, "")]


@made_once
def _pivots(equations: Equations, weight: float) -> Walk:
    """Return the pivots of M + w G^T G by elimination, in units of the nominal magnitudes of the coordinates."""
    system = equations.array.system
    scale = ca.diag(ca.DM(system.coordinates.nominal))
    M, G = ca.mtimes(ca.mtimes(scale, system.mass), scale), ca.mtimes(system.G, scale)
    largest = [ca.mmax(ca.fabs(ca.vertcat(ca.SX(1, 1), ca.vec(ca.densify(each))))) for each in (M, G)]
    sizes = ca.Function("sc_sizes", [system.q, system.p, system.time], largest)
    size_M, size_G = (float(each) for each in sizes(*system.home_configuration(), np.zeros(system.time.numel())))
    pivots, *_ = ca.ldl(M + weight * size_M / (size_G**2 or 1.0) * ca.mtimes(G.T, G))
    return equations.walk([pivots])


def mass_statement(proofs: Sequence[Proof]) -> Statement:
    """State that the mass matrix M is definite on all velocities that the holonomic constraints allow.

    It is if M + w G^T G is, for any weight w > 0: on the kernel of G the second term vanishes. A matrix is definite if
    all pivots of its elimination are positive. A light weight leaves what M says by itself as it is; one that is heavy
    tells a negative mass from a direction that the constraints exclude.
    """
    path, what = proofs[0].problem.reference, "mass matrix definite on all motions that the constraints allow"
    failed = list[Decision]()
    for weight in (_LIGHT, _HEAVY):
        pivots = enclosed(proofs, _pivots(proofs[0].equations, weight))
        low, _ = pivots.ring.span((pivots.c, pivots.r))
        open_ = np.flatnonzero(~(low > 0.0).all(axis=1)).tolist()
        decisions = [decided(pivots, k, _POSITIVE, np.inf) for k in open_]
        failed = [each for each in decisions if each.at is not None]
        if not failed:
            return Statement(what, "proved", path.start_time, path.end_time, "")
    worst = next((each for each in failed if each.verdict == "refuted"), failed[0])
    assert worst.at is not None
    time = float(worst.at[0])
    text = f"{'negative at' if worst.verdict == 'refuted' else 'not decided near'} t = {time:.6g} s"
    return Statement(what, worst.verdict, path.start_time, path.end_time, text, time)


def unproved(proof: Proof) -> list[Interval]:
    """Return the intervals without a proof."""
    return [each for each in proof.intervals if not each.proved]
