"""Residual sway and settling time of the laboratory crane under four ways of driving it, in simulation; a table.

.venv/bin/python -m benchmarks.inteco        (half a minute)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

import servocore as sc
from servocore.numerics.compiled_calls import Array

DRIVES, LOG_PATH = ("s_x", "s_y", "l"), [
    (0.1, 0.1, -0.6), (0.4, 0.5, -0.35), (0.15, 0.3, -0.8), (0.42, 0.12, -0.4), (0.1, 0.1, -0.6),
]  # fmt: skip
OTHER = {"dry": 1.2, "viscous": 1.15}  # friction of the plant by that of the model
GAIN = 50.0  # of the position loops, duty per metre
LOG_TIMES = [0.0, 3.0, 6.0, 9.0, 12.0]
CYCLE, AFTER, SETTLED = 0.001, 5.0, 0.005  # s, s, m
Law = Callable[[float, Array], Array]


@dataclass(frozen=True)
class Result:
    """Largest distance of the payload from its target after the motion (m), its sway (rad), settling time (s)."""

    stray: float
    sway: float
    settling: float

    def __str__(self) -> str:
        settled = f"{self.settling:.2f} s" if self.settling < AFTER - 2 * CYCLE else f"more than {AFTER:g} s"
        return f"{1e3 * self.stray:.2g} mm | {np.degrees(self.sway):.2g} | {settled}"


def real(scene: sc.Scene) -> sc.Scene:
    """Return the plant: with more friction than the model believes."""
    values = scene.parameter_values()
    factors = {name: OTHER.get(name.split("_")[0], 1.0) for name in values}
    return scene.with_parameters(**{name: values[name] * factors[name] for name in values if factors[name] != 1.0})


def driven(plant: sc.Scene, law: Law) -> Result:
    """Simulate a plant under duty cycles that a law computes each millisecond from the measured positions."""
    system, duration = plant.model(), plant.reference.duration
    machine, p = sc.compile_plant(system), system.parameters.values(plant.parameters)
    still = sc.solve(plant, step=duration / 10)
    names = system.coordinates.names
    state = np.array([*(still[name][0] for name in names), *[0.0] * len(names)])
    places = [names.index(name) for name in (*DRIVES, "x", "y", "z")]
    rows, none = [], np.zeros(3)
    for k in range(round((duration + AFTER) / CYCLE)):
        rows.append(state[places])
        duty = np.clip(law(k * CYCLE, state[places[:3]]), -1.0, 1.0)
        state = machine.advance(state, duty, none, none, p, CYCLE)
    t, motion = CYCLE * np.arange(len(rows)), np.array(rows)
    target = plant.reference.jet(plant.reference.end_time, 0)[0]
    away = np.linalg.norm(motion[:, 3:] - target, axis=1)
    level = np.hypot(motion[:, 3] - motion[:, 0], motion[:, 4] - motion[:, 1])
    sway, later, late = np.arctan2(level, -motion[:, 5]), t >= duration, np.flatnonzero(away > SETTLED)
    return Result(float(away[later].max()), float(sway[later].max()), float(max(0.0, t[late[-1]] - duration)))


def laws(scene: sc.Scene) -> dict[str, Law]:
    """Return the usual ramp of positions, feedforward of a model, and that with position loops."""
    solution, duration = sc.solve(scene, step=0.005), scene.reference.duration
    inputs, places = ([solution[name] for name in names] for names in (("u_x", "u_y", "u_l"), DRIVES))
    forward, follow = (CubicSpline(solution.t, np.column_stack(each)) for each in (inputs, places))
    first, last, hold = follow(0.0), follow(duration), forward(duration)

    def ramp(t: float, measured: Array) -> Array:
        part = np.clip(t / duration, 0.0, 1.0)
        share = 0.2  # of the duration to accelerate, and to brake
        moved = min(part, share) ** 2 / (2 * share) + max(0.0, min(part, 1 - share) - share)
        moved += (share**2 - (1 - max(part, 1 - share)) ** 2) / (2 * share)
        wanted = first + (last - first) * moved / (1 - share)
        return np.asarray(hold + GAIN * (wanted - measured))

    def alone(t: float, _: Array) -> Array:
        return np.asarray(forward(min(t, duration)))

    def together(t: float, measured: Array) -> Array:
        return np.asarray(alone(t, measured) + GAIN * (follow(min(t, duration)) - measured))

    return {"ramp of positions, loops": ramp, "feedforward": alone, "feedforward, loops": together}


def identified(scene: sc.Scene) -> sc.Scene:
    """Return the scene with friction from a synthetic log of the plant."""
    path = sc.through(LOG_PATH, LOG_TIMES, rest_order=4)
    log = sc.measured(scene.with_reference(path), plant=real(scene), drives=DRIVES, resolution=5e-5, bias=0.0, seed=1)
    friction = [name for name in scene.parameter_values() if name.startswith(("dry", "viscous"))]
    return sc.identify(scene.with_reference(path), log, friction).scene().with_reference(scene.reference)


def main() -> None:
    """Print the table."""
    scene = sc.scenes.inteco()
    cases = {("as the model", name): (scene, law) for name, law in laws(scene).items()}
    cases |= {("more friction", name): (real(scene), law) for name, law in laws(scene).items()}
    cases |= {("more friction, identified", name): (real(scene), law) for name, law in laws(identified(scene)).items()}
    print("| plant | law | largest distance after the motion | sway, degrees | settled within 5 mm after |")
    for (plant, law), (crane, drive) in cases.items():
        if not (plant.endswith("identified") and law.startswith("ramp")):
            print(f"| {plant} | {law} | {driven(crane, drive)} |", flush=True)


if __name__ == "__main__":
    main()
