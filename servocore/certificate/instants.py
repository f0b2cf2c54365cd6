"""A proved motion at instants: enclosures there, error bounds of inputs, and what lies between the instants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from servocore.certificate.chebyshev import UNIT, Model, arithmetic, magnitude, model_of
from servocore.certificate.equations import equations_of, given_models, radii
from servocore.certificate.proof import Proof
from servocore.certificate.statements import Claim, Statement, Verdict, walk_of_limits
from servocore.model.limits import Limit, Named
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.references.base import time_grid
from servocore.solution import Solution
from servocore.stepping.exact_evaluation import guessed_unknowns, unknowns_from

_SPIKE = 2.0  # times the largest value at the instants: beyond it, these do not show the input
_SPLINE, _BESIDE = 5, 1e-6  # degree; D, of a peak
_UNSHOWN = "the instants do not show it"
_FLOOR = 1e-6  # of the largest input: one that is less may be round-off


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
        return self.at_instants / self.peak if self.peak else 0.0


def compared(
    proof: Proof, solution: Solution | None, tolerance: float
) -> tuple[dict[str, ErrorBound], list[Statement], list[Claim]]:
    """Bound errors of inputs, at the instants of a solution or of a default run, and state the consequence.

    Inputs of a solution are right, and it is claimed that no input goes far beyond its values at the instants; where
    equations switch inputs have no value to compare with.
    """
    inputs, places = proof.problem.system.inputs, proof.equations.inputs
    t = time_grid(proof.problem.reference, None) if solution is None else solution.t
    calm = ~proof.jumping[np.searchsorted(proof.end[:-1], t, side="right")]
    t = t[calm]
    unknowns = unknowns_at(proof, t, places)
    middle, radius = unknowns[0], magnitude(unknowns[1:])
    apart = 0.0 if solution is None else np.abs(np.stack([solution[each.name][calm] for each in inputs]) - middle)
    least, most = apart - radius, apart + radius
    peaks = np.abs(middle).max(axis=1)
    peaks = np.maximum(peaks, max(_FLOOR * peaks.max(initial=0.0), 1e-300))
    between = proof.x[-1, places][:, ~proof.jumping].max(axis=1)
    bounds, found, claims = dict[str, ErrorBound](), list[Statement](), list[Claim]()
    for k, each in enumerate(inputs):
        peak, what = float(peaks[k]), f"{each.name} between instants at most twice its peak at instants"
        bounds[each.name] = ErrorBound(float(most[k].max()), float(between[k]), peak, each.unit)
        spike = Limit(each.name, each.unit, -_SPIKE * peak, _UNSHOWN, Named(each.name), upper=_SPIKE * peak)
        claims += [] if proof.boxed else [Claim(what, spike)]
    if solution is not None:
        low, high = least / peaks[:, None], most / peaks[:, None]
        verdict: Verdict = "refuted" if (low > tolerance).any() else "undecided"
        verdict = "proved" if (high <= tolerance).all() else verdict
        place, at = np.unravel_index(int(high.argmax()), high.shape)
        text = f"{inputs[int(place)].name} is off by at most {high.max():.2g} of its peak, at t = {t[at]:.6g} s"
        what = f"inputs within {tolerance:g} of their peaks"
        found.append(Statement(what, verdict, text, float(t[at])))
    return bounds, found, claims


def unknowns_at(proof: Proof, t: Array, places: Sequence[int]) -> Model:
    """Return some unknowns at times (N,), polynomials in the parameters: one box each; infinite radii if not proved."""
    numbers = np.searchsorted(proof.end[:-1], t, side="right")
    a, b = proof.begin[numbers], proof.end[numbers]
    position = (2.0 * t - a - b) / (b - a)
    found = proof.enclosures[:, places][..., numbers]
    basis = np.polynomial.chebyshev.chebvander(np.clip(position, -1.0, 1.0), proof.ring.degrees[0])
    shaped = found[:-1].reshape(basis.shape[1], -1, *found.shape[1:])
    # A time is off by rounding in the middle of an interval: that is a share of what the polynomials vary by.
    late = 8.0 * UNIT * (1.0 + (np.abs(a) + np.abs(b)) / (b - a))
    noise = np.tensordot(np.arange(basis.shape[1]) ** 2.0 + 12.0, np.abs(shaped), 1).sum(axis=0) * late
    radius = np.where(np.abs(position) > 1.0 + 1e-9, np.inf, found[-1] + noise)
    return model_of(np.einsum("nd,dpkn->pkn", basis, shaped), radius)


def tube_of(proof: Proof, t: Array, names: Sequence[str]) -> tuple[Array, Array]:
    """Return the least and the largest values of quantities at times, shape (quantities, N) each."""
    ring, equations = arithmetic((0, *proof.ring.degrees[1:])), proof.equations
    walk = walk_of_limits(equations, tuple(Limit(name, "", -np.inf, "", Named(name)) for name in names))
    given = given_models(proof.problem, equations.array, ring, np.array([t, t]), proof.boxed)
    unknowns = unknowns_at(proof, t, range(len(proof.peaks)))
    low, high = ring.span(walk(ring, np.concatenate([unknowns, given], axis=1)))
    known = np.isfinite(low) & np.isfinite(high)
    return np.where(known, low, -np.inf), np.where(known, high, np.inf)


@np.errstate(all="ignore")
def at_states(problem: Problem, solution: Solution) -> Statement:
    """State that the algebraic equations have one regular solution at each instant, at the computed states.

    These are the reported coordinates and their rates, by a spline through them.
    """
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - all commands import this module

    what, t = "one regular solution of the algebraic equations at the computed states", solution.t
    equations, ring = equations_of(problem.resolved, False), arithmetic((0,))
    array, guess, degree = equations.array, guessed_unknowns(problem, t), min(_SPLINE, len(t) - 1)
    for k, (j, order) in enumerate(array.unknowns):
        if j < len(problem.system.coordinates) and order <= degree:
            curve = make_interp_spline(t, solution[array.names[j].removeprefix("q.")], k=degree)
            guess[k] = curve.derivative(order)(t)
    found = unknowns_from(problem, t, guess)
    x, states = found[array.places(array.determined)], found[array.places(array.states)]
    given = given_models(problem, array, ring, np.array([t, t]), {})
    given = np.concatenate([given, ring.constant(states)], axis=1)
    sizes = np.maximum(np.nanmax(np.abs(x), axis=1, keepdims=True), 1e-12)
    D = np.tile(_BESIDE * sizes, len(t))
    rho, *_ = radii(equations, ring, np.nan_to_num(x)[None], given, D, sizes)
    lost = np.flatnonzero(~((rho <= D)[equations.curved].all(axis=0) & np.isfinite(x + rho).all(axis=0)))
    if len(lost):
        return Statement(what, "undecided", f"not proved at t = {t[lost[0]]:.6g} s", float(t[lost[0]]))
    places = equations.inputs
    reported = np.stack([solution[each.name] for each in problem.system.inputs])
    off = ((np.abs(reported - x[places]) + rho[places]) / sizes[places]).max()
    return Statement(what, "proved", f"inputs within {off:.1e} of their peaks, given these states")
