"""Typical magnitudes of coordinates without a nominal value, derived from the extent of the path.

Newton's method stops where corrections are small relative to a typical magnitude, by default one unit. For a path of a
nanometre that would be far too coarse.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.numerics.components import filled, parts_of, singular_values
from servocore.numerics.memoization import made_once
from servocore.references.base import Reference

_FAR_LESS = 2e-3  # ratio to a nominal value, or one unit, within which that value is kept
_ROUND_OFF = 1e-9  # of the largest change of a unit: less counts as zero
_NOTHING = 1e-13  # of the largest change of all: round-off of a matrix that is inverted
_NEGLIGIBLE = 1e-9  # of the largest singular value: less is a dependent row
_SMALLEST = 1e-4  # of a coordinate itself: lower bound of its magnitude


def decades_of(path: Reference) -> tuple[float, ...]:
    """Return the extent of each component of a path as a decimal logarithm, rounded; -inf where it rests."""
    with np.errstate(divide="ignore"):
        return tuple(np.round(np.log10(path.extent)).tolist())


@made_once  # used by every solve, and compiled functions belong to the object
def scaled_to(system: MechanicalSystem, decades: tuple[float, ...]) -> MechanicalSystem:
    """Return the system with nominal values for an extent of the path; the same object if its own are suitable.

    The change of a coordinate is that of its guess, or follows from the outputs by the constraints at home; if both
    are zero, it is the largest one of its unit.
    """
    quantities = system.coordinates.quantities
    if len(decades) != len(system.outputs):
        return system
    home, _ = system.home_configuration()
    magnitudes = _changes(system, np.array([10.0**decade for decade in decades]))
    magnitudes[magnitudes <= _NOTHING * magnitudes.max(initial=0.0)] = 0.0
    for unit in {quantity.unit for quantity in quantities}:
        alike = [k for k, quantity in enumerate(quantities) if quantity.unit == unit]
        largest = magnitudes[alike].max()
        still = [k for k in alike if not magnitudes[k] > _ROUND_OFF * largest]
        magnitudes[still] = largest or 1.0
    derived = 10.0 ** np.round(np.log10(np.maximum(magnitudes, _SMALLEST * np.nan_to_num(np.abs(home)))))
    sizes = [_chosen(quantity, size) for quantity, size in zip(quantities, derived.tolist(), strict=True)]
    if sizes == list(system.coordinates.nominal):
        return system
    return replace(system, coordinates=system.coordinates.scaled(sizes))


def _chosen(quantity: Quantity, derived: float) -> float:
    """Return the given nominal value, or one unit, unless the derived one differs by orders of magnitude."""
    if derived < _FAR_LESS * quantity.magnitude or (quantity.nominal is None and derived * _FAR_LESS > 1.0):
        return derived
    return quantity.magnitude


def _changes(system: MechanicalSystem, extent: Array) -> Array:
    """Return the change of each coordinate when the outputs leave home by `extent`."""
    home, p = system.home_configuration()
    gamma = np.zeros((2, *system.gamma.shape))
    gamma[:, :, 0] = system.home
    gamma[:, : len(extent), 0] += np.outer((1.0, -1.0), extent)  # the time, if there is one, is constant
    evaluate = ca.Function("guess_and_rows", [system.gamma, system.q, system.p], [
        system.guess, ca.vertcat(system.G, system.C)])  # fmt: skip
    changes = [np.abs(np.asarray(evaluate(function, home, p)[0]).ravel() - home) for function in gamma]
    rows = filled(evaluate(gamma[0], home, p)[1])
    if np.isfinite(rows).all():
        changes.append(_followed(rows, np.concatenate([np.zeros(len(rows) - len(extent)), extent])))
    return np.asarray(np.nan_to_num(np.max(changes, axis=0), nan=0.0, posinf=0.0))


def _followed(rows: Array, extent: Array) -> Array:
    """Return the largest change of each coordinate when a single row changes by its `extent`.

    Independent parts are decomposed separately, with one threshold for negligible singular values.
    """
    places = (indices.tolist() for indices in np.nonzero(rows))
    largest, followed = float(singular_values(rows).max(initial=0.0)), np.zeros(rows.shape[1])
    for part in parts_of(ca.Sparsity.triplet(*rows.shape, *places)):
        if len(part.entries):
            matrix = rows[np.ix_(part.rows, part.columns)]
            left, values, right = np.linalg.svd(matrix, full_matrices=False)
            kept = values > _NEGLIGIBLE * largest
            inverse = right[kept].T / values[kept] @ left[:, kept].T
            followed[part.columns] = np.abs(inverse * extent[part.rows]).max(axis=1)
    return followed
