"""Information that a motion of the output holds on parameters, and how unknown combinations would show."""

from __future__ import annotations

import numpy as np

from servocore.identification.fit import DELAY
from servocore.identification.prediction import Prediction
from servocore.numerics.compiled_calls import Array

_SHOWS = 0.25  # of its uncertainty is left of a combination that a motion shows
_AMPLITUDE, _PERIODS = 0.5, (4.0, 2.9, 2.3)  # of the motions that are tried, in the unit of the output and s
_TRIED = np.linspace(0.0, 20.0, 201)


def information(prediction: Prediction, jets: Array, step: float, p: Array, scales: Array, noise: Array) -> Array:
    """Return the information of the inputs on parameters, relative to their scales, shape (parameters, parameters).

    The motion counts as known, as fine encoders show it; biases of inputs are free, and their delays nearly so.

    Parameters
    ----------
    prediction : Prediction
        Of the channels.
    jets : ndarray, shape (N, orders, outputs)
        The motion, at instants `step` seconds apart.
    p : ndarray
        All parameters.
    scales : ndarray, shape (parameters,)
        Units of the estimates.
    noise : ndarray, shape (inputs,)
        Standard deviation of an input at one instant.
    """
    m = len(noise)
    predicted = prediction(jets, p)
    rows = predicted.by_parameter[:, :m] * scales / noise[:, None]
    rates = np.gradient(predicted.values[:, :m], step, axis=0) / noise
    total = np.zeros((len(scales), len(scales)))
    for k in range(m):
        nuisance = np.column_stack([np.full(len(jets), 1.0 / noise[k]), rates[:, k]])
        inner = nuisance.T @ nuisance + np.diag([0.0, 1.0 / DELAY**2])
        mixed = nuisance.T @ rows[:, k]
        total += rows[:, k].T @ rows[:, k] - mixed.T @ np.linalg.solve(inner, mixed)
    return total


def showing(
    prediction: Prediction, place: Array, p: Array, scales: Array, noise: Array, direction: Array, spread: float
) -> str:
    """Return the smallest motion about a place that shows a combination of parameters; empty if none was found.

    Parameters
    ----------
    prediction, p, scales, noise
        See `information`.
    place : ndarray, shape (outputs,)
        A position of the output.
    direction : ndarray, shape (parameters,)
        The combination, of length one in `scales`.
    spread : float
        Its standard deviation.
    """
    names = [quantity.name for quantity in prediction.resolved.system.outputs]
    step = float(_TRIED[1] - _TRIED[0])
    orders = prediction.resolved.array.reference_order + 1
    for moving in [*([k] for k in range(len(names))), list(range(len(names)))]:
        jets = np.zeros((len(_TRIED), orders, len(names)))
        jets[:, 0] = place
        for k in moving:
            rate = 2 * np.pi / _PERIODS[k % len(_PERIODS)]
            for order in range(orders):
                jets[:, order, k] += _AMPLITUDE * rate**order * np.sin(rate * _TRIED + np.pi / 2 * order)
        found = information(prediction, jets, step, p, scales, noise)
        if np.isfinite(found).all() and 1.0 / np.sqrt(1.0 + spread**2 * direction @ found @ direction) < _SHOWS:
            return f"moving {' and '.join(names[k] for k in moving)} to and fro by {_AMPLITUDE:g} would show it"
    return ""
