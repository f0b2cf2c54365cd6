"""Other methods on the same logs of rotary cranes: least squares on the inverse dynamics, pySINDy, output error.

They need the equations written out, and the swing of the load by hand: it is integrated along the smoothed motion of
the drives, free of parameters. `identify` needs neither.
"""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np
import numpy.typing as npt
import scipy.optimize
from scipy.signal import butter, sosfiltfilt

import servocore as sc
from benchmarks.identification.cranes import crane, multisine, sensors
from servocore.effects.model_inversion import inverted
from servocore.effects.position_loops import measured_in
from servocore.stepping.forward_dynamics import forward_rate

Array = npt.NDArray[np.float64]
NAMES = (
    "bridge_inertia", "trolley_mass", "load_mass", "winch_inertia", "bridge_friction", "trolley_friction",
    "winch_friction", "viscous_share",
)  # fmt: skip
_STEP = 0.005  # s
_MOTION, _TORQUE, _EVERY = 6.0, 2.0, 20  # Hz of low-pass filters of motion and of all, and samples of a row
_ITERATIONS, _CHANGE = 3, 1e-3
_SLIDING = 0.99  # of dry friction: rows of drives that creep are left out
_LOGS = 8
Estimate = Callable[[Mapping[str, Array], sc.Scene], list[float]]


def table(folder: Path) -> str:
    """Return the table of other methods; results are kept in a file of the folder."""
    file = folder / "peers.json"
    results = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    for name, method in METHODS.items():
        if name not in results:
            results[name] = _rms(method)
            file.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    lines = [
        "\n## Other methods\n",
        f"The same {_LOGS} good logs of rotary cranes, rms error in %; *s* is processor time a log, median. Output"
        " error starts at the answer of least squares and takes torques for exact inputs.\n",
        f"| method | {' | '.join(NAMES)} | s |",
        "|---|" + "---|" * (len(NAMES) + 1),
    ]
    for name, found in results.items():
        cells = [f"{each:.2g}" for each in found["rms"]] or ["not installed", *[""] * (len(NAMES) - 1)]
        lines.append(f"| {name} | {' | '.join(cells)} | {found['seconds']:.2g} |")
    return "\n".join(lines) + "\n"


def _rms(method: Estimate) -> dict[str, object]:
    errors, seconds = list[Array](), list[float]()
    for seed in range(_LOGS):
        random = np.random.default_rng(seed)
        plant, believed = crane("rotary_crane", random)
        moved = believed.with_reference(multisine(believed, random))
        log = sc.measured(moved, plant=plant, seed=seed, **sensors("A", random) | {"step": _STEP})
        true, began = plant.parameter_values(), time.process_time()
        try:
            found = method(log, moved)
        except ImportError:
            return {"rms": [], "seconds": np.nan}
        seconds.append(time.process_time() - began)
        errors.append(np.array(found) / [true[name] for name in NAMES] - 1.0)
    rms = 100 * np.sqrt(np.mean(np.square(errors), axis=0))
    return {"rms": rms.tolist(), "seconds": float(np.median(seconds))}


def maximum_likelihood(log: Mapping[str, Array], scene: sc.Scene) -> list[float]:
    """Return the estimates of `identify`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = sc.identify(scene, log, NAMES)
    return [found.values[name] for name in NAMES]


def least_squares(log: Mapping[str, Array], scene: sc.Scene) -> list[float]:
    """Return estimates by weighted least squares on low-passed inverse dynamics, with biases and delays (IDIM-LS)."""
    torques = np.column_stack([log[name] for name in ("M_b", "F", "M_w")])
    rows, right = list[Array](), list[Array]()
    smooth = _low_pass(torques, _TORQUE)
    for k, features in enumerate(_regressors(log, scene)):
        known = np.zeros((len(smooth), len(_COLUMNS) + 6))
        known[:, : len(_COLUMNS)] = _low_pass(features, _TORQUE)
        known[:, len(_COLUMNS) + k] = 1.0
        known[:, len(_COLUMNS) + 3 + k] = -np.gradient(smooth[:, k], _STEP)
        dry = np.abs(features[:, 4 + k]) / np.abs(features[:, 4 + k]).max()
        counted = np.flatnonzero(dry > _SLIDING)
        counted = counted[(counted % _EVERY == 0) & (counted >= _EVERY) & (counted < len(known) - _EVERY)]
        rows.append(known[counted])
        right.append(smooth[counted, k])
    weights = np.ones(3)
    for _ in range(3):
        matrix = np.concatenate([w * row for w, row in zip(weights, rows, strict=True)])
        theta = np.linalg.lstsq(matrix, np.concatenate([w * u for w, u in zip(weights, right, strict=True)]))[0]
        weights = np.array([1.0 / np.std(u - row @ theta) for row, u in zip(rows, right, strict=True)])
    return _physical(theta[: len(_COLUMNS)])


def sparse_regression(log: Mapping[str, Array], scene: sc.Scene) -> list[float]:
    """Return estimates of pySINDy from each torque alone."""
    import pysindy  # noqa: PLC0415 - of the peers' environment

    theta = np.zeros(len(_COLUMNS))
    for name, features in zip(("M_b", "F", "M_w"), _regressors(log, scene), strict=True):
        own = np.flatnonzero(np.abs(features).max(axis=0))
        matrix = np.column_stack([features[:, own], np.ones(len(features))])
        optimizer = pysindy.STLSQ(threshold=0.0, alpha=0.0)
        model = pysindy.SINDy(optimizer=optimizer, feature_library=pysindy.IdentityLibrary())
        model.fit(matrix, t=_STEP, x_dot=log[name][:, None])
        theta[own] = np.asarray(model.coefficients())[0, :-1]
    return _physical(theta)


def output_error(log: Mapping[str, Array], scene: sc.Scene) -> list[float]:
    """Return estimates that let simulated positions fit the measured ones, torques being inputs of the plant."""
    begin = np.array([*least_squares(log, scene), 0.0, 0.0, 0.0])
    units = np.array([*begin[:-3], *(np.ptp(log[name]) / 2 for name in ("M_b", "F", "M_w"))])
    simulate = _simulation(log, scene)

    def residual(x: Array) -> Array:
        return simulate(x * units)

    found = scipy.optimize.least_squares(residual, begin / units, diff_step=[_CHANGE], max_nfev=_ITERATIONS + 1)
    return [float(value) for value in (found.x * units)[:-3]]


_COLUMNS = ("J_b", "m_t", "m", "J_w", "c_phi", "c_s", "c_l", "d_phi", "d_s", "d_l")


def _physical(theta: Array) -> list[float]:
    """Return parameters with one viscous share for all drives."""
    dry, viscous = theta[4:7], theta[7:10]
    return [*theta[:7].tolist(), float(dry @ viscous / (dry @ dry))]


def _low_pass(columns: Array, frequency: float) -> Array:
    filtered: Array = sosfiltfilt(butter(4, frequency, fs=1 / _STEP, output="sos"), columns, axis=0)
    return filtered


def _regressors(log: Mapping[str, Array], scene: sc.Scene) -> tuple[Array, Array, Array]:
    """Return the factors of `_COLUMNS` in bridge torque, trolley force and winch torque (docs/theory.md)."""
    p, jets = scene.parameter_values(), [_low_pass(np.column_stack([log[name] for name in ("phi", "s", "l")]), _MOTION)]
    for _ in range(2):
        jets.append(np.gradient(jets[-1], _STEP, axis=0))
    (phi, s, _), (phi1, s1, l1), (phi2, s2, l2) = (each.T for each in jets)
    along, across = np.array([np.cos(phi), np.sin(phi)]), np.array([-np.sin(phi), np.cos(phi)])
    trolley = (s2 - s * phi1**2) * along + (2 * s1 * phi1 + s * phi2) * across
    pull = _pull(np.column_stack([*trolley, 0 * s]), jets[0][:, 2], l1, l2, p["gravity"])
    dry, radius = np.tanh(jets[1] / p["creep"]).T, p["winch_radius"]
    bridge, carriage, winch = (np.zeros((len(s), len(_COLUMNS))) for _ in range(3))
    bridge[:, [0, 1, 2, 4, 7]] = np.column_stack(
        [phi2, s**2 * phi2 + 2 * s * s1 * phi1, s * np.sum(across * pull.T[:2], axis=0), dry[0], phi1]
    )
    carriage[:, [1, 2, 5, 8]] = np.column_stack([s2 - s * phi1**2, np.sum(along * pull.T[:2], axis=0), dry[1], s1])
    winch[:, [2, 3, 6, 9]] = np.column_stack(
        [-radius * np.linalg.norm(pull, axis=1), l2 / radius, radius * dry[2], radius * l1]
    )
    return bridge, carriage, winch


def _pull(trolley: Array, rope: Array, rate: Array, faster: Array, gravity: float) -> Array:
    """Return the force of the rope on the load by its mass (N, 3), by integration of the swing from rest.

    d is the load seen from the trolley: |d| = l twice differentiated gives the force along d.
    """
    weight = np.array([0.0, 0.0, gravity])
    known = np.column_stack([trolley + weight, rope, rate, faster])

    def pull(at: Array, d: Array, v: Array) -> Array:
        size = (-d @ at[:3] + v @ v - at[3] * at[5] - at[4] ** 2) / at[3] ** 2
        return np.asarray(-size * d, dtype=np.float64)

    d, v, found = np.array([0.0, 0.0, -rope[0]]), np.zeros(3), list[Array]()
    for at, after in pairwise(known):
        found.append(pull(at, d, v))
        middle, first = (at + after) / 2, found[-1] - at[:3]
        second = pull(middle, d + _STEP / 2 * v, v + _STEP / 2 * first) - middle[:3]
        third = pull(middle, d + _STEP / 2 * v + _STEP**2 / 4 * first, v + _STEP / 2 * second) - middle[:3]
        last = pull(after, d + _STEP * v + _STEP**2 / 2 * second, v + _STEP * third) - after[:3]
        d = d + _STEP * v + _STEP**2 / 6 * (first + second + third)
        v = v + _STEP / 6 * (first + 2 * second + 2 * third + last)
        d *= after[3] / np.linalg.norm(d)
    return np.array([*found, pull(known[-1], d, v)])


def _simulation(log: Mapping[str, Array], scene: sc.Scene) -> Callable[[Array], Array]:
    """Return the function from parameters and biases to simulated less measured positions."""
    system = scene.model()
    rate, n = forward_rate(system, held=False), len(system.coordinates)
    x, torque, p = ca.MX.sym("x", 2 * n), ca.MX.sym("u", 3, 2), ca.MX.sym("p", system.p.numel())
    none, middle = ca.DM.zeros(3), ca.sum2(torque) / 2
    first = rate(x, torque[:, 0], none, p)[0]
    second = rate(x + _STEP / 2 * first, middle, none, p)[0]
    third = rate(x + _STEP / 2 * second, middle, none, p)[0]
    last = rate(x + _STEP * third, torque[:, 1], none, p)[0]
    step = ca.Function("step", [x, torque, p], [x + _STEP / 6 * (first + 2 * second + 2 * third + last)])
    torques = np.array([log[name] for name in ("M_b", "F", "M_w")])
    run = step.mapaccum("run", torques.shape[1] - 1)
    _, y = measured_in(system, scene.effects.measured)
    read = ca.Function("read", [system.q], [y]).map(torques.shape[1] - 1)
    start = np.concatenate([inverted(sc.Problem.of(scene), scene.effects.measured, 500).start])
    seen = np.array([log[name] for name in scene.effects.measured])[:, 1:]
    columns, p0 = [system.parameters.names.index(name) for name in NAMES], sc.Problem.of(scene).p

    def residual(values: Array) -> Array:
        p_ = p0.copy()
        p_[columns] = values[: len(columns)]
        u = torques - values[len(columns) :, None]
        pairs = np.stack([u[:, :-1], u[:, 1:]], axis=2).reshape(3, -1)
        states = run(start, pairs, np.tile(p_[:, None], torques.shape[1] - 1))
        return np.asarray(read(states[:n, :]) - seen)[:, ::10].ravel()

    return residual


METHODS: dict[str, Estimate] = {
    "`identify`": maximum_likelihood,
    "IDIM-LS, by hand": least_squares,
    "pySINDy, features and swing by hand, each torque alone": sparse_regression,
    "output error, whole log, torques as inputs": output_error,
}
