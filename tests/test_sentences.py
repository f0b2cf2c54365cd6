"""What is wrong with values, steps and times is told in a sentence with culprit, value, limit and time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import pytest
from fmpy.fmi1 import FMICallException
from fmu_host import JET, OK, Host, fmu_file
from native_fmu import END, Native

from crane_fmu.catalogue import FEEDBACK_INPUTS

pytestmark = pytest.mark.usefixtures("compiler")
KINDS = {
    "inverse model": "rotary_crane loop",
    "plant": "rotary_crane plant",
    "trajectory": "rotary_crane trajectory",
}
PYTHON = {"inverse model": "RotaryCrane", "plant": "CranePlant", "trajectory": "LoadTrajectory"}
SENSED = dict(zip(FEEDBACK_INPUTS, [0.0, 5.0, 5.0, 0.0, 0.0, 0.0, 5.0, 0.0, -5.0, 0.0, 0.0, 0.0], strict=True))
LATE, WITHOUT = {"input_time": END}, {"feedback": 0.0}
RESTING = dict(zip(JET, [5.0, 0.0, -5.0, *[0.0] * 12], strict=True))


@dataclass(frozen=True)
class Mistake:
    """What a host sets before the start and before the first step, the steps it asks for, and what it is told."""

    kind: str
    sentence: str
    settings: Mapping[str, float] = field(default_factory=dict)
    inputs: Mapping[str, float] = field(default_factory=dict)
    steps: Sequence[tuple[float, float]] = ((0.0, 0.1),)
    start: float = 0.0
    stop: float | None = None
    changes: Mapping[str, float] = field(default_factory=dict)  # after a step, before another


def inverse(sentence: str, inputs: Mapping[str, float], settings: Mapping[str, float] | None = None) -> Mistake:
    return Mistake("inverse model", sentence, settings or {}, {**RESTING, **inputs})


def settings(kind: str, sentence: str, **values: float) -> Mistake:
    return Mistake(kind, sentence, {name.replace("__", "."): value for name, value in values.items()})


GIRDER = (
    "at t = 0 s the load is not below the girder: the load's depth below the girder is {} m, it must stay above 0 m"
)
AXIS = (
    "at t = 0 s the trolley reaches the slewing axis: the trolley's distance from the slewing axis is 0 m, it must stay"
    " above 0.001 m"
)
SLACK = "at t = 0 s the rope goes slack: g + z'' is -0.19 m/s2, it must stay above 0 m/s2"
SENSELESS = (
    "at t = 0 s the measured rope length is {} m and the measured height of the load {} m: the feedback needs the"
    " length above 0 m, the height below 0 m and all measured values connected; feedback = 0 does without"
)
MISTAKES = [
    settings("inverse model", "load_mass = nan kg is not a finite number", load_mass=math.nan),
    settings("inverse model", "feedback = 2 is outside its range [0, 1]", feedback=2.0),
    settings("inverse model", "limit.M_b = -1 N.m is outside its range [0.001, 1e+09] N.m", limit__M_b=-1.0),
    settings("inverse model", "input_time = 9 is unknown; it may be 1 (start) or 2 (end)", input_time=9),
    settings("plant", "mass_error = -2 is outside its range [-0.9, 10]", mass_error=-2.0),
    settings("plant", "wind[1] = inf N is not a finite number", **{"wind[1]": math.inf}),
    settings("plant", "gust_start = 1e+10 s is outside its range [-1e+09, 1e+09] s", gust_start=1e10),
    settings("plant", "start.velocity[2] = nan m/s is not a finite number", **{"start.velocity[2]": math.nan}),
    settings("plant", GIRDER.format("0"), **{"start.position[3]": 0.0}),
    settings("plant", AXIS, **{"start.position[1]": 0.0}),
    settings("plant", AXIS, **{"start.acceleration[1]": -9.81}),
    settings("plant", GIRDER.format("-1"), **{"start.position[3]": 1.0}),
    settings("plant", SLACK, **{"start.acceleration[3]": -10.0}),
    settings("plant", "brakes = 0 is unknown; it may be 1 (until_inputs) or 2 (none)", brakes=0),
    settings("trajectory", "duration = nan s is not a finite number", duration=math.nan),
    settings("trajectory", "ramp = -1 s is outside its range [0, 1e+09] s", ramp=-1.0),
    *(
        settings("trajectory", f"a ramp belongs to the profile three-phase, not to {name}", profile=k, ramp=3.0)
        for k, name in {1: "degree9", 2: "degree13", 4: "file"}.items()
    ),
    settings(
        "trajectory", "a path with a ramp of 11 s takes at least 22 s, but its duration is 20 s", profile=3, ramp=11.0
    ),
    inverse("at t = 0 s the input load.jerk[2] is nan, not a finite number", {"load.jerk[2]": math.nan}),
    inverse("at t = 0.1 s the input load.jerk[2] is nan, not a finite number", {"load.jerk[2]": math.nan}, LATE),
    inverse("at t = 0 s the input measured.s is inf, not a finite number", {**SENSED, "measured.s": math.inf}, LATE),
    inverse("at t = 0 s the input measured.l is nan, not a finite number", {**SENSED, "measured.l": math.nan}, WITHOUT),
    inverse(SENSELESS.format("0", "-5"), {**SENSED, "measured.l": 0.0}),
    inverse(SENSELESS.format("5", "1"), {**SENSED, "measured.position[3]": 1.0}, LATE),
    inverse(GIRDER.format("-1"), {"load.position[3]": 1.0}),
    inverse(SLACK, {"load.acceleration[3]": -10.0}),
    inverse(AXIS, {"load.position[1]": 0.0}),
    Mistake("plant", "at t = 0 s the input F is nan, not a finite number", inputs={"F": math.nan}),
    Mistake("plant", "at t = 0.1 s the input F is nan, not a finite number", LATE, {"F": math.nan}),
    *(
        Mistake(kind, sentence, steps=steps)
        for kind in KINDS
        for sentence, steps in {
            "at t = 0 s the communication step is nan s, it must be above 0 s and at most 3600 s": [(0.0, math.nan)],
            "at t = 0 s the communication step is -0.1 s, it must be above 0 s and at most 3600 s": [(0.0, -0.1)],
            "the communication point t = 0 s lies behind the FMU's time 0.1 s; to repeat a step restore the FMU's state"
            " first": [(0.0, 0.1), (0.0, 0.1)],
            "the communication point t = 0.5 s lies ahead of the FMU's time 0 s; to repeat a step restore the FMU's"
            " state first": [(0.5, 0.1)],
            "at t = 0.5 s a communication step of 1e-18 s is lost in round-off": [(0.0, 0.5), (0.5, 1e-18)],
            "the communication point must be a finite number, not nan s": [(math.nan, 0.1)],
        }.items()
    ),
    *(
        Mistake(
            "plant",
            f"the communication point t = {asked:.16g} s lies {where} the FMU's time 1000000000.001 s; to repeat a step"
            " restore the FMU's state first",
            steps=[(1e9, 1e-3), (asked, 1e-3)],
            start=1e9,
        )
        for asked, where in [(1e9, "behind"), (1e9 + 2e-3, "ahead of")]
    ),
    *(Mistake(kind, "the start time must be a finite number, not nan s", start=math.nan) for kind in KINDS),
    *(
        Mistake(kind, sentence, steps=steps, stop=stop)
        for kind in KINDS
        for sentence, steps, stop in [
            ("the experiment from 0 s to -1 s has no duration", [(0.0, 0.1)], -1.0),
            ("the experiment from 0 s to nan s has no duration", [(0.0, 0.1)], math.nan),
            (
                "at t = 0.2 s a communication step of 0.2 s goes beyond the stop time of 0.3 s",
                [(0.0, 0.2), (0.2, 0.2)],
                0.3,
            ),
        ]
    ),
    *(
        Mistake(kind, f"{name} cannot change after the initialization; the new value is ignored", changes={name: value})
        for kind, name, value in [
            ("inverse model", "gravity", 1.6),
            ("inverse model", "winch_radius", math.nan),
            ("inverse model", "input_time", END),
            ("plant", "gravity", -1.0),
            ("plant", "start.position[1]", 4.0),
            ("plant", "hold", 2),
            ("trajectory", "start[1]", 10.0),
        ]
    ),
    *(
        Mistake(kind, sentence, changes={name: value})
        for kind, sentence, name, value in [
            ("inverse model", "load_mass = -1 kg is outside its range [0.001, 1e+09] kg", "load_mass", -1.0),
            ("inverse model", "load_mass = nan kg is not a finite number", "load_mass", math.nan),
            ("inverse model", "limit.F = 0 N is outside its range [0.001, 1e+09] N", "limit.F", 0.0),
            ("plant", "trolley_mass = inf kg is not a finite number", "trolley_mass", math.inf),
            ("plant", "gust_duration = -2 s is outside its range [0, 1e+09] s", "gust_duration", -2.0),
            ("plant", "mass_error = -1 is outside its range [-0.9, 10]", "mass_error", -1.0),
        ]
    ),
    *(
        Mistake(kind, f"{name} is calculated and cannot be set; the new value is ignored", changes={name: 1.0})
        for kind, name in [("inverse model", "M_b"), ("plant", "s"), ("trajectory", "load.position[2]")]
    ),
]  # fmt: skip


def told(host: Host, mistake: Mistake) -> str:
    """Return the first sentence that a host hears, without where it was found: all that PythonFMUs tell of most."""
    calls = [
        *(lambda name=name, value=value: host.set(**{name: value}) for name, value in mistake.settings.items()),
        lambda: host.fmu.setupExperiment(startTime=mistake.start, stopTime=mistake.stop),
        host.fmu.enterInitializationMode,
        host.fmu.exitInitializationMode,
        lambda: host.numbers_set(list(mistake.inputs), list(mistake.inputs.values())),
        *(lambda time=time, h=h: host.fmu.doStep(time, h) for time, h in mistake.steps),
        *(lambda name=name, value=value: host.set(**{name: value}) for name, value in mistake.changes.items()),
        lambda: host.fmu.doStep(mistake.steps[-1][0] + mistake.steps[-1][1], 0.1),
    ]
    for call in calls:
        with suppress(FMICallException):
            call()
        if host.messages:
            return host.messages[0].removeprefix("the initialization failed: ")
    raise AssertionError("every call was taken")


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda each: each.sentence)
@pytest.mark.parametrize("native", [True, False], ids=["native", "Python"])
def test_a_mistake_is_told_in_its_sentence(mistake: Mistake, native: bool) -> None:
    with Native(KINDS[mistake.kind], 2) if native else Host(fmu_file(PYTHON[mistake.kind])) as host:
        assert told(host, mistake) == mistake.sentence


@pytest.mark.parametrize(
    ("start", "h", "count"), [(0.0, 0.1, 3), (1e6, 1e-3, 300), (1e9, 0.1, 200), (-7.5, 0.02, 5000)]
)
@pytest.mark.parametrize("kind", KINDS)
def test_the_last_of_steps_that_were_added_up_is_taken(kind: str, start: float, h: float, count: int) -> None:
    with Native(KINDS[kind], 2) as host:
        host.fmu.setupExperiment(startTime=start, stopTime=start + count * h)
        host.fmu.enterInitializationMode()
        host.fmu.exitInitializationMode()
        if kind == "inverse model":
            host.numbers_set(list(RESTING), list(RESTING.values()))
        time = start
        for _ in range(count):
            assert host.step(time, h), (time, host.messages)
            time += h
        assert host.status(time, h) != OK
