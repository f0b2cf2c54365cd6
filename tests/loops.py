"""Masters of our own, Jacobi and Gauss-Seidel, that close the loop of inverse model and plant, and random cases.

`loop_study` runs them all, ``make loop``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from fmu_host import JET, Host
from native_fmu import native_file
from present import present

import servocore as sc
from crane_fmu.build.native import LARGEST_TURN
from crane_fmu.catalogue import FEEDBACK_INPUTS

CRANE = sc.scenes.rotary_crane()
FORCES = ("M_b", "F", "M_w")
MOTION = tuple(
    f"load.{name}" if "[" in name else name for name in (each.removeprefix("measured.") for each in FEEDBACK_INPUTS)
)
STEPS = (0.1, 0.05, 0.02, 0.01, 0.005)
BOUNDS = {0.1: 2.0, 0.05: 0.25, 0.02: 0.06, 0.01: 0.03, 0.005: 0.03}
"""Of the load's distance from its path in mm, nominal crane."""

MARGIN, TURN, ACCELERATION, SNAP = 1.0, 0.7, 1.0, 2.5
"""What is feasible: trolley off the axis (m), bridge (rad/s), load's acceleration (m/s2) and snap (m/s4)."""


@dataclass(frozen=True)
class Case:
    """A manoeuvre of a crane, and what disturbs it."""

    reference: sc.Reference = field(default_factory=lambda: CRANE.reference)
    crane: dict[str, float] = field(default_factory=dict)
    disturbance: dict[str, float] = field(default_factory=dict)
    name: str = "default"


class PlantRefusedError(AssertionError):
    """The load has left where a plant can go, as with a slack rope."""


class Loop:
    """Two instances of native FMUs that are used for one run."""

    def __init__(self, case: Case, at: str = "start", **settings: float | str) -> None:
        self.case, self.at = case, at
        crane_file, plant_file = (native_file(f"rotary_crane {what}", 2) for what in ("loop", "plant"))
        path = case.reference
        start = path.jet(path.start_time, 0)[0]
        places = {f"start.position[{k + 1}]": float(start[k]) for k in range(3)}
        self.crane = Host(crane_file).set(input_time=at, **case.crane, **settings)
        self.plant = Host(plant_file, name="plant")
        self.plant.set(input_time=at, **(case.crane | places | case.disturbance))
        crane, plant = self.crane.references, self.plant.references
        self._jet, self._given = [crane[name] for name in JET], [crane[name] for name in FEEDBACK_INPUTS]
        self._out, self._forces = [crane[name] for name in FORCES], [plant[name] for name in FORCES]
        self._motion = [plant[name] for name in MOTION]
        self.first = path.jet(path.start_time, 4)[0]

    def __enter__(self) -> Loop:
        self.crane.start(self.first)
        self._tell_plant()
        self.plant.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.crane.fmu.freeInstance()
        self.plant.fmu.freeInstance()

    def _tell_plant(self) -> None:
        self.plant.fmu.setReal(self._forces, self.crane.fmu.getReal(self._out))

    def measured(self) -> list[float]:
        return list(self.plant.fmu.getReal(self._motion))

    def step(self, jets: np.ndarray, k: int, h: float, t: float | None = None) -> np.ndarray:
        """Take step k, at k h if no time is given; returns where the load is then."""
        t = k * h if t is None else t
        self.crane.fmu.setReal(self._given, self.measured())
        if self.at == "start":
            self._tell_plant()
        self.crane.fmu.setReal(self._jet, jets[k + (self.at == "end")].ravel().tolist())
        assert self.crane.step(t, h), self.crane.messages
        if self.at == "end":
            self._tell_plant()
        if not self.plant.step(t, h):
            raise PlantRefusedError(self.plant.messages[-1])
        return np.array(self.measured()[6:9])


def deviation(
    case: Case, h: float | np.ndarray, at: str = "start", stop: float | None = None, **settings: float | str
) -> float:
    """Largest distance in mm of the load from its path, until a second after it or another time; steps may vary."""
    path = case.reference
    if isinstance(h, float):
        t = h * np.arange(round((path.duration + 1.0 if stop is None else stop) / h) + 1)
    else:
        t = np.concatenate([[0.0], np.cumsum(h)])
    jets, steps = jets_at(path, path.start_time + t), np.broadcast_to(h, len(t) - 1)
    with Loop(case, at, **settings) as loop:
        places = [loop.step(jets, k, each, t[k]) for k, each in enumerate(steps.tolist())]
        assert not loop.crane.messages, loop.crane.messages
    return 1e3 * float(np.linalg.norm(np.array(places) - jets[1:, 0], axis=1).max())


def jets_at(path: sc.Reference, t: np.ndarray) -> np.ndarray:
    """The path at instants, at rest after its end."""
    jets = path.jet(np.minimum(t, path.end_time), 4)
    jets[t > path.end_time, 1:] = 0.0
    return jets


# Random cases --------------------------------------------------------------------------------------------------------


def random_case(
    rng: np.random.Generator, *, any_crane: bool = False, disturbed: bool = False, snap: float = SNAP
) -> Case:
    """Return a feasible manoeuvre from rest to rest of 8 to 25 s, of the default crane or one within +-50 % of it."""
    profiles = {"degree 9": sc.DEGREE9, "degree 13": sc.DEGREE13, "three phases": sc.three_phase()}
    default = CRANE.parameter_values()
    while True:
        values = {name: default[name] * (rng.uniform(0.5, 1.5) if any_crane else 1.0) for name in default}
        angle, radius, height = rng.uniform(-np.pi, np.pi, 2), rng.uniform(2.0, 9.0, 2), rng.uniform(-8.0, -2.0, 2)
        ends = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
        name, duration = str(rng.choice(list(profiles))), round(float(rng.uniform(8.0, 25.0)), 1)
        if not 1.0 < np.linalg.norm(ends[1] - ends[0]) < 12.0:
            continue
        path = sc.rest_to_rest(ends[0], ends[1], duration, profiles[name])
        if feasible(path, values, snap):
            disturbance = _disturbance(rng, duration) if disturbed else {}
            return Case(
                path, values if any_crane else {}, disturbance, f"{name}, {duration:g} s, {ends.round(1).tolist()}"
            )


def feasible(path: sc.Reference, crane: dict[str, float], snap: float = SNAP) -> bool:
    jets = path.jet(np.linspace(0.0, path.duration, 400), 4)
    found = present(CRANE.closed_form)(jets, crane)
    s, phi = found["s"], np.unwrap(found["phi"])
    turning = np.abs(np.gradient(phi, path.duration / 399)).max()
    sizes = [float(np.linalg.norm(jets[:, k], axis=1).max()) for k in (2, 4)]
    return bool(s.min() > MARGIN and turning < TURN and sizes[0] < ACCELERATION and sizes[1] < snap)


def _disturbance(rng: np.random.Generator, duration: float) -> dict[str, float]:
    axis, sign = int(rng.integers(1, 3)), float(rng.choice([-1.0, 1.0]))
    begin = round(float(rng.uniform(1.0, duration - 3.0)), 1)
    return {
        "mass_error": 0.05 * float(rng.choice([-1.0, 1.0])),
        f"gust[{axis}]": 20.0 * sign,
        "gust_start": begin,
        "gust_duration": 2.0,
    }


def fastest(case: Case) -> float:
    """Angular frequency of the fastest pendulum on the way, in rad/s: a trolley that is free to roll."""
    crane = CRANE.parameter_values() | case.crane
    path = case.reference
    found = present(CRANE.closed_form)(path.jet(np.linspace(0.0, path.duration, 200), 4), crane)
    return math.sqrt(crane["gravity"] / found["l"].min() * (1.0 + crane["load_mass"] / crane["trolley_mass"]))


# Steps that vary, between a longest one and a share of it -------------------------------------------------------------

KINDS = ("between", "either", "rarely", "events")
"""Anywhere between; half of them long, half short; one in fifty long; long, one in ten divided into two."""


def schedule(rng: np.random.Generator, kind: str, longest: float, factor: float, time: float) -> np.ndarray:
    """Return steps that last until a time."""
    steps: list[float] = []
    short = longest / factor
    while time > 0.0:
        by_chance = rng.uniform()
        if kind == "between":
            more = [longest * factor**-by_chance]
        elif kind == "events":
            more = [short, longest - short] if by_chance < 0.1 else [longest]
        else:
            more = [longest if by_chance < {"either": 0.5, "rarely": 0.02}[kind] else short]
        steps += more
        time -= sum(more)
    return np.array(steps)


def distances(count: int, kind: str, longest: float, factor: float, at: str) -> np.ndarray:
    """Return the largest distances in mm of loads by chance; infinite where a load is lost."""
    rng, found = np.random.default_rng(3), list[float]()
    while len(found) < count:
        case = random_case(rng, any_crane=True, disturbed=True)
        if fastest(case) * longest <= LARGEST_TURN:
            steps = schedule(rng, kind, longest, factor, case.reference.duration + 1.0)
            try:
                found.append(deviation(case, steps, at))
            except AssertionError:  # the plant has refused to go on, or the load was left to the feedforward
                found.append(np.inf)
    return np.array(found)
