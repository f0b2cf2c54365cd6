"""Taylor polynomials of the unknowns of a derivative array, and whether two of them belong to one motion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.numerics.angle_wrapping import wrapped_angle
from servocore.numerics.compiled_calls import Array
from servocore.structure.derivative_array import DerivativeArray

_APART = 0.1  # of the movement: two Taylor polynomials that miss each other by less belong to one motion
_AT_ONCE = 1 << 16  # intervals that are compared together: a million at once would fill the memory
_NONE = np.zeros(0, dtype=np.intp)
SLIGHT = 1e-3
"""Of the range of a coordinate: a miss that says nothing."""

Powers = tuple[tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]], ...]


@dataclass(frozen=True, eq=False)
class Taylor:
    """Taylor polynomials of all unknowns of a derivative array, from the unknowns themselves.

    Attributes
    ----------
    powers : tuple of (ndarray, ndarray)
        For every power of time: places of unknowns, and places of the derivatives that are their coefficients.
    of_q : tuple of (ndarray, ndarray)
        The same for the coordinates alone, by their number.
    q, rates : ndarray
        Places of the coordinates and of their velocities.
    wraps : ndarray of bool
        Which coordinates are known up to full turns only.
    """

    powers: Powers
    of_q: Powers
    q: npt.NDArray[np.intp]
    rates: npt.NDArray[np.intp]
    wraps: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, array: DerivativeArray) -> Taylor:
        """Find the places in an array."""
        n, quantities = len(array.system.coordinates), array.system.coordinates.quantities
        q, rates = (np.array(array.places([(k, order) for k in range(n)]), dtype=np.intp) for order in (0, 1))
        wraps = np.array([quantity.wraps for quantity in quantities], dtype=bool)
        positions = tuple((k, 0) for k in range(n))
        return cls(_powers(array, array.unknowns), _powers(array, positions), q, rates, wraps)

    def ahead(self, y: Array, h: Array | float) -> Array:
        """Return the unknowns (size, N) as they would be `h` later."""
        return _summed(self.powers, y, h, len(y))

    def apart(self, first: Array, last: Array, h: Array, scale: Array) -> npt.NDArray[np.bool_]:
        """Whether neighbours (size, N), `h` apart, belong to two motions; `scale` is the range of the coordinates."""
        q0, q1 = first[self.q], last[self.q]
        n, wraps = len(self.q), self.wraps.any()
        miss = _summed(self.of_q, first, h, n) - q1, _summed(self.of_q, last, -h, n) - q0
        for difference in miss if wraps else ():
            difference[self.wraps] = wrapped_angle(difference[self.wraps])
        travel = np.abs(h) * (np.abs(first[self.rates]) + np.abs(last[self.rates]))
        travel += np.where(self.wraps[:, None], 0.0, np.abs(q1 - q0))
        worst = np.maximum(*np.abs(miss))
        # Not <=, so that NaN counts as apart.
        are_apart: npt.NDArray[np.bool_] = ~(worst <= np.maximum(_APART * travel, SLIGHT * scale[:, None])).all(axis=0)
        return are_apart

    def jumps(self, t: Array, states: Array, scale: Array) -> npt.NDArray[np.intp]:
        """Return the intervals between the instants `t` (N,) whose ends, of the states (size, N), are `apart`."""
        parts = [slice(begin, begin + _AT_ONCE + 1) for begin in range(0, max(len(t) - 1, 1), _AT_ONCE)]
        of_parts = [self.apart(states[:, k][:, :-1], states[:, k][:, 1:], np.diff(t[k]), scale) for k in parts]
        return np.flatnonzero(np.concatenate(of_parts))

    def compile_together(self, size: int) -> ca.Function:
        """Compile (first (size,), last, h, scale) -> one where neighbours are not `apart`."""
        first, last, h = ca.SX.sym("first", size), ca.SX.sym("last", size), ca.SX.sym("h")
        scale, together = ca.SX.sym("scale", len(self.q)), ca.SX(1)
        for k, (q, rate) in enumerate(zip(self.q.tolist(), self.rates.tolist(), strict=True)):
            places = [of[to == k].tolist() for to, of in self.of_q]
            ahead, behind = (
                sum(side[of[0]] * (step**j / math.factorial(j)) for j, of in enumerate(places) if of)
                for side, step in ((first, h), (last, -h))
            )
            misses = [ahead - last[q], behind - first[q]]
            travel = ca.fabs(h) * (ca.fabs(first[rate]) + ca.fabs(last[rate]))
            if self.wraps[k]:
                misses = [miss - 2 * np.pi * ca.floor((miss + np.pi) / (2 * np.pi)) for miss in misses]
            else:
                travel += ca.fabs(last[q] - first[q])
            allowed = ca.fmax(_APART * travel, SLIGHT * scale[k])
            together = ca.logic_and(together, ca.logic_and(*(ca.fabs(miss) <= allowed for miss in misses)))
        return ca.Function("sc_together", [first, last, h, scale], [ca.densify(together)], {"cse": True})


def _powers(array: DerivativeArray, entries: tuple[tuple[int, int], ...]) -> Powers:
    place = {unknown: k for k, unknown in enumerate(array.unknowns)}
    powers = []
    for power in range(max(order for _, order in array.unknowns) + 1):
        known = [(k, place[j, order + power]) for k, (j, order) in enumerate(entries) if (j, order + power) in place]
        to, of = (np.array(indices, dtype=np.intp) for indices in zip(*known, strict=True)) if known else (_NONE, _NONE)
        powers.append((to, of))
    return tuple(powers)


def _summed(powers: Powers, y: Array, h: Array | float, size: int) -> Array:
    """Return the sums of `powers` at `h`, shape (size, N)."""
    total, factor = np.zeros((size, y.shape[1])), 1.0 + 0.0 * np.asarray(h)
    for power, (to, of) in enumerate(powers):
        factor = factor * h / power if power else factor
        total[to] += y[of] * factor
    return total
