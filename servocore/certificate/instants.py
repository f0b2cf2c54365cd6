"""A proved motion at instants: enclosures there, error bounds of inputs, and what lies between the instants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from servocore.certificate.chebyshev import arithmetic, magnitude
from servocore.certificate.proof import Proof
from servocore.certificate.statements import Claim, Statement, Verdict, walk_of_limits
from servocore.model.limits import Limit, Named
from servocore.numerics.compiled_calls import Array
from servocore.references.base import time_grid
from servocore.solution import Solution

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
    unknowns = proof.at(proof.enclosures[:, places], t)
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


def tube_of(proof: Proof, t: Array, names: Sequence[str]) -> tuple[Array, Array]:
    """Return the least and the largest values of quantities at times, shape (quantities, N) each."""
    ring, equations = arithmetic((0, *proof.ring.degrees[1:])), proof.equations
    walk = walk_of_limits(equations, tuple(Limit(name, "", -np.inf, "", Named(name)) for name in names))
    low, high = ring.span(walk(ring, proof.at(proof.enclosures, t)))
    known = np.isfinite(low) & np.isfinite(high)
    return np.where(known, low, -np.inf), np.where(known, high, np.inf)
