"""Typical magnitudes of coordinates that have no nominal value, derived from how far a path goes.

Newton's method stops where corrections are small beside a typical magnitude, which is one unit unless somebody says
otherwise. For a path of a nanometre that is no accuracy at all.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.numerics.components import of_one_shape, parts_of
from servocore.numerics.memoization import made_once
from servocore.references.base import Reference

_FAR_LESS = 2e-3  # than a nominal value, or one unit: within that range it is good enough
_ROUND_OFF = 1e-9  # of the largest change of a unit: less is none
_NOTHING = 1e-13  # of the largest change of all: round-off of a matrix that is inverted
_NEGLIGIBLE = 1e-9  # of the largest singular value: less is a row that follows from others
_SMALLEST = 1e-4  # of a coordinate itself: changes below it do not show in its magnitude


def decades_of(path: Reference) -> tuple[float, ...]:
    """Return the common logarithm of how far each component of a path goes, in whole decades; -inf where it rests."""
    with np.errstate(divide="ignore"):
        return tuple(np.round(np.log10(path.extent)).tolist())


@made_once  # every solve asks, and what was compiled for a system is kept with the object
def scaled_to(system: MechanicalSystem, decades: tuple[float, ...]) -> MechanicalSystem:
    """Return the system with nominal values for an extent of the path; the same object where its own serve.

    A coordinate changes as its guess does, or as the constraints at home make it follow the outputs; one that neither
    moves is as large as others of its unit.
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
    """Return what counts: a nominal value that is given, or one unit, unless the path says something else."""
    if derived < _FAR_LESS * quantity.magnitude or (quantity.nominal is None and derived * _FAR_LESS > 1.0):
        return derived
    return quantity.magnitude


def _changes(system: MechanicalSystem, extent: Array) -> Array:
    """Return how far each coordinate goes when the outputs leave home by `extent`."""
    home, p = system.home_configuration()
    gamma = np.zeros((2, *system.gamma.shape))
    gamma[:, :, 0] = system.home
    gamma[:, : len(extent), 0] += np.outer((1.0, -1.0), extent)  # the time, if there is one, stands still
    evaluate = ca.Function("guess_and_rows", [system.gamma, system.q, system.p], [
        system.guess, ca.densify(ca.vertcat(system.G, system.C))])  # fmt: skip
    changes = [np.abs(np.asarray(evaluate(function, home, p)[0]).ravel() - home) for function in gamma]
    rows = np.asarray(evaluate(gamma[0], home, p)[1])
    if np.isfinite(rows).all():
        changes.append(_followed(rows, np.concatenate([np.zeros(len(rows) - len(extent)), extent])))
    largest: Array = np.nan_to_num(np.max(changes, axis=0), nan=0.0, posinf=0.0)
    return largest


def _followed(rows: Array, extent: Array) -> Array:
    """Return how far each coordinate goes at most when one of the rows goes as far as its `extent`, none but it.

    Independent parts of the rows are taken each by itself, what is negligible in all of them together is zero.
    """
    places = (indices.tolist() for indices in np.nonzero(rows))
    groups = of_one_shape([part for part in parts_of(ca.Sparsity.triplet(*rows.shape, *places)) if len(part.entries)])
    decomposed = [
        np.linalg.svd(np.stack([rows[np.ix_(part.rows, part.columns)] for part in same]), full_matrices=False)
        for same in groups
    ]
    largest = max((values.max() for _, values, _ in decomposed), default=0.0)
    followed = np.zeros(rows.shape[1])
    for same, (left, values, right) in zip(groups, decomposed, strict=True):
        inverse = np.divide(1.0, values, out=np.zeros_like(values), where=values > _NEGLIGIBLE * largest)
        pseudoinverse = right.swapaxes(1, 2) @ (inverse[:, :, None] * left.swapaxes(1, 2))
        for part, matrix in zip(same, pseudoinverse, strict=True):
            followed[part.columns] = np.abs(matrix * extent[part.rows]).max(axis=1)
    return followed
