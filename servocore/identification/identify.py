"""`identify`: parameters of a scene from logs, with standard errors."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

import numpy as np

from servocore.effects.position_loops import PositionLoops
from servocore.errors import (
    InvalidModel,
    InvalidReference,
    InvalidSetting,
    ServocoreWarning,
    require_kind,
    require_positive,
)
from servocore.identification.fit import Converged, Fit, minimized
from servocore.identification.logs import Blocks, Log, Record, records, stretches
from servocore.identification.prediction import positions_of, prediction_of
from servocore.identification.result import Identified
from servocore.identification.splines import PathSpline
from servocore.model.scene import Scene, require_scene
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.references.base import Reference

UNCERTAINTY = 0.3
"""Relative standard uncertainty of a parameter of which none is given."""

_SPACINGS = (0.1, 0.05)  # s between knots: finer where positions show that the path bends faster
_BENT = 1.3  # times the noise of a position
_EXPLAINED = 0.3  # of the changes of an input: beyond, its unit or its clock is doubtful
_UNITS, _LAG, _ALIKE = 30.0, 0.05, 0.03  # factor, s, and s between the lags of inputs with one clock
_EVERY, _SMOOTH = 0.05, 6.0  # s between equilibria, and standard deviation of their low-pass in these
FORCE_NOISE = 1e-3
"""Noise of forces that are known to be zero, by the largest input."""

_NONE = 1e-9  # relative standard deviation of a bias that there is not
_ROUNDS, _AT_REST = 30, 1e-6  # of Newton's method, and its last step


def identify(
    scene: Scene,
    log: Log | Sequence[Log],
    parameters: str | Sequence[str],
    *,
    believed: Mapping[str, float] | float = UNCERTAINTY,
    bias: float = 1.0,
    jobs: Sequence[Reference] = (),
    loops: PositionLoops = PositionLoops(),  # noqa: B008 - a frozen value
) -> Identified:
    """Estimate parameters of a scene from logs of its inputs and measured positions, with standard errors.

    Maximum likelihood on the flat output: the path of the output is a spline, all channels follow from its jet by exact
    inversion, and path, parameters, biases of the inputs and their delays are estimated together. Values of the
    scene are one more measurement, with its uncertainty: parameters that the logs do not show keep them.

    Parameters
    ----------
    scene : Scene
        With the believed values of its parameters, and the effects of the model, see `Scene.with_effects`.
    log : path, mapping of arrays, or a sequence of these
        CSV files with the columns ``time``, the inputs and the measured quantities by name, units in brackets, or
        arrays by these names, NaN where a sample is missing. Beside the positions of drives the outputs may be
        measured, as by a camera. Several logs are one fit, with biases and delays for each.
    parameters : str or sequence of str
        Names or patterns, as ``"*_friction"``.
    believed : mapping of str to float, or float
        Relative standard uncertainties of the scene's values by names or patterns; 0.3 where none is given.
    bias : float
        Standard deviation of the bias of a measured input before anything is measured, relative to its peak; 0 for
        sensors without any, as where an offset is a parameter of the model.
    jobs : sequence of Reference
        Paths that the load shall follow: how far it will go off enters the verdict.
    loops : PositionLoops
        Position loops of the drives on these jobs.

    Returns
    -------
    Identified
        Values, standard errors, and how well the model explains the logs.

    Raises
    ------
    InvalidReference
        If a log cannot be used; one sentence says why.
    InvalidModel
        If the equations of the scene depend on time, or it has no such parameter.
    InvalidSetting
        If an uncertainty is invalid.

    Warns
    -----
    ServocoreWarning
        If the result is not to be trusted.

    Examples
    --------
    >>> import servocore as sc
    >>> crane = sc.scenes.overhead_crane()
    >>> heavy = crane.with_parameters(load_mass=110.0)
    >>> found = sc.identify(crane, sc.measured(crane, plant=heavy), ["load_mass"])
    >>> abs(found.values["load_mass"] - 110.0) < 4 * found.standard_errors["load_mass"]
    True
    """
    require_scene(scene, "identify")
    problem = Problem.of(scene)
    if problem.system.time.numel():
        raise InvalidModel(f"{scene.name}: its equations depend on time, so that a log would have to begin with them")
    require_positive(bias, "the bias of the inputs", "a fraction, such as 0.01", or_zero=True)
    require_kind(loops, PositionLoops, "loops", "PositionLoops", InvalidSetting)
    require_kind(jobs, Sequence, "jobs", "a list of paths", InvalidSetting)
    for job in jobs:
        require_kind(job, Reference, "a job", "a Reference", InvalidSetting)
    names = chosen_parameters(parameters, problem)
    read = records(log, scene, positions_of(problem.resolved))
    fit = _fit(problem, read, scene.effects.measured, names, spreads_of(names, believed), bias)
    found = minimized(fit, fit.start([_equilibria(fit, data) for data in fit.stretches]))
    # Where measured positions bend faster than the splines can, finer ones do. Exact logs, of nearly no noise, can lead
    # these astray.
    if not found.settled or any(float(each.scales[fit.inputs :].max()) > _BENT for each in found.weights):
        finer, state = fit.refined(found.state, _SPACINGS[1])
        again = minimized(finer, state, fresh=False)
        fit, found = (finer, again) if again.settled or not found.settled else (fit, found)
    _require_explained(fit, found, [record.name for record in read])
    result = Identified(names, tuple(record.name for record in read), loops, tuple(jobs), scene, fit, found)
    if result.doubts:
        warnings.warn("; ".join(result.doubts), ServocoreWarning, stacklevel=2)
    return result


def chosen_parameters(parameters: str | Sequence[str], problem: Problem) -> tuple[str, ...]:
    """Return the names of parameters that match patterns, in the order of the model."""
    known = problem.system.parameters.names
    require_kind(parameters, Sequence, "the parameters to be identified", "names or patterns", InvalidModel)
    patterns = [parameters] if isinstance(parameters, str) else list(parameters)
    for pattern in patterns:
        require_kind(pattern, str, "a parameter to be identified", "a name or a pattern", InvalidModel)
        if not any(fnmatchcase(name, pattern) for name in known):
            raise InvalidModel(f"no parameter is called {pattern}; there are {', '.join(known) or 'none'}")
    if not patterns:
        raise InvalidSetting(f"name at least one parameter to be identified, of {', '.join(known)}")
    return tuple(name for name in known if any(fnmatchcase(name, pattern) for pattern in patterns))


def spreads_of(names: tuple[str, ...], believed: Mapping[str, float] | float) -> Array:
    """Return the relative standard uncertainty of each parameter."""
    given = believed if isinstance(believed, Mapping) else {"*": believed}
    for pattern, value in given.items():
        of = "" if pattern == "*" else f" of {pattern}"
        require_positive(value, f"the uncertainty{of}", "a fraction, such as 0.2")
        if value > 1.0:
            raise InvalidSetting(f"the uncertainty{of} must be a share, 1 at most, not {value:g}: 0.2 is 20%")
        if not any(fnmatchcase(name, pattern) for name in names):
            raise InvalidSetting(f"the uncertainty of {pattern} is given, but that is not identified")
    own = ([value for pattern, value in given.items() if fnmatchcase(name, pattern)] for name in names)
    return np.array([float([*values, UNCERTAINTY][0]) for values in own])


def _fit(
    problem: Problem, read: Sequence[Record], drives: Sequence[str], names: tuple[str, ...], spreads: Array, bias: float
) -> Fit:
    """Return the maximum likelihood problem of logs; positions of drives come first, as their inputs do."""
    inputs = [quantity.name for quantity in problem.system.inputs]
    measured = sorted((each for each in read[0].columns if each not in inputs), key=[*drives, *read[0].columns].index)
    for record in read[1:]:
        if {*record.columns} != {*read[0].columns}:
            raise InvalidReference(f"{record.name} has other columns than {read[0].name}: one fit needs the same")
    prediction, scales = prediction_of(problem, names, measured)
    forces = [each.name for each in prediction.quantities[len(inputs) : -len(measured)]]
    peaks = np.max([[np.nanmax(np.abs(record.columns[label])) for label in inputs] for record in read], axis=0)
    parts = list[Blocks]()
    for k, record in enumerate(read):
        known = {**record.columns, **dict.fromkeys(forces, np.zeros(len(record.t)))}
        values = np.column_stack([known[each] for each in (*inputs, *forces, *measured)])
        parts += stretches(record.t, values, len(inputs) + len(forces), k)
    for part in parts:
        part.noise[:, len(inputs) : -len(measured)] = FORCE_NOISE * peaks.max()
    if {part.log for part in parts} != set(range(len(read))):
        raise InvalidReference("a log has so many gaps that no second of it is left")
    resolved, center = prediction.resolved, problem.p[list(prediction.columns)]
    order, outputs = resolved.array.reference_order, len(resolved.system.outputs)
    splines = tuple(PathSpline(part.t, order + 2, order + 1, outputs, _SPACINGS[0]) for part in parts)
    spread = np.where(center != 0.0, spreads * scales, 1e6)  # relative to zero nothing is known
    biases = [*(max(bias, _NONE) * np.maximum(peaks, _NONE)), *(_NONE * peaks.max() for _ in forces)]
    return Fit(prediction, problem.p, center, scales, spread, np.array(biases), tuple(parts), splines)


def _require_explained(fit: Fit, found: Converged, names: Sequence[str]) -> None:
    """Raise `InvalidReference` where inputs are hardly explained because of units or clocks."""
    for k, data in enumerate(fit.stretches):
        model, name = fit.prediction.values(fit.splines[k].jets(found.state.paths[k]), fit.p), names[data.log]
        residual, _ = fit.residuals(found.state, k)
        lags, wrong, explained = list[float](), list[str](), True
        for channel, quantity in enumerate(fit.prediction.quantities[: fit.prediction.inputs]):
            a, b = (each - each.mean() for each in (data.values[:, channel], model[:, channel]))
            noisy = a.std() < 5.0 * float(np.median(data.noise[:, channel]))
            if noisy or not np.isfinite(b).all():
                continue
            explained &= bool(residual[:, channel].std() < _EXPLAINED * a.std())
            if not 1 / _UNITS < a.std() / (b.std() or np.inf) < _UNITS:
                wrong.append(f"{quantity.name} changes by {np.ptp(a):.3g} {quantity.unit}")
            products = np.correlate(a, b, "full")
            lags.append((int(products.argmax()) - len(b) + 1) * float(np.median(np.diff(data.t))))
        if explained:
            continue
        if wrong:
            raise InvalidReference(f"{name}: {wrong[0]}, far from what the model needs: is its unit right?")
        # A clock is late for all inputs alike; an effect that the model lacks delays each in its own way.
        if min(map(abs, lags)) > _LAG and float(np.ptp(lags)) < _ALIKE:
            raise InvalidReference(
                f"{name}: the inputs are {1e3 * np.mean(lags):.0f} ms behind the positions: their clocks are not"
                " synchronized"
            )


def _equilibria(fit: Fit, data: Blocks) -> Array:
    """Return low-passed outputs (N, outputs) at which the model would rest with the positions that were measured."""
    from scipy.ndimage import gaussian_filter1d  # noqa: PLC0415 - kept out of the run time of an FMU

    m, prediction, system = fit.prediction.inputs, fit.prediction, fit.prediction.resolved.system
    every = max(1, round(_EVERY / float(np.median(np.diff(data.t)))))
    rows = data.values[::every, m:]
    jets = np.zeros((len(rows), fit.splines[0].orders, len(system.outputs)))
    jets[:, 0] = system.home
    for _ in range(_ROUNDS):
        predicted = prediction(jets, fit.p)
        if not np.isfinite(predicted.by_path).all():
            raise InvalidReference(f"{system.name} cannot rest at the positions of the log: are its units right?")
        lacking = prediction.wrapped(rows - predicted.values[:, m:], m)
        change = (np.linalg.pinv(predicted.by_path[:, m:, 0]) @ lacking[:, :, None])[:, :, 0]
        jets[:, 0] += change / np.maximum(np.abs(change).max(axis=1, keepdims=True), 1.0)
        if np.abs(change).max() < _AT_REST:
            break
    smooth = gaussian_filter1d(jets[:, 0], _SMOOTH, axis=0, mode="nearest")
    return np.column_stack([np.interp(data.t, data.t[::every], column) for column in smooth.T])
