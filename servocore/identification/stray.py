"""How far the output goes off a job, by the covariance of the parameters and by what the model does not explain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from servocore.effects.closed_loop import run_loop
from servocore.effects.model_inversion import inverted
from servocore.effects.position_loops import PositionLoops
from servocore.model.scene import Scene
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.references.base import Reference

_SAMPLES = 2000
_QUANTILE = 0.95
_INSTANT, _FEWEST = 0.02, 500  # s between instants of a motion, and their least number
_SHARE = 0.3  # of a standard error: the change of a parameter by which the motion is differentiated
_SMALL = 1e-3  # or of the parameter, where that is less


class Stray(NamedTuple):
    """How far the output will go off a path in 95 of 100 cases, in mm (thousandths of its unit).

    Attributes
    ----------
    total : float
        With what the residuals of the inputs do beside.
    by_parameters : float
        By the uncertainty of the parameters alone.
    """

    total: float
    by_parameters: float


def strayed(
    scene: Scene,
    names: tuple[str, ...],
    covariance: Array,
    path: Reference,
    loops: PositionLoops,
    unexplained: tuple[Array, Array],
) -> Stray:
    """Return how far the output goes off a path under position loops and the feedforward of estimated parameters.

    S = d output / d theta by simulations of changed plants, then the quantile of max over t of |S zeta| for zeta of the
    normal distribution with the covariance.

    Parameters
    ----------
    scene : Scene
        With the estimates.
    names : tuple of str
        Of the parameters.
    covariance : ndarray, shape (parameters, parameters)
        Of the estimates.
    path : Reference
        The job.
    loops : PositionLoops
        Of the drives.
    unexplained : tuple of ndarray, shapes (N,) and (N, inputs)
        Times, and low-passed residuals of the inputs, which act on the plant as a disturbance.
    """
    measured = scene.effects.measured or tuple(quantity.name for quantity in scene.model().outputs)
    moved = scene.with_reference(path)
    count = max(_FEWEST, int(np.ceil(path.duration / _INSTANT))) + 1
    motion = inverted(Problem.of(moved), measured, count)
    gains, values = motion.gains(loops), scene.parameter_values()
    base, slopes = run_loop(motion, motion, gains).deviation, []
    for k, name in enumerate(names):
        change = min(_SHARE * float(np.sqrt(covariance[k, k])), _SMALL * abs(values[name]) or np.inf)
        plant = inverted(Problem.of(moved.with_parameters(**{name: values[name] + change})), measured, count)
        deviation = run_loop(plant, motion, gains).deviation
        at, own = np.linspace(0.0, 1.0, len(base)), np.linspace(0.0, 1.0, len(deviation))
        slopes.append((np.column_stack([np.interp(at, own, each) for each in deviation.T]) - base) / change)
    random = np.random.default_rng(0)
    drawn = random.multivariate_normal(np.zeros(len(names)), covariance, _SAMPLES, method="eigh")
    samples = np.tensordot(drawn, np.array(slopes), axes=1)
    by_parameters = float(np.quantile(np.linalg.norm(samples, axis=2).max(axis=1), _QUANTILE))
    t, residual = unexplained
    at = (motion.t - motion.t[0]) % np.ptp(t)
    disturbance = np.column_stack([np.interp(at, t - t[0], each) for each in residual.T])
    rest = run_loop(motion, motion, gains, disturbance).error
    return Stray(1e3 * (by_parameters + rest), 1e3 * by_parameters)  # both in one direction at worst
