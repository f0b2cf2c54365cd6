"""A step of the energy-momentum scheme in rotations and displacements: six unknowns a body, no multipliers.

The equations are those of `energy_momentum`, in the discrete null space of the constraints (Betsch 2005). The
unknowns w are changes of places, and for every body a rotation theta:

    d_i1 = cay(theta) d_i0,     cay(theta) = (I - S/2)^-1 (I + S/2),     S = skew(theta)

Then q1 - q0 = P w with the columns -skew(d_ih) of P at the middle of the step, directors stay orthonormal, and P^T
eliminates their multipliers. With r(w) = P^T R of the momentum rows R, A = G P of the joints in the middle of the
step and A0 the same at its beginning, a projection eliminates the multipliers of the joints:

    (I - A^T (A0 A^T)^-1 A0) r(w) + A0^T g(q1) = 0

The first term is orthogonal to the rows of A0 and the second in their span, so that both vanish. No dependent columns
are chosen: the matrix is regular as long as the joints are independent. All multipliers then follow from one linear
solve.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel
from servocore.model.system import MechanicalSystem
from servocore.numerics.newton import MAX_ITERATIONS, NEWTON_TOLERANCE, TICK
from servocore.stepping.energy_momentum_terms import StepTerms, step_terms

_DIRECTORS = tuple(f"d{k}_{axis}" for k in (1, 2, 3) for axis in "xyz")
_ROUND_OFF = 1e-9


@dataclass(frozen=True)
class RotationUpdate:
    """For `EnergyMomentum`: six unknowns a body, and no multipliers in the equations of a step.

    The motion is that with multipliers, to Newton's tolerance. Directors stay orthonormal, to accumulated round-off. A
    body can turn by less than half a turn in a step. The update is faster where most constraints are those of rigid
    bodies; with many joints multipliers are.
    """


@dataclass(frozen=True, eq=False)
class _Unknowns:
    """The unknowns w of a step, by places of the coordinates.

    Attributes
    ----------
    frames : list of list of list of int
        Indices of the components of the three directors of every body.
    plain : list of int
        Indices of all other coordinates.
    rows : list of int
        Constraints other than orthonormality.
    """

    frames: list[list[list[int]]]
    plain: list[int]
    rows: list[int]

    @property
    def count(self) -> int:
        return len(self.plain) + 3 * len(self.frames)

    def change(self, q: ca.SX, w: ca.SX) -> ca.SX:
        """Return the change of a configuration by the unknowns, shape (n,)."""
        moves = ca.SX.zeros(q.numel())
        moves[self.plain] = w[: len(self.plain)]
        for theta, directors in zip(ca.vertsplit(w[len(self.plain) :], 3), self.frames, strict=True):
            for d in directors:
                across = ca.cross(theta, q[d])
                moves[d] = 4 / (4 + ca.sumsqr(theta)) * (across + ca.cross(theta, across) / 2)
        return moves

    def basis(self, q: ca.SX) -> ca.SX:
        """Return P, shape (n, count): the directions in which the unknowns move the coordinates."""
        directions = ca.SX(q.numel(), self.count)
        for column, place in enumerate(self.plain):
            directions[place, column] = 1
        for k, directors in enumerate(self.frames):
            first = len(self.plain) + 3 * k
            for d in directors:
                directions[d, first : first + 3] = -ca.skew(q[d])
        return directions

    def guess(self, q: ca.SX, change: ca.SX) -> ca.SX:
        """Return the unknowns of a change of configuration, to first order."""
        turns = [sum(ca.cross(q[d], change[d]) for d in directors) / 2 for directors in self.frames]
        return ca.vertcat(change[self.plain], *turns)


def _unknowns_of(system: MechanicalSystem) -> _Unknowns:
    """Return the unknowns of a system; raise `InvalidModel` for a body whose directors are not kept orthonormal."""
    names = system.coordinates.names
    stems = [name.removesuffix(_DIRECTORS[0]) for name in names if name.endswith(_DIRECTORS[0])]
    frames, internal = [], set[int]()
    for stem in stems:
        if not all(f"{stem}{director}" in names for director in _DIRECTORS):
            continue
        places = [names.index(f"{stem}{director}") for director in _DIRECTORS]
        rows = _orthonormality(system, places)
        if len(rows) != 6:
            raise InvalidModel(
                f"{system.name}: RotationUpdate turns bodies, but of the six constraints that keep the directors of"
                f" {stem.rstrip('._')} orthonormal there are {len(rows)}; without RotationUpdate it can be integrated"
            )
        frames.append([places[:3], places[3:6], places[6:]])
        internal |= set(rows)
    turned = {place for directors in frames for places in directors for place in places}
    return _Unknowns(
        frames,
        [k for k in range(len(names)) if k not in turned],
        [k for k in range(system.lam.numel()) if k not in internal],
    )


def _orthonormality(system: MechanicalSystem, places: list[int]) -> list[int]:
    """Return constraints on nine directions that hold after every rotation, tested by two arbitrary ones."""
    pattern = np.asarray(ca.DM(ca.jacobian_sparsity(system.constraints, system.q), 1))
    others = np.setdiff1d(range(pattern.shape[1]), places)
    rows = [k for k in range(len(pattern)) if not pattern[k, others].any() and pattern[k].any()]
    look = ca.Function("sc_rows", [system.q, system.p], [ca.densify(system.constraints[rows])])
    worst = np.zeros(len(rows))
    for seed in (1.0, 2.0):
        turn, _ = np.linalg.qr(np.sin(seed + 7.0 * np.arange(9)).reshape(3, 3))
        q = np.zeros(len(system.coordinates))
        q[places] = turn.ravel()
        residual = np.asarray(look(q, system.parameters.values())).ravel()
        worst = np.maximum(worst, np.abs(residual))
    return [k for k, value in zip(rows, worst, strict=True) if value < _ROUND_OFF]


def compile_rotation_step(system: MechanicalSystem) -> ca.Function:
    """Compile (state (q, v, L), u, h, p) -> (state, counts (2,), residual, work), as `ConservingStep` has it.

    Raises
    ------
    InvalidModel
        If a body has directors that the constraints do not keep orthonormal.
    """
    unknowns, n, terms = _unknowns_of(system), len(system.coordinates), step_terms(system)
    sizes = (2 * n + system.lam.numel(), len(system.inputs), 1, system.p.numel())
    state, *others = (ca.MX.sym(name, size) for name, size in zip(("state", "u", "h", "p"), sizes, strict=True))
    givens = ca.vertcat(state[: 2 * n], *others)
    root, iterations, residual = _solved(unknowns, terms, givens)
    w, q0, v0, h = ca.SX.sym("w", unknowns.count), terms.q0, terms.v0, terms.h
    change = unknowns.change(q0, w)
    at_end = ca.substitute([terms.momentum, terms.G, ca.dot(terms.push, terms.change)], [terms.change], [change])
    end = ca.Function("sc_rotated", [w, terms.givens], [q0 + change, 2 * change / h - v0, *at_end], {"cse": True})
    q, v, momentum, G, work = end(root, givens)
    # All multipliers by one linear solve.
    L = -2 * ca.solve(ca.mtimes(G, G.T), ca.mtimes(G, momentum), "qr") if system.lam.numel() else ca.MX(0, 1)
    after = ca.vertcat(q, v, L)
    counts = ca.vertcat(iterations, iterations)
    return ca.Function("sc_rotation_step", [state, *others], [after, counts, residual, work])


def _solved(unknowns: _Unknowns, terms: StepTerms, givens: ca.MX) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Return the unknowns of a step, Newton iterations, and the largest scaled residual."""
    plain, size = unknowns.plain, unknowns.count
    scales = ca.vertcat(terms.nominal[plain] + ca.fabs(terms.q0[plain]), ca.SX.ones(3 * len(unknowns.frames)))
    guess = unknowns.guess(terms.q0, terms.h * terms.v0) / scales
    start, scale = ca.Function("sc_begin", [terms.givens], [guess, scales], {"cse": True})(givens)
    x, p = ca.MX.sym("x", size + 1), ca.MX.sym("p", givens.numel() + size)
    equations, J = _projected(unknowns, terms, x[:size], p[: givens.numel()], p[givens.numel() :])
    late = ca.exp(-x[size] / TICK)  # the clock of `newton`: every correction is a tick
    g = ca.vertcat(equations, late)
    look = ca.Function("sc_look", [x, p], [ca.diagcat(J, -late / TICK), g], ["x", "p"], ["J", "g"])
    options = {"abstol": 0.0, "abstolStep": NEWTON_TOLERANCE, "error_on_fail": False, "max_iter": MAX_ITERATIONS}
    newton = ca.rootfinder("sc_turn", "fast_newton", {"x": x, "p": p, "g": g}, {**options, "jacobian_function": look})
    handed = ca.vertcat(givens, scale)
    root = newton(ca.vertcat(start, 0), handed)
    ticks = root[size] / TICK
    _, left = look(root, handed)
    residual = ca.mmax(ca.fabs(left[:size]))
    return root[:size] * scale * ca.if_else(ticks > MAX_ITERATIONS - 0.5, np.nan, 1.0), ticks, residual


def _projected(unknowns: _Unknowns, terms: StepTerms, x: ca.MX, givens: ca.MX, scale: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Return the projected equations and their Jacobian, scaled by the largest inertia.

    Rows and unknowns are weighed by the roots of their inertias, joints by the sizes of their rows, so that the
    condition of the matrix depends neither on units nor on h.
    """
    step, weights = ca.SX.sym("x", unknowns.count), ca.SX.sym("scale", unknowns.count)
    change = unknowns.change(terms.q0, step * weights)
    momentum, G = ca.substitute([terms.momentum, terms.G], [terms.change], [change])
    basis, first = unknowns.basis(terms.q0 + change / 2), unknowns.basis(terms.q0)
    inertia = ca.diag(ca.mtimes([first.T, terms.mass, first])) * weights**2
    heaviest = ca.mmax(inertia)
    unit = weights / ca.sqrt(ca.if_else(inertia > _ROUND_OFF * heaviest, inertia, heaviest))
    r = ca.mtimes(basis.T, momentum) * unit / ca.sqrt(heaviest)
    rows = unknowns.rows
    A, A0 = (ca.mtimes(m[rows, :], P) for m, P in ((G, basis), (terms.G_before, first)))
    A, A0 = (ca.mtimes(matrix, ca.diag(unit)) for matrix in (A, A0))
    size = ca.sqrt(ca.sum2(A0**2))
    A, A0 = (matrix / ca.repmat(size, 1, unknowns.count) for matrix in (A, A0))
    g = ca.substitute(terms.constraints_after[rows], terms.change, change) / size / ca.sqrt(heaviest)
    lam = ca.SX.sym("lam", len(rows))
    arguments = [step, ca.vertcat(terms.givens, weights)]
    dense = [ca.densify(expression) for expression in (r, A, A0, g, ca.jacobian(g, step))]
    look = ca.Function("sc_pieces", arguments, dense, {"cse": True})
    bend = ca.Function(
        "sc_bend", [*arguments, lam], [ca.densify(ca.jacobian(r + ca.mtimes(A.T, lam), step))], {"cse": True}
    )
    handed = ca.vertcat(givens, scale)
    residual, across, along, gap, slope = look(x, handed)
    if not rows:
        return residual, bend(x, handed, ca.MX(0, 1))
    reduce = ca.solve(ca.mtimes(along, across.T), along, "qr")
    K = bend(x, handed, -ca.mtimes(reduce, residual))
    # Twice: round-off of the forces along A0 would act like a gap of the joints.
    left = _without(across, reduce, _without(across, reduce, residual))
    return left + ca.mtimes(along.T, gap), _without(across, reduce, K) + ca.mtimes(along.T, slope)


def _without(across: ca.MX, reduce: ca.MX, columns: ca.MX) -> ca.MX:
    """Return columns without their components along forces of the joints."""
    return columns - ca.mtimes(across.T, ca.mtimes(reduce, columns))
