"""The unknown path of a stretch of a log: a spline on evenly spaced knots, and its normal equations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from servocore.numerics.compiled_calls import Array, Places


@dataclass(frozen=True, eq=False)
class PathSpline:
    """B-splines of some degree at given instants, on knots with equal distances.

    Coefficients j to j + degree of each component act on the j-th interval, so that normal equations are banded.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Instants in s.
    degree, orders, components : int
        Degree, number of derivatives with the value itself, and number of components of the path.
    spacing : float
        Of the knots, in s.
    """

    t: Array
    degree: int
    orders: int
    components: int
    spacing: float

    @cached_property
    def intervals(self) -> int:
        """Number of intervals."""
        return max(1, int(np.ceil((self.t[-1] - self.t[0]) / self.spacing - 1e-9)))

    @property
    def count(self) -> int:
        """Coefficients of one component."""
        return self.intervals + self.degree

    @cached_property
    def interval(self) -> Places:
        """Interval of each instant, shape (N,)."""
        inside = ((self.t - self.t[0]) / self.spacing).astype(np.intp)
        return np.asarray(np.minimum(inside, self.intervals - 1), dtype=np.intp)

    @cached_property
    def basis(self) -> Array:
        """Derivatives of the B-splines that do not vanish, shape (N, orders, degree + 1)."""
        from scipy.interpolate import BSpline  # noqa: PLC0415 - kept out of the run time of an FMU

        inside = (self.t - self.t[0]) / self.spacing - self.interval
        cardinal = BSpline.basis_element(np.arange(self.degree + 2), extrapolate=False)
        at = np.clip(inside, 0.0, 1.0 - 1e-12)[:, None] + np.arange(self.degree, -1, -1)
        return np.stack([np.nan_to_num(cardinal(at, k)) / self.spacing**k for k in range(self.orders)], axis=1)

    def jets(self, coefficients: Array) -> Array:
        """Return the path and its derivatives (N, orders, components) from coefficients (count, components)."""
        local = coefficients[self.interval[:, None] + np.arange(self.degree + 1)]
        return np.asarray(self.basis @ local, dtype=np.float64)

    def normal(self, by_path: Array, residual: Array, nuisance: Array) -> tuple[Array, Array]:
        """Return the normal equations of the coefficients: bands, and right-hand sides of residual and nuisance.

        Parameters
        ----------
        by_path : ndarray, shape (N, channels, orders, components)
            Weighted derivatives of the channels.
        residual : ndarray, shape (N, channels)
            Weighted.
        nuisance : ndarray, shape (N, channels, parameters)
            Weighted derivatives by what else is unknown.

        Returns
        -------
        band : ndarray, shape (bandwidth, unknowns)
            Lower bands, as `scipy.linalg.solveh_banded` takes them; coefficient after coefficient.
        right : ndarray, shape (unknowns, 1 + parameters)
            Products of the Jacobian with the residual and with the nuisance.
        """
        local = np.einsum("ncko,nkj->ncjo", by_path, self.basis).reshape(*residual.shape, -1)
        rows = np.concatenate([local, residual[:, :, None], nuisance], axis=2)
        # All instants of an interval act on the same coefficients: one product an interval.
        used, first, own = np.unique(self.interval, return_index=True, return_inverse=True)
        blocks = np.zeros((len(used), int(np.bincount(own).max()), *rows.shape[1:]))
        blocks[own, np.arange(len(rows)) - first[own]] = rows
        blocks = blocks.reshape(len(used), -1, rows.shape[2])
        size, unknowns = local.shape[2], self.count * self.components
        products = blocks[:, :, :size].transpose(0, 2, 1) @ blocks
        band, right = np.zeros((size, unknowns)), np.zeros((unknowns, rows.shape[2] - size))
        begin, (i, k) = used[:, None] * self.components, np.tril_indices(size)
        np.add.at(band, (np.broadcast_to(i - k, (len(used), len(i))), begin + k), products[:, i, k])
        np.add.at(right, begin + np.arange(size), products[:, :, size:])
        return band, right
