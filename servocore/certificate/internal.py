"""Internal dynamics: the equations proved at computed states, and a bound of the error of these states.

With the states s given, the other unknowns of the derivative array follow, and with them s' = f(s, t). Let s_hat be a
polynomial in time on each interval and |.|_V = |V^-1 .|_2. Where the logarithmic norm of df/ds is at most mu within a
distance E of s_hat, and the defect |s_hat' - f(s_hat, t)|_V at most delta, the distance e of the motion from s_hat
grows by e' <= mu e + delta as long as e < E (Dahlquist 1959; Hairer, Norsett & Wanner, *Solving Ordinary Differential
Equations I*, theorem I.10.6). The columns of V are the eigenvectors of the mean of df/ds: mu is hardly more than the
largest real part of its eigenvalues where df/ds varies little.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev

from servocore.certificate.chebyshev import UNIT, Model, derivative, magnitude, norm, summed
from servocore.certificate.equations import equations_of, given_models, radii
from servocore.certificate.proof import OUTSIDE, Proof, grid_of, smallest_peaks
from servocore.certificate.statements import Statement, compared
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.solution import Solution
from servocore.stepping.exact_evaluation import guessed_unknowns, unknowns_from, unknowns_near

_INSTANTS, _FEWEST = 3, 16  # of a solution in an interval; intervals
_TUBE = 1e-7  # E, of peaks
_SETTLED, _CORRECT = 1e-10, 1e-8  # last steps of Newton's method, of the largest unknown, and of peaks of states
_CORRECTIONS = 5  # of the states
_STILL = 1e-3  # of what counts as a small state: it changes by less within the duration
_REST = (1e-2, 0.5)  # of their peaks: how near coordinates and velocities by the spline are to those at rest
_WORST = 1e5  # condition of V: products with its inverse are off by less than `_OFF` of them, and mu by its square
_OFF, _ROUNDED = 1.0 + 1e-8, 1e-14


def near_states(
    problem: Problem, solution: Solution | None, tolerance: float, boxed: bool
) -> tuple[Proof | None, list[Statement]]:
    """Return the proof of a motion with internal dynamics, None without a bound of their states, and what it states."""
    text = "the states of the internal dynamics come from an integration, whose error is estimated and not proved"
    if solution is None:
        return None, [Statement("one motion", "undecided", text)]
    proof = InternalProof(problem, solution, tolerance)
    if proof.bounded and not boxed:
        return proof, [Statement("error of the internal dynamics bounded", "proved", proof.sentence)]
    if solution.error.largest is not None:
        text += f": inputs within {solution.error.largest:.1e} of their peaks by {solution.error.basis}"
    why = "a bound for a box of parameters is not known" if boxed else proof.sentence
    text += f"; {why}" * bool(why)
    return None, [Statement("one motion", "undecided", text), proof.algebraic]


def _rests(problem: Problem, t: Array) -> bool:
    """Whether the states of the internal dynamics are in equilibrium at a time before the path begins."""
    array = problem.array
    found = unknowns_from(problem, t, guessed_unknowns(problem, t))[:, 0]
    rates = np.abs(found[array.places(tuple((j, order + 1) for j, order in array.states))])
    return bool((rates * problem.reference.duration <= _STILL * smallest_peaks(problem, array.states)).all())


class InternalProof(Proof):
    """The motion of a problem with internal dynamics on intervals, near a solution and from its start.

    Its proofs are those at given states: polynomials, then such with a radius. One more within a radius is of the same
    solution: its D is more than the radii of unknowns that were proved before.

    Parameters
    ----------
    problem : Problem
        With internal dynamics.
    solution : Solution
        Of the problem.
    tolerance : float
        Of the inputs, as a share of their peaks.

    Attributes
    ----------
    bounded : bool
        Whether enclosures hold the motion: the error of the states has a bound.
    sentence : str
        The bound of the states, or why there is none.
    algebraic : Statement
        Whether the equations have one regular solution at the states of the solution.
    """

    @np.errstate(all="ignore")  # what is not finite is not proved
    def __init__(self, problem: Problem, solution: Solution, tolerance: float) -> None:
        self.bounded, self.sentence, self._from = False, "", ""
        t, path = solution.t, problem.reference
        early, late = t[t < path.start_time], t[t > path.end_time]
        inside = grid_of(path, max(len(t) // _INSTANTS, _FEWEST))
        margin = min(OUTSIDE * path.duration, np.diff(inside).min())
        # Inputs may jump at the ends of the path: a motion from an equilibrium is at rest before it.
        before = np.array([path.start_time - margin])
        if not len(early) and not problem.start and _rests(problem, before):
            early = before
        late = late if len(late) else np.array([path.end_time + margin])
        self._begin(problem, {}, equations_of(problem.resolved, False, True), tolerance, np.r_[early, inside, late])
        s, ends = self._near(solution), np.stack([self.begin, self.end])
        self.given[:, s.shape[1] :] = given_models(problem, problem.array, self.ring, ends, {})
        self._correct(s)
        self._prove_at(s)
        what = "one regular solution of the algebraic equations at the computed states"
        if not self.proved.all():
            time = float(self.begin[self.proved.argmin()])
            self.algebraic = Statement(what, "undecided", f"not proved at t = {time:.6g} s", time)
            return
        off = max(each.relative for each in compared(self, solution, tolerance)[0].values())
        self.algebraic = Statement(what, "proved", f"inputs within {off:.1e} of their peaks, given these states")
        self._bound(s, self._first(s, bool(t[0] < path.start_time)))

    def _first(self, s: Model, before: bool) -> Array:
        """Return the first states of the motion: given ones, those at rest, or computed ones."""
        array, own = self.problem.array, guessed_unknowns(self.problem, self.begin[:1])[:, 0]
        names = [array.names[j].removeprefix("q.") + "_dot" * order for j, order in array.states]
        own, early = own[array.places(array.states)], self.ring.ends(s)[0][0]
        near, begun = [_REST[order] for _, order in array.states] * self._sizes(s), early[:, 0]
        if (np.abs(early[:, self.within.argmax()] - own) <= near).all() and not before:
            begun = own
        elif not self.problem.start:
            self._from = f" on the motion from their computed values at t = {self.begin[0]:.6g} s"
        return np.array([self.problem.start.get(*each) for each in zip(names, begun.tolist(), strict=True)])

    def _sizes(self, s: Model) -> Array:
        """Return the peaks of the states, at least what counts as small, shape (n,)."""
        return np.asarray(np.maximum(norm(s[:-1]).max(axis=1), smallest_peaks(self.problem, self.problem.array.states)))

    def _near(self, solution: Solution) -> Model:
        """Return polynomials of states near a solution, and begin with those of unknowns.

        Derivatives by the states begin at zero: their equations are linear.
        """
        array = self.problem.array
        t = (self.begin + self.end + (self.end - self.begin) * self.ring.nodes).ravel() / 2.0
        found = unknowns_near(self.problem, solution, t)
        found = self.ring.tried(np.moveaxis(found.reshape(len(found), -1, len(self.begin)), 1, 0))
        self.x[:] = 0.0
        self.x[:, : len(array.determined)] = found[:, array.places(array.determined)]
        return found[:, array.places(array.states)]

    def _correct(self, s: Model) -> None:
        """Take steps of Newton's method for the unknowns at states, the blocks one after the other."""
        self.given[:, : s.shape[1]], self.x[-1] = s, 0.0
        for _ in range(len(self.equations.blocks) + 1):
            x, nothing = self.x[:-1], np.zeros(self.x.shape[1:])
            *_, shift = radii(self.equations, self.ring, x, self.given, nothing, nothing[:, :1])
            if (norm(shift) <= _SETTLED * norm(x).max()).all():
                break
            self.x[:-1] -= np.where(np.isfinite(shift), shift, 0.0)

    def _prove_at(self, s: Model) -> tuple[Model, Model]:
        """Test all intervals with models of states; return models of f, (terms + 1, n, N), and of df/ds.

        They are infinite where nothing is proved.
        """
        self.given[:, : s.shape[1]] = s
        self.relative[:] = np.inf
        self._test(np.ones(len(self.begin), dtype=bool), self.equations)
        self.relative[self.switches] = np.inf
        found, n = self.equations.flow(self.ring, self.enclosures), s.shape[1]
        return found[:, :n], found[:, n:].reshape(len(found), n, n, -1).swapaxes(1, 2)

    def _moved(self, s: Model, f: Model, J: Model, state: Array) -> Model:
        """Return polynomials of the states after a step of Newton's method for the motion from its first state.

        s' = f + J (s - s_hat) is integrated by collocation at the nodes, from any value on each interval, then from one
        interval to the next.
        """
        f, J, old = (self.ring.values(each) for each in (f, J, s))
        terms, n, count = old.shape
        over = chebyshev.chebvander(self.ring.nodes[:, 0], terms) @ chebyshev.chebint(np.eye(terms), lbnd=-1.0)
        over = (over @ self.ring.interpolation)[..., None] * (self.end - self.begin) / 2.0
        K = np.einsum("tuk,uijk->ktiuj", over, J).reshape(count, terms * n, terms * n)
        added = np.einsum("tuk,uik->kti", over, f - np.einsum("tijk,tjk->tik", J, old)).reshape(count, terms * n, 1)
        begun = np.broadcast_to(np.tile(np.eye(n), (terms, 1)), (count, terms * n, n))
        moved = np.linalg.solve(np.eye(terms * n) - K, np.concatenate([begun, added], axis=2))
        late, found = self.ring.interpolation.sum(axis=0), np.empty_like(old)
        for k, each in enumerate(moved.reshape(count, terms, n, n + 1)):
            found[..., k] = each @ np.append(state, 1.0)
            state = late @ found[..., k]
        return self.ring.tried(found)

    def _bound(self, s: Model, start: Array) -> None:
        """Enclose states and unknowns after steps of Newton's method, if their error has a bound."""
        sizes, width = self._sizes(s), self.end - self.begin
        for _ in range(_CORRECTIONS):
            moved = self._moved(s, *self._prove_at(s), start)
            change = (norm(moved - s) / sizes[:, None]).max()
            if change <= 1.0:  # not so of an unstable motion, which no integration from its start finds
                s = moved
                self._correct(s)
            if not _CORRECT < change <= 1.0:
                break
        f, J = self._prove_at(s)
        V = np.linalg.eig(J[0].mean(axis=2)).eigenvectors
        inverse, rows, worst = np.linalg.pinv(V), np.linalg.norm(V, axis=1) * _OFF, np.linalg.cond(V)
        most, tube = (_TUBE * sizes / rows).min(), s.copy()
        tube[-1] += (rows * most)[:, None]
        J = self._prove_at(tube)[1].transpose(0, 3, 1, 2)
        M, varied = inverse @ J[0] @ V, np.abs(inverse) @ norm(J[1:]) @ np.abs(V)
        mu = np.linalg.eigvalsh((M + M.conj().swapaxes(1, 2)) / 2.0)[:, -1]
        off, size = (np.linalg.norm(each, axis=(1, 2)) for each in (varied, J[0]))
        mu += off * _OFF + _ROUNDED * len(V) * worst**2 * size
        defect = magnitude(summed(derivative(self.ring.derivatives[0], s) * (2.0 / width), f, -1.0))
        (early,), (late,) = self.ring.ends(s)
        jumps = np.abs(early - np.column_stack([start, late[:, :-1]]))
        jumps += (2.0 * len(s)) ** 2 * UNIT * sizes[:, None]
        defect, jumps = (np.linalg.norm(np.abs(inverse) @ each, axis=0) * _OFF for each in (defect, jumps))
        e, largest, growth = 0.0, np.empty(len(width)), np.exp(mu * width) * _OFF
        for k, grown in enumerate(growth.tolist()):
            begin, added = e + jumps[k], defect[k] * width[k] * max(grown, 1.0) * _OFF
            e, largest[k] = begin * grown + added, begin * max(grown, 1.0) + added
        norms = f"a logarithmic norm from {mu.min():.3g} to {mu.max():.3g} 1/s"
        lost = np.flatnonzero(~(largest < most) | (worst > _WORST))
        if len(lost):
            why = f"with {norms}" if np.isfinite(mu).all() else "as the equations are not proved beside them"
            self.sentence = f"{why} no bound of their error is known from t = {self.begin[lost[0]]:.6g} s on"
            return
        share = (rows * largest.max() / sizes).max()
        self.sentence = f"states of the internal dynamics within {share:.1e} of their peaks{self._from}, by {norms}"
        s[-1] += rows[:, None] * largest
        self._prove_at(s)
        self.bounded, self.joints = bool(self.proved.all()), self._joints()
