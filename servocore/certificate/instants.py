"""A proved motion at instants: enclosures there, error bounds of inputs, and what lies between the instants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from servocore.certificate.chebyshev import UNIT, Model, arithmetic, norm
from servocore.certificate.equations import parameter_models, path_models
from servocore.certificate.krawczyk import joined
from servocore.certificate.programs import UP
from servocore.certificate.proof import Proof
from servocore.certificate.statements import Statement, Verdict, limit_statements
from servocore.model.limits import Limit, Named
from servocore.numerics.compiled_calls import Array
from servocore.references.base import time_grid
from servocore.solution import Solution

_SPIKE = 2.0  # times the largest value at the instants: beyond it, these do not show the input
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
        """Middle and radius of the inputs (inputs, N)."""
        (c, r), places = unknowns_at(self.proofs[0], self.times), self.proofs[0].equations.inputs
        return c[0, places], (norm(c[1:]) + r)[places] * UP

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


def unknowns_at(proof: Proof, t: Array) -> Model:
    """Return the unknowns at times (N,), polynomials in the parameters: one box each; infinite radii if not proved."""
    ends = np.array([each.end for each in proof.intervals])
    numbers = np.clip(np.searchsorted(ends, t, side="right"), 0, len(ends) - 1)
    a, b = np.array([each.begin for each in proof.intervals])[numbers], ends[numbers]
    position = (2.0 * t - a - b) / (b - a)
    basis = np.polynomial.chebyshev.chebvander(np.clip(position, -1.0, 1.0), proof.ring.degrees[0])
    models = proof.models(proof.intervals)
    count = len(proof.peaks)
    c, rho = np.moveaxis(models[0][:, :count], 2, 0), models[1][:count, numbers]
    shaped = c.reshape(len(ends), basis.shape[1], -1)
    x = (basis[:, None] @ shaped[numbers]).reshape(len(t), -1, count).transpose(1, 2, 0)
    # A time is off by rounding in the middle of an interval: that is a share of what the polynomials vary by.
    late = 8.0 * UNIT * (1.0 + (np.abs(a) + np.abs(b)) / (b - a))
    share = (np.arange(basis.shape[1]) ** 2.0 + 12.0) @ np.abs(shaped)
    noise = share.reshape(len(ends), -1, count).sum(axis=1)[numbers].T * late
    return x, np.where(np.abs(position) > 1.0 + 1e-9, np.inf, rho + noise)


def tube_of(proof: Proof, t: Array, names: Sequence[str]) -> tuple[Array, Array]:
    """Return the least and the largest values of quantities at times, shape (quantities, N) each."""
    ring = arithmetic((0, *proof.ring.degrees[1:]))
    walk = proof.equations.walk([Named(name)(proof.problem.system) for name in names])
    path = path_models(proof.problem, ring, t, t, proof.equations.path_order)
    given = joined(path, parameter_models(ring, proof.problem.p, proof.boxed, len(t)))
    low, high = ring.span(walk(ring, joined(unknowns_at(proof, t), given)))
    known = np.isfinite(low) & np.isfinite(high)
    return np.where(known, low, -np.inf), np.where(known, high, np.inf)
