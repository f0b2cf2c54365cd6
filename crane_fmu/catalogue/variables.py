"""The tables of the FMUs' variables: the crane's inverse model, a load trajectory, the crane as a plant."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import servocore as sc
from crane_fmu.slave.interface import (
    DIMENSION,
    FEEDBACK_INPUTS,
    FROM_FILE,
    INPUT_TIMES,
    ORDERS,
    REST,
    THREE_PHASE,
    Causality,
    Interface,
    Variability,
    Variable,
)

PATH_UNITS = ("m", "m/s", "m/s2", "m/s3", "m/s4")
PLANT_STEP = 0.002
"""Longest step of the plant's solver in s."""

# Exact only while they are constant: a change of these moves the trolley or the rope at once.
_FIXED_PARAMETERS = frozenset({"gravity", "winch_radius"})

_INPUT_ROWS = (
    ("M_b", "N.m", 1000.0, "slewing torque on the bridge, positive as phi"),
    ("F", "N", 1000.0, "force on the trolley along the bridge, positive as s"),
    ("M_w", "N.m", 100.0, "winch torque, positive where it pays out rope"),
)
_MOTION_ROWS = (
    ("phi", "rad", "deg", None, 1.0, "bridge angle, continuous across full turns"),
    ("s", "m", "", 0.0, 1.0, "distance of the trolley from the slewing axis"),
    ("l", "m", "", 0.0, 1.0, "rope length"),
)
_RATE_UNITS = {"phi_dot": "rad/s", "s_dot": "m/s", "l_dot": "m/s"}


def crane_interface(models: Sequence[str], formulations: Sequence[str]) -> Interface:
    """Return the table of the inverse model for the models and formulations that the FMU carries."""
    settings = (
        ("model", models, "model of the crane that is solved"),
        ("formulation", formulations, "how the servo constraints enter the equations"),
        ("input_time", INPUT_TIMES, "instant of a communication step that its inputs belong to"),
        (
            "connected",
            tuple(reversed(ORDERS)),
            "highest derivative of the path that is connected; others are estimated",
        ),
    )
    rows = (
        *_path("input", "wanted of the load", REST),
        *_crane_outputs(),
        *crane_parameters(),
        _number("internal_step", "s", 0.0, "step of the method; a communication step takes the nearest whole number of"
                " them; 0: one"),
        *(_text(*each) for each in settings),
        *_measured(),
        _number("feedback", "1", 1.0, "share of the feedback in the outputs, where motion is measured", highest=1.0),
    )  # fmt: skip
    return Interface(rows)


def trajectory_interface() -> Interface:
    """Return the table of the load trajectory."""
    reference = sc.scenes.rotary_crane().reference
    ends = [[float(x) for x in reference.jet(t, 0)[0]] for t in (reference.start_time, reference.end_time)]
    rows = [*_path("output", "of the load")]
    for name, point in zip(("start", "end"), ends, strict=True):
        rows += [
            _number(
                f"{name}[{k + 1}]", "m", point[k], f"{name} of the path, component {'xyz'[k]}", None, change="fixed"
            )
            for k in range(DIMENSION)
        ]
    rows += [
        _number("duration", "s", reference.duration, "time of the motion", 1e-3, 1e9, change="fixed"),
        _number("start_time", "s", 0.0, "when the motion starts; the load rests before", None, change="fixed"),
        _number(
            "ramp", "s", 0.0, f"time to accelerate, for {THREE_PHASE}; 0: a quarter of the duration", change="fixed"
        ),
        _text("profile", ("degree9", "degree13", THREE_PHASE, FROM_FILE), "time law along the line, or a table"),
    ]
    return Interface(tuple(rows))


def plant_interface() -> Interface:
    """Return the table of the plant."""
    inputs = [
        Variable(name, "input", "continuous", text, f"input {name}", unit, start=0.0, nominal=size)
        for name, unit, size, text in _INPUT_ROWS
    ]
    three = range(1, DIMENSION + 1)
    outputs = [
        *(
            _output(f"load.{name}[{k}]", unit, f"{name} of the load, component {'xyz'[k - 1]}")
            for name, unit in (("position", "m"), ("velocity", "m/s"))
            for k in three
        ),
        *(_output(name, unit, text, display, low, size) for name, unit, display, low, size, text in _MOTION_ROWS),
        *(_output(name, unit, f"rate of {name.removesuffix('_dot')}") for name, unit in _RATE_UNITS.items()),
        _output("tension", "N", "rope tension", "kN", 0.0, 1000.0),
        _output("energy", "J", "kinetic and potential energy; zero at rest at the girder", "kJ", None, 1000.0),
    ]
    start = [
        *(
            _number(f"start.{name}[{k}]", unit, values[k - 1], f"{name} of the load at the start, {'xyz'[k - 1]}",
                    None, change="fixed")
            for name, unit, values in (("position", "m", REST), ("velocity", "m/s", (0.0, 0.0, 0.0)))
            for k in three
        ),
        _number("start.swing[1]", "rad", 0.0, "swing at the start in the bridge's plane, outwards", -1.5, 1.5, "fixed"),
        _number("start.swing[2]", "rad", 0.0, "swing at the start, out of that plane", -1.5, 1.5, "fixed"),
    ]  # fmt: skip
    weather = [
        _number("mass_error", "1", 0.0, "the load is heavier by this fraction of load_mass", -0.9, 10.0),
        *(_number(f"wind[{k}]", "N", 0.0, f"constant force on the load, {'xyz'[k - 1]}", None) for k in three),
        *(_number(f"gust[{k}]", "N", 0.0, f"force on the load during the gust, {'xyz'[k - 1]}", None)
          for k in three),
        _number("gust_start", "s", 0.0, "time at which the gust begins", None),
        _number("gust_duration", "s", 0.0, "time that the gust lasts"),
    ]  # fmt: skip
    solver = [
        _number("internal_step", "s", PLANT_STEP, "longest step of the solver, Runge-Kutta of order four", 1e-6, 1.0),
        _text("input_time", INPUT_TIMES, "instant of a communication step that its inputs belong to"),
        _text("hold", ("first_order", "zero_order"), "how inputs go on between communication points"),
        _text("brakes", ("until_inputs", "none"), "brakes hold the crane until an input is not zero"),
    ]
    return Interface((*inputs, *outputs, *crane_parameters(), *start, *weather, *solver))


def crane_parameters() -> Iterable[Variable]:
    """Return the rows of the crane's own parameters."""
    for each in sc.scenes.rotary_crane().model().parameters.declared:
        yield Variable(
            name=each.name,
            causality="parameter",
            variability="fixed" if each.name in _FIXED_PARAMETERS else "tunable",
            description=each.description,
            reads=f"parameter {each.name}",
            unit=each.unit,
            start=each.default,
            minimum=each.lower,
            maximum=each.upper,
            nominal=each.default,
        )


def _path(causality: Causality, of: str, start: Sequence[float] | None = None) -> Iterable[Variable]:
    for order, (quantity, unit) in enumerate(zip(ORDERS, PATH_UNITS, strict=True)):
        for k in range(DIMENSION):
            yield Variable(
                name=f"load.{quantity}[{k + 1}]",
                causality=causality,
                variability="continuous",
                description=f"{quantity} {of}, component {'xyz'[k]}",
                reads=f"path derivative {order}, component {k + 1}",
                unit=unit,
                start=None if start is None else start[k] if order == 0 else 0.0,
            )


def _crane_outputs() -> Iterable[Variable]:
    for name, unit, size, text in _INPUT_ROWS:
        yield _output(name, unit, text, "", None, size)
    for name, unit, display, low, nominal, text in _MOTION_ROWS:
        yield _output(name, unit, text, display, low, nominal)
    yield _output("tension", "N", "rope tension", "kN", 0.0, 1000.0)
    yield _output("swing", "rad", "angle of the rope from the vertical", "deg", 0.0, 0.1)


def _measured() -> Iterable[Variable]:
    units = {**{name: unit for name, unit, *_ in _MOTION_ROWS}, **_RATE_UNITS, "position": "m", "velocity": "m/s"}
    for name in FEEDBACK_INPUTS:
        quantity = name.removeprefix("measured.").split("[")[0]
        of = f"{quantity} of the load" if "[" in name else quantity
        yield Variable(
            name, "input", "continuous", f"measured {of}; all zero: no feedback", f"measured {quantity}",
            units[quantity], start=0.0,
        )  # fmt: skip


def _output(
    name: str,
    unit: str,
    text: str,
    display: str = "",
    minimum: float | None = None,
    nominal: float | None = None,
) -> Variable:
    return Variable(name, "output", "continuous", text, f"channel {name}", unit, display, None, minimum, None, nominal)


def _number(
    name: str,
    unit: str,
    start: float,
    text: str,
    lowest: float | None = 0.0,
    highest: float | None = None,
    change: Variability = "tunable",
) -> Variable:
    return Variable(
        name, "parameter", change, text, f"setting {name}", unit, start=start, minimum=lowest, maximum=highest
    )


def _text(name: str, choices: Sequence[str], text: str) -> Variable:
    described = f"{text}: {', '.join(choices)}"
    return Variable(name, "parameter", "fixed", described, f"setting {name}", start=choices[0], choices=tuple(choices))
