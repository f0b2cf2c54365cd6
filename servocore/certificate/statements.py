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
from servocore.numerics.components import parts_of
from servocore.numerics.expressions import highest_derivative
from servocore.numerics.memoization import made_once
from servocore.problem import LEFT_OUT_HOLDS

Verdict = Literal["proved", "refuted", "undecided"]

LIMIT = "limit of "
"""Beginning of statements on limits."""

_HALVINGS, _MOST = 44, 4000  # of a box, and boxes at once: a value that touches its bound is never decided
_AT_ONCE = 48
_HALVED_FIRST = 0, 4, 7  # how often intervals are halved, the next number where a limit is undecided otherwise
_LIGHT, _HEAVY = 1e-4, 1e4  # times the largest mass: the weight of constraints beside it
_MASS_HALVINGS = 8
_NEGATIVE = 1e-9  # of the largest: a mass that is lower is negative


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
    """Return a verdict in one line: what is proved, or what fails first; `bound` is that of the inputs' errors."""
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
        within = [each for each in proof.intervals if not each.outside]
        boxes = list(proof.boxed.values())
        count = max(_AT_ONCE >> halvings, 1)
        for k in range(0, len(within), count):
            some = within[k : k + count]
            low = np.array([(each.begin, *(least for least, _ in boxes)) for each in some])
            high = np.array([(each.end, *(most for _, most in boxes)) for each in some])
            given = Enclosed(ring, *proof.models(some), low, high)
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
def _masses(equations: Equations, coupled: tuple[int, ...]) -> tuple[Walk, list[list[list[int]]], list[int]]:
    """Part the mass matrix by its own couplings, and those by constraints on the coordinates `coupled`.

    M and the constraints within a part follow one another, in units of the nominal magnitudes of the coordinates: for
    each size there are the coordinates of the parts, and the number of entries of one.
    """
    system = equations.array.system
    scale = ca.diag(ca.DM(system.coordinates.nominal))
    M, G = ca.mtimes(ca.mtimes(scale, system.mass), scale), ca.mtimes(system.G, scale)
    coupling = G[[k for k in range(G.size1()) if G[k, list(coupled)].nnz()], :]
    pattern = (M + ca.mtimes(coupling.T, coupling) + ca.SX(ca.DM.eye(M.size1()))).sparsity()
    expressions, sized, entries = [ca.SX(0, 1)], dict[int, list[list[int]]](), list[int]()
    for part in parts_of(pattern):
        sized.setdefault(len(part.rows), []).append(part.rows.tolist())
    for size, parts in sized.items():
        within = [[k for k in range(G.size1()) if 0 < G[k, own].nnz() == G[k, :].nnz()] for own in parts]
        most = max(len(rows) for rows in within)
        for own, rows in zip(parts, within, strict=True):
            expressions += [ca.vec(M[own, own]), ca.vec(ca.vertcat(G[rows, own], ca.SX(most - len(rows), size)))]
        entries.append(size * (size + most))
    return equations.walk([ca.densify(ca.vertcat(*expressions))]), list(sized.values()), entries


def mass_statement(proofs: Sequence[Proof]) -> Statement:
    """State that the mass matrix M is definite on all velocities that the holonomic constraints allow.

    It is if M + w G^T G is, for any weight w > 0 and any of the constraints: on the kernel of G the second term
    vanishes. With an approximate factor L of that matrix, |I - L^-1 (M + w G^T G) L^-T| < 1 in the maximum norm shows
    it (Rump, BIT 46 (2006) 433). A light weight leaves what M says by itself as it is; one that is heavy tells a
    negative mass from a direction that the constraints exclude. Parts of M are tried alone, then those that are not
    definite with the constraints on their coordinates, then all together.
    """
    path, what = proofs[0].problem.reference, "mass matrix definite on all motions that the constraints allow"
    everything = tuple(range(len(proofs[0].problem.system.coordinates)))
    failed, _, time = _indefinite(proofs, (), 1)
    if 0 < len(failed) < len(everything):
        failed, _, time = _indefinite(proofs, failed, 1)
    negative = False
    if failed:
        failed, negative, time = _indefinite(proofs, everything, _MASS_HALVINGS)
    if not failed:
        return Statement(what, "proved", path.start_time, path.end_time, "")
    verdict, text = ("refuted", "negative at") if negative else ("undecided", "not decided near")
    return Statement(what, verdict, path.start_time, path.end_time, f"{text} t = {time:.6g} s", time)  # type: ignore[arg-type]  # one of three


def _indefinite(proofs: Sequence[Proof], coupled: tuple[int, ...], tries: int) -> tuple[tuple[int, ...], bool, float]:
    """Return the coordinates of parts that are not proved definite, whether one is not, and a time when."""
    walk, sizes, entries = _masses(proofs[0].equations, coupled)
    every, first, failed, time = enclosed(proofs, walk), 0, list[int](), np.nan
    for parts, number in zip(sizes, entries, strict=True):
        own, first = slice(first, first + len(parts) * number), first + len(parts) * number
        c = every.c[:, own].reshape(len(every.c), len(parts), number, -1).swapaxes(1, 2)
        r = every.r[own].reshape(len(parts), number, -1).swapaxes(0, 1)
        low, high = (np.tile(each, (len(parts), 1)) for each in (every.low, every.high))
        some = Enclosed(every.ring, c.reshape(len(c), number, -1), r.reshape(number, -1), low, high)
        bad, unknown = np.ones(len(parts), dtype=bool), some
        for k in range(tries):
            if k and not 0 < len(some.low) < _MOST:
                break
            some = some.halved() if k else some
            known = np.asarray(np.isfinite(some.r).all(axis=0))  # halves of others are not known either
            unknown = unknown if k else some.of(~known)
            good, least = _definite(some, len(parts[0]), _LIGHT)
            if tries > 1 and (least < -_NEGATIVE).any():
                least = _definite(some, len(parts[0]), _HEAVY)[1]
                if (least < -_NEGATIVE).any():
                    return coupled, True, float(some.low[least.argmin(), 0] + some.high[least.argmin(), 0]) / 2.0
            bad = bad if k else np.asarray(~good.reshape(len(parts), -1).all(axis=1))
            some = some.of(~good & known)
        if len(some.low) or len(unknown.low):
            first_box = some if len(some.low) else unknown
            time = float(first_box.low[0, 0] + first_box.high[0, 0]) / 2.0
            failed += [each for part, fails in zip(parts, bad.tolist(), strict=True) if fails for each in part]
    return tuple(failed), False, time


def _definite(some: Enclosed, n: int, weight: float) -> tuple[npt.NDArray[np.bool_], Array]:
    """Return on which boxes M is definite where G v = 0, and its least eigenvalue in the middle, of the largest."""
    low, high = some.ring.span((some.c, some.r))
    middle, radius = (low + high) / 2.0, (high - low) / 2.0 * (1.0 + 1e-12)
    boxes = middle.shape[1]
    M, dM = (np.moveaxis(each[: n * n].reshape(n, n, boxes), 2, 0) for each in (middle, radius))
    rows = (len(middle) - n * n) // n
    G, dG = (np.moveaxis(each[n * n :].reshape(n, rows, boxes), 2, 0).swapaxes(1, 2) for each in (middle, radius))
    largest = np.abs(M).max(axis=(1, 2), keepdims=True)
    size = np.abs(G).max(axis=(1, 2), keepdims=True, initial=0.0)
    w = weight * np.where(largest > 0.0, largest, 1.0) / np.where(size > 0.0, size, 1.0) ** 2
    N = M + w * (G.swapaxes(1, 2) @ G)
    spread = np.abs(G).swapaxes(1, 2) @ dG
    dN = (
        dM
        + w * (spread + spread.swapaxes(1, 2) + dG.swapaxes(1, 2) @ dG)
        + 1e-13 * n * np.abs(N).max(axis=(1, 2), keepdims=True)
    )
    finite = (np.isfinite(N) & np.isfinite(dN)).all(axis=(1, 2))
    N, dN = (np.where(finite[:, None, None], each, np.eye(n)) for each in (N, dN))
    values, vectors = np.linalg.eigh(N)
    W = (vectors / np.sqrt(np.abs(values))[:, None, :]).swapaxes(1, 2)
    rest = np.abs(np.eye(n) - W @ N @ W.swapaxes(1, 2)) + np.abs(W) @ dN @ np.abs(W).swapaxes(1, 2)
    good = finite & (values[:, 0] > 0.0) & (rest.sum(axis=2).max(axis=1) < 1.0 - 1e-9)
    return good, values[:, 0] / values[:, -1]


def unproved(proof: Proof) -> list[Interval]:
    """Return the intervals without a proof."""
    return [each for each in proof.intervals if not each.proved]
