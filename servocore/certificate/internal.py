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

from servocore.certificate.chebyshev import UNIT, Model, arithmetic, derivative, magnitude, model_of, norm, summed
from servocore.certificate.equations import equations_of, given_models, radii
from servocore.certificate.proof import OUTSIDE, Proof, grid_of, smallest_peaks
from servocore.certificate.statements import Statement
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.solution import Solution
from servocore.stepping.exact_evaluation import guessed_unknowns, unknowns_from

_SPLINE, _DEGREE = 5, 10  # degree of the spline through coordinates, and of polynomials on intervals
_INSTANTS, _FEWEST = 3, 16  # of a solution in an interval; intervals
_TUBE, _BESIDE = 1e-7, 1e-4  # E and D, of peaks
_SETTLED, _CORRECT = 1e-10, 1e-8  # last steps of Newton's method, of the largest unknown, and of peaks of states
_CORRECTIONS = 5  # of the states
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
    if proof.proved.all() and not boxed:
        return proof, [Statement("error of the internal dynamics bounded", "proved", proof.sentence)]
    if solution.error.largest is not None:
        text += f": inputs within {solution.error.largest:.1e} of their peaks by {solution.error.basis}"
    why = "a bound for a box of parameters is not known" if boxed else proof.sentence
    text += f"; {why}" * bool(why)
    return None, [Statement("one motion", "undecided", text), proof.algebraic]


class InternalProof(Proof):
    """The motion of a problem with internal dynamics on intervals, near a solution and from its start.

    Enclosures hold the states too. They are any number where no bound of the error of the states is proved.

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
    sentence : str
        The bound of the states, or why there is none.
    algebraic : Statement
        Whether the equations have one regular solution at the states of the solution.
    """

    @np.errstate(all="ignore")  # what is not finite is not proved
    def __init__(self, problem: Problem, solution: Solution, tolerance: float) -> None:
        self.problem, self.boxed, self.tolerance, self.joints = problem, {}, tolerance, []
        self.equations, self.ring = equations_of(problem.resolved, False, True), arithmetic((_DEGREE,))
        t, path = solution.t, problem.reference
        outside = t[(t < path.start_time) | (t > path.end_time)]
        grid = np.union1d(grid_of(path, max(len(t) // _INSTANTS, _FEWEST)), outside)
        # Inputs may jump at the ends of the path: a motion from rest is at rest before it.
        if grid[0] == path.start_time and not problem.start:
            grid = np.append(path.start_time - OUTSIDE * path.duration, grid)
        if grid[-1] == path.end_time:
            grid = np.append(grid, path.end_time + OUTSIDE * path.duration)
        self.begin, self.end = grid[:-1], grid[1:]
        self.switches, self.relative = np.zeros(len(grid) - 1, dtype=bool), np.full(len(grid) - 1, np.inf)
        x, s = self._near(solution)
        # Derivatives by the states begin at zero: their equations are linear.
        x, rho = self._tested(np.pad(x, ((0, 0), (0, x.shape[1] * s.shape[1]), (0, 0))), s)
        self.x, self.given, inputs = model_of(x, rho), self._given(s), self.equations.inputs
        self.sentence, self._from, lost = "", "", np.flatnonzero(np.isinf(rho).any(axis=0))
        what = "one regular solution of the algebraic equations at the computed states"
        if len(lost):
            time = float(self.begin[lost[0]])
            self.algebraic = Statement(what, "undecided", f"not proved at t = {time:.6g} s", time)
            return
        shown = self.at(self.x[:, inputs], t)
        reported = [solution[each.name] for each in problem.system.inputs]
        off = ((np.abs(reported - shown[0]) + magnitude(shown[1:])) / self.peaks[inputs]).max()
        self.algebraic = Statement(what, "proved", f"inputs within {off:.1e} of their peaks, given these states")
        self._bound(x, rho, s, self._first(s, bool(t[0] < path.start_time)))

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

    def _near(self, solution: Solution) -> tuple[Array, Model]:
        """Return polynomials of unknowns and states: coordinates by a spline, others by Newton's method at nodes."""
        from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - all commands import this module

        array, degree = self.problem.array, min(_SPLINE, len(solution.t) - 1)
        t = (self.begin + self.end + (self.end - self.begin) * self.ring.nodes).ravel() / 2.0
        guess = guessed_unknowns(self.problem, t)
        for k, (j, order) in enumerate(array.unknowns):
            if j < len(self.problem.system.coordinates) and order <= degree:
                curve = make_interp_spline(solution.t, solution[array.names[j].removeprefix("q.")], k=degree)
                guess[k] = curve.derivative(order)(t)
        found = unknowns_from(self.problem, t, guess)
        found = self.ring.tried(np.moveaxis(found.reshape(len(found), -1, len(self.begin)), 1, 0))
        return found[:-1, array.places(array.determined)], found[:, array.places(array.states)]

    def _given(self, s: Model) -> Model:
        """Return models of path, parameters, time and states."""
        ends = np.stack([self.begin, self.end])
        return np.concatenate([given_models(self.problem, self.problem.array, self.ring, ends, {}), s], axis=1)

    def _tested(self, x: Array, s: Model) -> tuple[Array, Array]:
        """Return polynomials of unknowns and their derivatives after Newton's method, and their radii."""
        given, nothing = self._given(s), np.zeros(x.shape[1:])
        for _ in self.equations.ends:  # the blocks one after the other
            *_, shift = radii(self.equations, self.ring, x, given, nothing, nothing[:, :1])
            if (norm(shift) <= _SETTLED * norm(x).max()).all():
                break
            x = x - np.where(np.isfinite(shift), shift, 0.0)
        sizes = np.maximum(norm(x).max(axis=1, keepdims=True), 1e-12)
        self.D = np.tile(_BESIDE * sizes, len(self.begin))
        rho, switches, *_ = radii(self.equations, self.ring, x, given, self.D, sizes)
        within = (rho <= self.D)[self.equations.curved].all(axis=0) & np.isfinite(rho).all(axis=0) & ~switches
        return x, np.where(within, rho, np.inf)

    def _flow(self, x: Model, s: Model) -> tuple[Model, Model]:
        """Return models of f (terms + 1, n, N) and of df/ds (terms + 1, n, n, N)."""
        found, n = self.equations.flow(self.ring, np.concatenate([x, self._given(s)], axis=1)), s.shape[1]
        return found[:, :n], found[:, n:].reshape(len(found), n, n, -1).swapaxes(1, 2)

    def _moved(self, x: Array, s: Model, state: Array) -> Model:
        """Return polynomials of the states after a step of Newton's method for the motion from its first state.

        s' = f + J (s - s_hat) is integrated by collocation at the nodes, from any value on each interval, then from one
        interval to the next.
        """
        f, J, old = (self.ring.values(each) for each in (*self._flow(model_of(x), s), s))
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

    def _bound(self, x: Array, rho: Array, s: Model, start: Array) -> None:
        """Enclose states and unknowns after steps of Newton's method, if their error has a bound."""
        sizes, width = self._sizes(s), self.end - self.begin
        for _ in range(_CORRECTIONS):
            moved = self._moved(x, s, start)
            change = (norm(moved - s) / sizes[:, None]).max()
            if not change <= 1.0:
                break  # an unstable motion, which no integration from its start finds
            s = moved
            x, rho = self._tested(x, s)
            if change <= _CORRECT:
                break
        f, J = self._flow(model_of(x, rho), s)
        V = np.linalg.eig(J[0].mean(axis=2)).eigenvectors
        inverse, rows, worst = np.linalg.pinv(V), np.linalg.norm(V, axis=1) * _OFF, np.linalg.cond(V)
        most, tube = (_TUBE * sizes / rows).min(), s.copy()
        tube[-1] += (rows * most)[:, None]
        beside, wide = self._tested(x, tube)
        self.D -= norm(beside - x)
        # Where x_hat + rho is within D around the other polynomial, both tests find the same solution.
        other = (rho > self.D)[self.equations.curved].any(axis=0)
        around = model_of(beside, wide)
        J = self._flow(around, tube)[1].transpose(0, 3, 1, 2)
        M, varied = inverse @ J[0] @ V, np.abs(inverse) @ norm(J[1:]) @ np.abs(V)
        mu = np.linalg.eigvalsh((M + M.conj().swapaxes(1, 2)) / 2.0)[:, -1]
        mu += np.linalg.norm(varied, axis=(1, 2)) * _OFF + _ROUNDED * len(V) * worst**2 * np.linalg.norm(
            J[0], axis=(1, 2)
        )
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
        lost = np.flatnonzero(~(largest < most) | other | (worst > _WORST))
        if len(lost):
            why = f"with {norms}" if np.isfinite(mu).all() else "as the equations are not proved beside them"
            self.sentence = f"{why} no bound of their error is known from t = {self.begin[lost[0]]:.6g} s on"
            return
        share = (rows * largest.max() / sizes).max()
        self.sentence = f"states of the internal dynamics within {share:.1e} of their peaks{self._from}, by {norms}"
        inputs, count = self.equations.inputs, len(self.problem.array.determined)
        slopes = magnitude(around[:, count:]).reshape(len(rows), count, -1)
        s[-1] += rows[:, None] * largest
        rho[:count] = (rho[:count] + np.tensordot(rows, slopes, 1) * largest) * _OFF
        self.x, self.given = model_of(x, rho), self._given(s)
        self.relative = (rho[inputs] / self.peaks[inputs]).max(axis=0)
        self.joints = self._joints()
