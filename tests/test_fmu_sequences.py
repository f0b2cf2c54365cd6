"""Random sequences of calls against an independent witness: the library, and the crane and its law as plain NumPy.

Steps of any length, parameters that change, feedback that comes and goes, states that are saved and restored, wrong
calls between them: what an FMU computes must be what the witness does, which is only told the steps that were taken.
"""

from __future__ import annotations

from copy import deepcopy
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from fmu_host import JET, OUTPUTS, Host, fmu_file
from loops import Case, fastest, random_case
from native_fmu import Joined
from plain_crane import DRIVES, Law, accelerations, continued, flat, measured_of
from present import present
from scipy.integrate import solve_ivp
from thinned import thinned

import servocore as sc
from crane_fmu.catalogue import FEEDBACK_INPUTS, FORMULATIONS, MODELS
from servocore.numerics.compiled_calls import Array

CRANE = sc.scenes.rotary_crane()
TUNED = ("bridge_inertia", "trolley_mass", "load_mass", "winch_inertia")
STEPS = 30
SEEDS = thinned(range(50), lambda seed: seed < 4)


class Witness:
    """What the steps of an instance lead to; copied where its state is saved."""

    name: str

    def __init__(self, random: np.random.Generator) -> None:
        self.random, self.time = random, 0.0

    def __deepcopy__(self, memo: dict[int, Any]) -> Witness:
        """Chance goes on where a state is restored."""
        copied = object.__new__(type(self))
        copied.__dict__ = {key: each if key == "random" else deepcopy(each, memo) for key, each in vars(self).items()}
        return copied

    def length(self) -> float:
        return float(10.0 ** self.random.uniform(-2.5, -1.0))

    def start(self, host: Host) -> None:
        raise NotImplementedError

    def step(self, host: Host) -> None:
        """Take a step that nothing is wrong with, and compare."""
        raise NotImplementedError

    def taken(self, host: Host, h: float) -> None:
        assert host.step(self.time, h), host.messages
        self.time += h

    def wrong(self, host: Host) -> None:
        """Make a call that is refused, of which nothing is left."""
        t, nan = self.time, float("nan")
        mistakes = [(t, -0.1), (t, nan), (t, 0.0), (t, 4000.0), (t + 0.5, 0.1), (t - 0.2, 0.1), (nan, 0.1)]
        assert not host.step(*mistakes[self.random.integers(len(mistakes))])


def run(witness: Witness, random: np.random.Generator) -> None:
    """Start an instance and make calls by chance."""
    saved: list[tuple[Any, Witness]] = []
    with Host(fmu_file(witness.name)) as host:
        witness.start(host)
        for _ in range(STEPS):
            event = random.uniform()
            if event < 0.15:
                witness.wrong(host)
            elif event < 0.25:
                saved.append((host.fmu.getFMUState(), deepcopy(witness)))
            elif event < 0.4 and saved:
                state, kept = saved[random.integers(len(saved))]
                host.fmu.setFMUState(state)
                witness = deepcopy(kept)
            else:
                witness.step(host)


# The inverse model, exact at every instant, with feedback -------------------------------------------------------------


class Followed(Witness):
    """Feedforward by the closed form, feedback by `plain_crane`; the crane is measured somewhere beside its path."""

    name = "RotaryCrane"

    def __init__(self, random: np.random.Generator) -> None:
        super().__init__(random)
        self.at = str(random.choice(["start", "end"]))
        cases = (random_case(random, any_crane=bool(random.integers(2))) for _ in range(100))
        case: Case = next(each for each in cases if fastest(each) * 0.1 <= 0.9)
        self.path, self.p = case.reference, CRANE.parameter_values() | case.crane
        self.time = float(random.uniform(0.0, 0.5) * self.path.duration)
        self.before, self.share, self.measures = self.path.jet(self.time, 4), 1.0, True
        self.even = float(random.choice([0.0, 0.02, 0.1]))
        self.limits = np.array([random.choice([300.0, 1e9]), 1e9, 1e9])
        self.law: Law | None = None
        self.outputs: dict[str, float] = {}

    def start(self, host: Host) -> None:
        limits = {f"limit.{name}": each for name, each in zip(DRIVES, self.limits, strict=True)}
        host.set(**limits, **self.p, input_time=self.at).start(self.before, self.time)
        self.computed(self.before)
        self.compare(host, 1e-11, self.drives().clip(-self.limits, self.limits))

    def drives(self) -> Array:
        return np.array([self.outputs[name] for name in DRIVES])

    def computed(self, jet: Array) -> None:
        """Remember the outputs without feedback or limits; the bridge's angle counts full turns."""
        found, turns = present(CRANE.closed_form)(jet[None], self.p), self.outputs.get("phi")
        self.outputs = {name: float(found[name][0]) for name in OUTPUTS if name in found}
        if turns is not None:
            self.outputs["phi"] += 2 * np.pi * np.round((turns - self.outputs["phi"]) / (2 * np.pi))

    def compare(self, host: Host, within: float, drives: Array) -> None:
        self.outputs |= dict(zip(DRIVES, drives.tolist(), strict=True))
        size = np.abs(drives).max()
        for name, value in self.outputs.items():
            assert host[name] == pytest.approx(value, rel=within, abs=within * (size if name in DRIVES else 10.0)), name

    def step(self, host: Host) -> None:
        self.change(host)
        h = self.even or self.length()
        told = self.path.jet(self.time + h * (self.at == "end"), 4)
        state, _ = flat(self.path.jet(self.time, 4), self.values())
        measured = measured_of(state + 0.01 * self.random.standard_normal(10)) * self.measures
        host.tell(told).set(**dict(zip(FEEDBACK_INPUTS, measured.tolist(), strict=True)))
        before, acting = (self.before if self.at == "end" else told), self.drives()
        ahead = told if self.at == "end" else continued(told, np.zeros(3), h)
        self.taken(host, h)
        self.computed(ahead)
        drives = self.drives()
        if self.measures and self.share > 0.0:
            p = self.values()
            self.law = self.law or Law.begun(self.at, before, measured, p, h)
            drives = self.law.follow(told, before, measured, acting, drives, p, h, self.share, self.limits)
            self.compare(host, 1e-9, drives)
        else:
            self.law = None
            self.compare(host, 1e-11, drives.clip(-self.limits, self.limits))
        self.before = ahead

    def values(self) -> Array:
        return np.array(list(self.p.values()))

    def change(self, host: Host) -> None:
        """Change a parameter, the share of the feedback, or whether motion is measured: now and then."""
        event = self.random.uniform()
        if event < 0.1:
            name = str(self.random.choice(TUNED))
            self.p[name] *= float(self.random.uniform(0.9, 1.1))
        elif event < 0.2:
            self.share = float(self.random.choice([0.0, 0.5, 1.0]))
        elif event < 0.3:
            self.measures = not self.measures
        host.set(**{name: self.p[name] for name in TUNED}, feedback=self.share)

    def wrong(self, host: Host) -> None:
        bad: list[dict[str, float]] = [{"load.jerk[2]": np.nan}, {"load.position[3]": 1.0}, {"measured.s": np.inf},
                                       {"load_mass": -1.0}, {"feedback": 2.0}, {"limit.F": np.nan}]  # fmt: skip
        told = bad[self.random.integers(len(bad))]
        kept = {name: host[name] for name in told}
        before = host.outputs().tolist()
        assert not host.set(**told).step(self.time, 0.01)
        host.set(**kept)
        super().wrong(host)
        assert host.outputs().tolist() == before


@pytest.mark.parametrize("seed", SEEDS)
def test_the_inverse_model_with_feedback_is_the_closed_form_and_the_law_in_numpy(seed: int) -> None:
    random = np.random.default_rng([seed, 1])
    run(Followed(random), random)


# The inverse model, stepped -----------------------------------------------------------------------------------------

ROUTES = [each for each in product(MODELS, FORMULATIONS) if each != ("generalized", "original")]  # see test_fmu_numbers


class Stepped(Witness):
    """One of the forms and models, as `solve` steps it along the path that the FMU is told."""

    name = "RotaryCrane"

    def __init__(self, random: np.random.Generator, route: tuple[str, str]) -> None:
        super().__init__(random)
        self.model, self.formulation = route
        self.path = random_case(random).reference
        self.h, parts, self.k = float(random.choice([0.1, 0.2])), int(random.choice([1, 2])), 0
        nodes = self.h * np.arange(STEPS + 1)
        self.jets = self.path.jet(nodes, 4)
        joined = Joined(
            start_time=0.0, end_time=float(nodes[-1]), dimension=3, max_order=9, smoothness=4, nodes=nodes,
            known=self.jets,
        )  # fmt: skip
        self.settings = {"model": self.model, "formulation": self.formulation, "internal_step": self.h / parts}
        form, method = FORMULATIONS[self.formulation], sc.BackwardEuler()
        solution = sc.solve(CRANE.with_reference(joined), form, method, step=self.h / parts, model=self.model)
        self.wanted = {name: solution[name][::parts] for name in OUTPUTS}

    def start(self, host: Host) -> None:
        host.set(**self.settings, input_time="end").start(self.jets[0])  # type: ignore[arg-type]  # of numbers and texts
        self.compare(host)

    def compare(self, host: Host) -> None:
        for name, values in self.wanted.items():
            assert host[name] == pytest.approx(values[self.k], abs=1e-9 * np.abs(values).max()), (name, self.settings)

    def step(self, host: Host) -> None:
        if self.k < STEPS:
            self.k += 1
            self.taken(host.tell(self.jets[self.k]), self.h)
            self.compare(host)


@pytest.mark.parametrize("seed", thinned(range(50), lambda seed: seed < len(ROUTES)))
def test_every_form_and_model_is_stepped_as_solve_steps_it(seed: int) -> None:
    random = np.random.default_rng([seed, 2])
    run(Stepped(random, ROUTES[seed % len(ROUTES)]), random)


# The plant ----------------------------------------------------------------------------------------------------------


class Moved(Witness):
    """The crane of `plain_crane` under inputs that go on as the plant's hold says, wind and a gust."""

    name = "CranePlant"

    def __init__(self, random: np.random.Generator) -> None:
        super().__init__(random)
        self.at, self.hold = str(random.choice(["start", "end"])), str(random.choice(["first_order", "zero_order"]))
        self.error = float(random.uniform(-0.1, 0.1))
        self.wind, self.gust = random.uniform(-5.0, 5.0, 3), random.uniform(-20.0, 20.0, 3)
        self.blows = np.sort(random.uniform(0.0, 1.0, 2))
        place, velocity = np.array([6.0, 1.0, -5.0]) + random.uniform(-1.0, 1.0, 3), random.uniform(-0.3, 0.3, 3)
        self.begin = {f"start.{what}[{k + 1}]": float(each[k])
                      for what, each in (("position", place), ("velocity", velocity)) for k in range(3)}  # fmt: skip
        self.p = np.array(list(CRANE.parameter_values().values()))
        self.x, _ = flat(np.array([place, velocity, *np.zeros((3, 3))]), self.p)
        self.u, self.last = self.inputs(), 0.0
        self.p[2] *= 1.0 + self.error

    def inputs(self) -> Array:
        return np.array([100.0, 10.0, 3.0]) * self.random.uniform(-1.0, 1.0, 3) - [0.0, 0.0, 98.1]

    def start(self, host: Host) -> None:
        forces = {
            f"{what}[{k + 1}]": each[k] for what, each in (("wind", self.wind), ("gust", self.gust)) for k in range(3)
        }
        duration = self.blows[1] - self.blows[0]
        host.set(**self.begin, **forces, gust_start=self.blows[0], gust_duration=duration, mass_error=self.error)
        host.set(internal_step=0.002, input_time=self.at, hold=self.hold)
        host.set(**dict(zip(DRIVES, self.u.tolist(), strict=True))).start()
        self.compare(host, self.u)

    def force(self, time: float) -> Array:
        return self.wind + self.gust * float(self.blows[0] <= time < self.blows[1])

    def step(self, host: Host) -> None:
        h, u, earlier, t = self.length(), self.inputs(), self.u, self.time
        begin, slope = u, np.zeros(3)
        if self.hold == "first_order" and self.at == "end":
            begin, slope = earlier, (u - earlier) / h
        elif self.hold == "first_order" and self.last > 0.0:
            slope = (u - earlier) / self.last
        self.taken(host.set(**dict(zip(DRIVES, u.tolist(), strict=True))), h)
        edges = [t, *(each for each in self.blows if t < each < t + h), t + h]
        for first, then in pairwise(edges):
            d = self.force(first)

            def rate(time: float, x: Array, d: Array = d) -> Array:
                return np.concatenate([x[5:], accelerations(x, begin + slope * (time - t), d, self.p)])

            self.x = solve_ivp(rate, (first, then), self.x, method="DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
        self.u, self.last = u, h
        self.compare(host, begin + slope * h)

    def compare(self, host: Host, acting: Array) -> None:
        names = ("phi", "s", "l", "phi_dot", "s_dot", "l_dot",
                 *(f"load.{what}[{k}]" for what in ("position", "velocity") for k in (1, 2, 3)))  # fmt: skip
        found = np.array([host[name] for name in names])
        np.testing.assert_allclose(found, measured_of(self.x), atol=1e-8)
        d, (_, _, m, *_, g) = self.force(self.time), self.p
        pull = m * (accelerations(self.x, acting, d, self.p)[2:] + np.array([0.0, 0.0, g])) - d
        assert host["tension"] == pytest.approx(np.linalg.norm(pull), rel=1e-7)

    def wrong(self, host: Host) -> None:
        kept = host["F"]
        assert not host.set(F=float("nan")).step(self.time, 0.01)
        host.set(F=kept)
        super().wrong(host)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_plant_moves_as_the_crane_in_numpy(seed: int) -> None:
    random = np.random.default_rng([seed, 3])
    run(Moved(random), random)


def test_the_crane_in_numpy_moves_as_simulate_has_it() -> None:
    """The witness of the plant has a witness of its own."""
    t, p = np.linspace(0.0, 2.0, 5), np.array(list(CRANE.parameter_values().values()))

    def inputs(time: float) -> Array:
        return np.array([300.0 * np.sin(time), 20.0 * np.sin(2 * time), -98.1 + 5.0 * np.sin(time)])

    x, _ = flat(np.array([CRANE.reference.jet(0.0, 0)[0], *np.zeros((4, 3))]), p)
    motion = solve_ivp(
        lambda time, x: np.concatenate([x[5:], accelerations(x, inputs(time), np.zeros(3), p)]),
        (0.0, 2.0), x, method="DOP853", rtol=1e-11, atol=1e-11, t_eval=t,
    )  # fmt: skip
    found = sc.simulate(CRANE, inputs, t=t, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(motion.y[2:5], [found[name] for name in "xyz"], atol=1e-8)


# The trajectory -----------------------------------------------------------------------------------------------------


LAWS = {"degree9": sc.DEGREE9, "degree13": sc.DEGREE13, "three-phase": sc.three_phase(3.0)}


class Played(Witness):
    """The library's path."""

    name = "LoadTrajectory"

    def __init__(self, random: np.random.Generator) -> None:
        super().__init__(random)
        self.profile = str(random.choice(list(LAWS)))
        case, begin = random_case(random).reference, float(random.uniform(-1.0, 1.0))
        start, end = (case.jet(each, 0)[0] for each in (case.start_time, case.end_time))
        self.path = sc.rest_to_rest(start, end, case.duration, LAWS[self.profile], begin)
        self.settings = {f"{what}[{k + 1}]": float(each[k])
                         for what, each in (("start", start), ("end", end)) for k in range(3)}  # fmt: skip
        self.settings |= {"duration": case.duration, "start_time": begin, "ramp": 3.0 * (self.profile == "three-phase")}

    def length(self) -> float:
        return float(self.random.uniform(0.01, 1.0))

    def start(self, host: Host) -> None:
        host.set(**self.settings, profile=self.profile).start()
        self.compare(host)

    def compare(self, host: Host) -> None:
        found, wanted = np.array([host[name] for name in JET]).reshape(5, 3), self.path.jet(self.time, 4)
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12)

    def step(self, host: Host) -> None:
        self.taken(host, self.length())
        self.compare(host)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_trajectory_plays_the_path_of_the_library(seed: int) -> None:
    random = np.random.default_rng([seed, 4])
    run(Played(random), random)
