"""A proved motion at instants: enclosures there, error bounds of inputs, and what lies between the instants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from servocore.certificate.chebyshev import UNIT, Model, arithmetic, norm
from servocore.certificate.equations import parameter_models, path_models
from servocore.certificate.krawczyk import radii
from servocore.certificate.proof import Proof
from servocore.certificate.statements import Statement, Verdict, limit_statements
from servocore.model.limits import Limit, Named
from servocore.numerics.compiled_calls import Array
from servocore.references.base import time_grid
from servocore.solution import Solution

_SPIKE = 2.0  # times the largest value at the instants: beyond it, these do not show the input
_FLOOR = 1e-6  # of the largest input: one that is less may be round-off
_NARROW = 1e-7  # of a peak: where an instant's solution is looked for


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


@dataclass(frozen=True, eq=False)
class Instants:
    """Inputs at instants: enclosed there, and compared with those of a solution."""

    proofs: Sequence[Proof]
    solution: Solution | None

    @cached_property
    def times(self) -> Array:
        """The instants of the solution, or of a default run."""
        return time_grid(self.proofs[0].problem.reference, None) if self.solution is None else self.solution.t

    @cached_property
    def enclosures(self) -> tuple[Array, Array]:
        """Middle and radius of the inputs (inputs, N): by a proof at each instant, else by those of the intervals."""
        proof = self.proofs[0]
        places = proof.equations.inputs
        c, r = at_times(proof, self.times)
        middle, radius = c[0, places], (norm(c[1:]) + r)[places] * (1.0 + 1e-14)
        if proof.boxed:
            return middle, radius
        ring, count = arithmetic((0,)), len(proof.equations.array.unknowns)
        x = proof.answers.from_near(self.times, np.tile(proof.problem.p[:, None], len(self.times)), c[0, :count])
        given = c[:1, count:], r[count:]
        D = np.tile(_NARROW * proof.peaks[:, None], len(self.times))
        rho, _ = radii(proof.equations, ring, np.where(np.isfinite(x), x, 0.0)[None], given, D, proof.peaks)
        curved = proof.equations.curved
        # The same solution as the interval's: it lies where that is the only one.
        within = np.stack([proof.intervals[k].D for k in _interval_of(proof, self.times)], axis=1)
        same = ((np.abs(x - c[0, :count]) + rho <= within) & (rho <= D))[curved].all(axis=0) & np.isfinite(rho).all(
            axis=0
        )
        return np.where(same, x[places], middle), np.where(same, rho[places], radius)

    @cached_property
    def errors(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the errors of reported inputs, (inputs, N)."""
        middle, radius = self.enclosures
        if self.solution is None:
            return np.zeros_like(radius), radius
        names = [each.name for each in self.proofs[0].problem.system.inputs]
        apart = np.abs(np.stack([self.solution[name] for name in names]) - middle)
        return apart - radius, apart + radius

    @cached_property
    def peaks(self) -> Array:
        """Largest magnitude of every input at the instants; those next to nothing as a share of the largest."""
        peaks = np.abs(self.enclosures[0]).max(axis=1)
        return np.asarray(np.maximum(peaks, max(_FLOOR * peaks.max(initial=0.0), 1e-300)))

    @property
    def bounds(self) -> dict[str, ErrorBound]:
        """By input."""
        inputs, places = self.proofs[0].problem.system.inputs, self.proofs[0].equations.inputs
        between = np.max([each.rho[places] for proof in self.proofs for each in proof.intervals], axis=0)
        return {
            each.name: ErrorBound(float(self.errors[1][k].max()), float(between[k]), float(self.peaks[k]), each.unit)
            for k, each in enumerate(inputs)
        }

    def statements(self, tolerance: float) -> list[Statement]:
        """State that inputs of a solution are right, and that no input goes far beyond its values at the instants."""
        path, inputs = self.proofs[0].problem.reference, self.proofs[0].problem.system.inputs
        found = []
        if self.solution is not None:
            low, high = (each / self.peaks[:, None] for each in self.errors)
            verdict: Verdict = (
                "proved" if (high <= tolerance).all() else "refuted" if (low > tolerance).any() else "undecided"
            )
            k, at = np.unravel_index(int(high.argmax()), high.shape)
            text = f"{inputs[k].name} is off by at most {high.max():.2g} of its peak, at t = {self.times[at]:.6g} s"
            what = f"inputs within {tolerance:g} of their peaks"
            found.append(Statement(what, verdict, path.start_time, path.end_time, text, float(self.times[at])))
        spikes = [
            Limit(
                each.name,
                each.unit,
                -_SPIKE * peak,
                "the instants do not show it",
                Named(each.name),
                upper=_SPIKE * peak,
            )
            for each, peak in zip(inputs, self.peaks.tolist(), strict=True)
        ]
        if self.proofs[0].boxed:
            return found
        return found + limit_statements(
            self.proofs, spikes, lambda limit: f"{limit.quantity} between instants at most twice its peak at instants"
        )


def _interval_of(proof: Proof, t: Array) -> list[int]:
    """Return the numbers of the intervals that times are in."""
    ends = np.array([each.end for each in proof.intervals])
    numbers: list[int] = np.clip(np.searchsorted(ends, t, side="right"), 0, len(ends) - 1).tolist()
    return numbers


def at_times(proof: Proof, t: Array) -> Model:
    """Return the arguments of walks at times (N,), polynomials in the parameters: one box each."""
    ring = arithmetic((0, *proof.ring.degrees[1:]))
    numbers = _interval_of(proof, t)
    some = [proof.intervals[k] for k in numbers]
    a, b = (np.array([getattr(each, name) for each in some]) for name in ("begin", "end"))
    position = (2.0 * t - a - b) / (b - a)
    elsewhere = np.abs(position) > 1.0 + 1e-9
    basis = np.polynomial.chebyshev.chebvander(np.clip(position, -1.0, 1.0), proof.ring.degrees[0])
    # A time is off by rounding in the middle of an interval: that is a share of what the polynomials vary by.
    c = np.stack([each.c for each in proof.intervals if each.c is not None])
    terms, unknowns = basis.shape[1], c.shape[2]
    shaped = c.reshape(len(c), terms, -1)
    x = (basis[:, None] @ shaped[numbers]).reshape(len(t), -1, unknowns).transpose(1, 2, 0)
    late = 8.0 * UNIT * (1.0 + (np.abs(a) + np.abs(b)) / (b - a))
    share = (np.arange(terms) ** 2.0 + 12.0) @ np.abs(shaped)
    noise = share.reshape(len(c), -1, unknowns).sum(axis=1)[numbers].T * late
    bad = elsewhere | ~np.isfinite(x).all(axis=(0, 1))
    rho = np.stack([each.rho for each in some], axis=1) + noise
    x, rho = np.where(bad, 0.0, x), np.where(bad, np.inf, rho)
    path = path_models(proof.problem, ring, t, t, proof.equations.path_order)
    p = parameter_models(ring, proof.problem.p, proof.boxed, len(t))
    return np.concatenate([x, path[0], p[0]], axis=1), np.concatenate([rho, path[1], p[1]])


def tube_of(proof: Proof, t: Array, names: Sequence[str]) -> tuple[Array, Array]:
    """Return the least and the largest values of quantities at times, shape (quantities, N) each."""
    ring = arithmetic((0, *proof.ring.degrees[1:]))
    walk = proof.equations.walk([Named(name)(proof.problem.system) for name in names])
    low, high = ring.span(walk(ring, at_times(proof, t)))
    known = np.isfinite(low) & np.isfinite(high)
    return np.where(known, low, -np.inf), np.where(known, high, np.inf)
