"""`measured`: synthetic logs of a plant under sampled drives, for tests and examples."""

from __future__ import annotations

import casadi as ca
import numpy as np

from servocore.effects.model_inversion import at_rest, inverted
from servocore.effects.position_loops import PositionLoops, held, measured_in, wrapped
from servocore.errors import IntegrationFailed, InvalidSetting, require_positive
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene, require_scene
from servocore.numerics.compiled_calls import Array, chained, repeated
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.stepping.forward_dynamics import forward_rate, runge_kutta

_CYCLE = 1e-3  # s: of the drives
_FILTER = 0.3  # of the difference of two positions, a cycle: low-pass of the rate, some 50 Hz
_HELD = 0.01  # of the unit of a position: the input that the loop adds for it is within the range of its sensor


def measured(
    scene: Scene,
    *,
    plant: Scene | None = None,
    loops: PositionLoops = PositionLoops(),  # noqa: B008 - a frozen value
    drives: tuple[str, ...] = (),
    step: float = 0.002,
    resolution: float = 1e-5,
    noise: float = 0.005,
    bias: float = 0.01,
    delay: float = 0.0,
    outliers: float = 0.0,
    missing: float = 0.0,
    seed: int = 0,
) -> dict[str, Array]:
    """Simulate a plant under sampled position loops along the path of a scene, and return the log: synthetic data.

    The drives run at 1 kHz on the quantized encoders, with the exact inputs of the scene as feedforward. Sensors then
    add their errors: a normally distributed noise and a constant bias of every input, quantization of every position.

    Parameters
    ----------
    scene : Scene
        Gives the path, and by its parameters the feedforward. Without internal dynamics.
    plant : Scene, optional
        The plant, with its own parameters and effects; the scene itself when not given.
    loops : PositionLoops
        Bandwidth and damping of the drives.
    drives : tuple of str, optional
        Quantities that the drives measure, one an input; those of the scene's effects when not given.
    step : float
        Between samples, in s; a multiple of 1 ms.
    resolution : float
        Of the encoders, in the unit of each.
    noise, bias : float
        Standard deviation and largest bias of the measured inputs, relative to half the range of each input.
    delay : float
        Of the measured inputs behind the positions, in s.
    outliers, missing : float
        Fraction of samples of each column that are replaced by outliers, and of rows without a value.
    seed : int
        Of the random numbers.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        ``time``, the inputs and the measured positions by name; NaN where a value is missing.

    Raises
    ------
    InvalidSetting
        If a setting is negative or not finite, or the step is no multiple of 1 ms.
    IntegrationFailed
        If the plant does not survive its drives.
    """
    require_scene(scene, "measured")
    require_scene(plant := plant or scene, "measured")
    sensors = {"step": step, "resolution": resolution, "noise": noise, "bias": bias, "delay": delay}
    for name, value in {**sensors, "outliers": outliers, "missing": missing}.items():
        require_positive(value, f"the {name} of a synthetic log", "a number", or_zero=True)
    each = round(step / _CYCLE)
    if each < 1 or abs(each * _CYCLE - step) > 1e-9:
        raise InvalidSetting(f"a synthetic log needs a step of whole milliseconds, not {step:g} s")
    t, inputs, positions, quantities, stiffness = _driven(scene, plant, loops, drives, resolution)
    random = np.random.default_rng(seed)
    at = np.arange(0, len(t), each)
    columns = {"time": t[at]}
    for quantity, u, stiff in zip(plant.model().inputs, inputs.T, stiffness, strict=True):
        size = max(float(np.ptp(u)) / 2, _HELD * stiff)  # the sensor of a drive that rests is noisy too
        late = np.interp(t[at] - delay, t, u)
        columns[quantity.name] = late + size * (bias * random.uniform(-1, 1) + noise * random.standard_normal(len(at)))
    for quantity, y in zip(quantities, positions.T, strict=True):
        seen = np.unwrap(y[at]) if quantity.wraps else y[at]
        columns[quantity.name] = np.round(seen / resolution) * resolution if resolution else seen.copy()
    for column in list(columns.values())[1:]:
        _spoil(column, outliers, missing, random)
    return columns


def _spoil(column: Array, outliers: float, missing: float, random: np.random.Generator) -> None:
    """Replace some values of a column by outliers, and others by NaN."""
    wrong = random.random(len(column)) < outliers
    size = float(column.std()) or 1.0
    column[wrong] += size * random.choice([-1.0, 1.0], wrong.sum()) * random.uniform(0.5, 3.0, wrong.sum())
    column[random.random(len(column)) < missing] = np.nan


def _driven(
    scene: Scene, plant: Scene, loops: PositionLoops, drives: tuple[str, ...], resolution: float
) -> tuple[Array, Array, Array, tuple[Quantity, ...], Array]:
    """Return times, inputs (N, m), positions (N, m) at the cycles of the drives; measured quantities, stiffness."""
    problem, moved = Problem.of(scene), Problem.of(plant.with_reference(scene.reference))
    of_plant = drives or plant.effects.measured
    count = int(np.ceil(problem.reference.duration / _CYCLE)) + 1
    motion, still = inverted(problem, drives or scene.effects.measured, count), at_rest(moved, of_plant)
    gains, cycle = motion.gains(loops), _cycle(moved.resolved, of_plant)
    quantities, y = measured_in(moved.system, of_plant)
    zero = np.asarray(ca.Function("y", [moved.system.q], [y])(still.start[: len(still.end)])).ravel()
    signals, m = motion.signals, len(zero)
    signals[:, m : 2 * m] += zero
    given = (repeated(argument, count) for argument in (moved.p, gains.ravel(), np.array([max(resolution, 1e-12)])))
    rows = chained(cycle, count)(np.concatenate([still.start, zero]), signals.T, *given)[1].T
    if not np.isfinite(rows).all():
        raise IntegrationFailed(f"{moved.system.name}: the plant does not survive its drives along this path")
    return np.arange(count) / round(1 / _CYCLE), rows[:, :m], rows[:, m:], quantities, gains[0]


@made_once
def _cycle(resolved: ResolvedSystem, drives: tuple[str, ...]) -> ca.Function:
    """Compile one cycle of the drives.

    (state and low-passed positions, (inputs, positions, rates) that are wanted, p, gains, resolution) -> the same after
    the cycle, inputs and positions at its begin. The inputs stay for a cycle: two steps of the classical method.
    """
    system = resolved.system
    quantities, y = measured_in(system, drives)
    m, n = len(system.inputs), 2 * len(system.coordinates)
    read = ca.Function("sc_positions", [ca.vertcat(system.q, system.v)], [ca.densify(y)])
    rate = forward_rate(system, held=False)
    state, wanted, p = ca.MX.sym("x", n + m), ca.MX.sym("w", 3 * m), ca.MX.sym("p", system.p.numel())
    gains, quantum = ca.MX.sym("k", 2 * m), ca.MX.sym("quantum")
    position, slow, after = read(state[:n]), state[n:], state[:n]
    seen = quantum * ca.floor(position / quantum + 0.5)
    passed = _FILTER * wrapped(quantities, seen - slow)
    u = held(quantities, wanted, seen, passed / _CYCLE, gains)
    for _ in range(2):
        after = runge_kutta(lambda at, _: rate(at, u, ca.DM.zeros(m), p)[0], after, ca.MX(_CYCLE / 2))
    results = [ca.vertcat(after, slow + passed), ca.vertcat(u, position)]
    return ca.Function("sc_cycle", [state, wanted, p, gains, quantum], results)
