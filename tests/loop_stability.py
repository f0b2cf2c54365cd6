"""Stability of the loop of feedback and crane: transition matrices along a path, and margins of a crane at rest.

What is linearized, by differences, is what an FMU carries, with a plant that knows of no FMU.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from called import Sampled
from loops import CRANE, jets_at
from plain_crane import advance, flat, measured_of

P = np.array(list(CRANE.parameter_values().values()))
_COST, _PATH = 100, 21  # of the memory: the cost-to-go first, and last what does not depend on the state
_NO_LIMITS = [1e9] * 3


class Loop:
    """The loop as a map of plain vectors.

    Its state is that of the crane, what the crane was given for this step and the one before, what the feedback has
    given, and its memory; the cost-to-go, which depends on the path alone, is kept beside.
    """

    def __init__(self, law: Sampled, at: str, h: float, jet: np.ndarray) -> None:
        self._law, self._at_end, self._h = law, at == "end", h
        x, u = flat(np.reshape([*jet[:3], *[0.0] * 12], (5, 3)), P)
        (memory,) = law.begin(jet, measured_of(x), P, h)
        self.cost = memory[:_COST]
        self.state = np.concatenate([x, u, u, u, memory[_COST:]])
        self.moving = len(self.state) - _PATH

    def step(
        self, state: np.ndarray, jet: np.ndarray, following: np.ndarray, more: np.ndarray | float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the state a step later, and the cost-to-go; the crane is given something more than it should be."""
        x, given, before, own, rest = np.split(state, [10, 13, 16, 19])
        told, old = (following, jet) if self._at_end else (jet, jet)
        memory = np.concatenate([self.cost, rest])
        memory, new = self._law.follow(memory, told, old, measured_of(x), own, own, P, self._h, 1.0, _NO_LIMITS)
        then = new + more
        slope = (then - given) / self._h if self._at_end else (given - before) / self._h
        after = advance(False, x, given, slope, np.zeros(3), P, self._h)
        return np.concatenate([after, then, given, new, memory[_COST:]]), memory[:_COST]

    def jacobian(self, jet: np.ndarray, following: np.ndarray) -> np.ndarray:
        """Return the transition matrix of a step."""
        n, base = self.moving, self.step(self.state, jet, following)[0]
        columns = []
        for j in range(n):
            size, shifted = 1e-6 * (1.0 + abs(self.state[j])), self.state.copy()
            shifted[j] += size
            columns.append((self.step(shifted, jet, following)[0] - base)[:n] / size)
        return np.array(columns).T

    def advance(self, jet: np.ndarray, following: np.ndarray) -> None:
        """Go on by a step."""
        self.state, self.cost = self.step(self.state, jet, following)


def transition_norms(law: Sampled, at: str, h: float) -> Iterator[float]:
    """Yield norms of the transition matrix from the start of the default manoeuvre on, until four seconds after it."""
    path = CRANE.reference
    t = h * np.arange(round((path.duration + 4.0) / h) + 2)
    jets = jets_at(path, t).reshape(len(t), 15)
    loop = Loop(law, at, h, jets[0])
    loop.advance(jets[0], jets[1])
    product = np.eye(loop.moving)
    for jet, following in pairwise(jets[1:]):
        product = loop.jacobian(jet, following) @ product
        yield float(np.linalg.norm(product, 2))
        loop.advance(jet, following)


def sensitivity(law: Sampled, at: str, h: float, place: np.ndarray) -> float:
    """Return by how much a disturbance at the inputs is amplified at most, where the crane stands still."""
    jet = np.concatenate([place, np.zeros(12)])
    loop = Loop(law, at, h, jet)
    for _ in range(3):
        loop.advance(jet, jet)
    scale = np.array([P[0] / np.hypot(*place[:2]), P[1], (P[2] + P[3] / P[4] ** 2) * P[4]])  # worth 1 m/s2
    base, n = loop.step(loop.state, jet, jet)[0], loop.moving
    inputs = [(loop.step(loop.state, jet, jet, 1e-3 * column)[0] - base)[:n] / 1e-3 for column in np.diag(scale)]
    transition, entering = loop.jacobian(jet, jet), np.array(inputs).T
    largest = 0.0
    for angle in np.geomspace(0.02 * h, np.pi, 300):
        response = np.linalg.solve(np.exp(1j * angle) * np.eye(n) - transition, entering)
        given = np.exp(1j * angle) * response[10:13] / scale[:, None]
        largest = max(largest, float(np.linalg.norm(given, 2)))
    return largest
