"""The tables of the FMUs' variables: the crane's inverse model, a load trajectory, the crane as a plant."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import servocore as sc
from crane_fmu.catalogue.choices import FORMULATIONS, MODELS
from crane_fmu.slave.interface import (
    FEEDBACK_INPUTS,
    FROM_FILE,
    INPUT_TIMES,
    ORDERS,
    REST,
    START_ORDERS,
    Causality,
    Interface,
    Variability,
    Variable,
    components,
)
from crane_fmu.slave.straight_lines import PROFILES, THREE_PHASE

_UNITS = {
    **dict(zip(ORDERS, ("m", "m/s", "m/s2", "m/s3", "m/s4"), strict=True)),
    **{"M_b": "N.m", "F": "N", "M_w": "N.m", "phi": "rad", "s": "m", "l": "m"},
    **{"phi_dot": "rad/s", "s_dot": "m/s", "l_dot": "m/s"},
}
"""Units of path, inputs, motion and rates, in tables of outputs as of measured values."""

_ZERO, _NO_LIMIT = (0.0, 0.0, 0.0), 1e9

_FORCES = (
    ("M_b", 1000.0, "slewing torque on the bridge, positive as phi"),
    ("F", 1000.0, "force on the trolley along the bridge, positive as s"),
    ("M_w", 100.0, "winch torque, positive where it pays out rope"),
)


def rotary_crane() -> Interface:
    """Return the table of the inverse model."""
    derivatives = tuple(reversed(ORDERS))
    rows = (
        *_path("input", "wanted of the load", REST),
        *(_output(name, _UNITS[name], text, nominal=size) for name, size, text in _FORCES),
        *_motion(),
        _output("tension", "N", "rope tension", "kN", 0.0, 1000.0),
        _output("swing", "rad", "angle of the rope from the vertical", "deg", 0.0, 0.1),
        *_crane_parameters(),
        _number("internal_step", "s", 0.0, "step of the method; a communication step takes the nearest whole number of"
                " them; 0: one"),
        _choice("model", MODELS, "model of the crane that is solved"),
        _choice("formulation", FORMULATIONS, "how the servo constraints enter the equations"),
        _choice("input_time", INPUT_TIMES, "instant of a communication step that its inputs belong to"),
        _choice("connected", derivatives, "highest derivative of the path that is connected; others are estimated"),
        *_measured(),
        _number("feedback", "1", 1.0, "share of the feedback in the outputs, where motion is measured", highest=1.0),
        _number("feedback_distance", "m", 0.5, "a load farther than this from its path is left to the feedforward",
                1e-3, 1e9),
        *(_number(f"limit.{name}", _UNITS[name], _NO_LIMIT, f"largest |{name}| that the drive gives", 1e-3, _NO_LIMIT)
          for name, _, _ in _FORCES),
    )  # fmt: skip
    return Interface(rows)


def load_trajectory() -> Interface:
    """Return the table of the load trajectory."""
    path = sc.scenes.rotary_crane().reference
    start, end = path.jet([path.start_time, path.end_time], 0)[:, 0].tolist()
    rows = (
        *_path("output", "of the load"),
        *_vector("start", "m", start, "start of the path, component"),
        *_vector("end", "m", end, "end of the path, component"),
        _number("duration", "s", path.duration, "time of the motion", 1e-3, 1e9, change="fixed"),
        _number("start_time", "s", 0.0, "when the motion starts; the load rests before", -1e9, 1e9, change="fixed"),
        _number("ramp", "s", 0.0, f"time to accelerate, for {THREE_PHASE}; 0: a quarter of the duration", 0.0, 1e9,
                change="fixed"),
        _choice("profile", (*PROFILES, FROM_FILE), "time law along the line, or a table"),
    )  # fmt: skip
    return Interface(rows)


def crane_plant() -> Interface:
    """Return the table of the plant."""
    rows = (
        *(
            Variable(name, "input", "continuous", text, _UNITS[name], start=0.0, nominal=size)
            for name, size, text in _FORCES
        ),
        *(
            _output(name, _UNITS[quantity], f"{quantity} of the load, component {axis}")
            for quantity in ("position", "velocity")
            for name, axis in _components(f"load.{quantity}")
        ),
        *_motion(),
        *(_output(f"{name}_dot", _UNITS[f"{name}_dot"], f"rate of {name}") for name in ("phi", "s", "l")),
        _output("swing_in", "rad", "swing in the bridge's plane, outwards", "deg"),
        _output("swing_out", "rad", "swing out of that plane", "deg"),
        _output("swing_in_dot", "rad/s", "rate of swing_in"),
        _output("swing_out_dot", "rad/s", "rate of swing_out"),
        _output("swing", "rad", "angle of the rope from the vertical", "deg"),
        _output("tension", "N", "rope tension", "kN", 0.0, 1000.0),
        _output("energy", "J", "kinetic and potential energy; zero at rest at the girder", "kJ", None, 1000.0),
        *_crane_parameters(),
        *_vector("start.position", "m", REST, "position of the load at the start,"),
        *(
            row
            for order in START_ORDERS[1:]
            for row in _vector(f"start.{order}", _UNITS[order], _ZERO, f"{order} of the load at the start,")
        ),
        _number("start.swing[1]", "rad", 0.0, "swing at the start in the bridge's plane, outwards", -1.5, 1.5, "fixed"),
        _number("start.swing[2]", "rad", 0.0, "swing at the start, out of that plane", -1.5, 1.5, "fixed"),
        _number("mass_error", "1", 0.0, "the load is heavier by this fraction of load_mass", -0.9, 10.0),
        *_vector("wind", "N", _ZERO, "constant force on the load,", "tunable"),
        *_vector("gust", "N", _ZERO, "force on the load during the gust,", "tunable"),
        _number("gust_start", "s", 0.0, "time at which the gust begins", -1e9, 1e9),
        _number("gust_duration", "s", 0.0, "time that the gust lasts", 0.0, 1e9),
        _number("internal_step", "s", 0.002, "longest step of the solver, Runge-Kutta of order four", 1e-6, 1.0),
        _choice("input_time", INPUT_TIMES, "instant of a communication step that its inputs belong to"),
        _choice("hold", ("first_order", "zero_order"), "how inputs go on between communication points"),
        _choice("brakes", ("until_inputs", "none"), "brakes hold the crane until an input is not zero"),
    )
    return Interface(rows)


# Rows that tables have in common -------------------------------------------------------------------------------------


def _path(causality: Causality, of: str, start: Sequence[float] | None = None) -> Iterator[Variable]:
    for quantity in ORDERS:
        for k, (name, axis) in enumerate(_components(f"load.{quantity}")):
            value = None if start is None else start[k] if quantity == "position" else 0.0
            yield Variable(
                name, causality, "continuous", f"{quantity} {of}, component {axis}", _UNITS[quantity], start=value
            )


def _motion() -> Iterator[Variable]:
    yield _output("phi", "rad", "bridge angle, continuous across full turns", "deg", None, 1.0)
    yield _output("s", "m", "distance of the trolley from the slewing axis", "", 0.0, 1.0)
    yield _output("l", "m", "rope length", "", 0.0, 1.0)


def _measured() -> Iterator[Variable]:
    for name in FEEDBACK_INPUTS:
        quantity = name.removeprefix("measured.").split("[")[0]
        of = f"{quantity} of the load" if "[" in name else quantity
        yield Variable(
            name, "input", "continuous", f"measured {of}; all zero: no feedback", _UNITS[quantity], start=0.0
        )


def _crane_parameters() -> Iterator[Variable]:
    for parameter in sc.scenes.rotary_crane().model().parameters.declared:
        yield Variable(
            name=parameter.name,
            causality="parameter",
            variability="fixed" if parameter.fixed else "tunable",
            description=parameter.description,
            unit=parameter.unit,
            start=parameter.default,
            minimum=parameter.lower,
            maximum=parameter.upper,
            nominal=parameter.default,
        )


# Rows ----------------------------------------------------------------------------------------------------------------


def _components(name: str) -> Iterator[tuple[str, str]]:
    """Yield the names of a vector's components with their axes."""
    return zip(components(name), "xyz", strict=True)


def _vector(
    name: str, unit: str, start: Sequence[float], text: str, change: Variability = "fixed"
) -> Iterator[Variable]:
    for (component, axis), value in zip(_components(name), start, strict=True):
        yield _number(component, unit, value, f"{text} {axis}", None, change=change)


def _output(
    name: str,
    unit: str,
    text: str,
    display: str = "",
    minimum: float | None = None,
    nominal: float | None = None,
) -> Variable:
    return Variable(name, "output", "continuous", text, unit, display, minimum=minimum, nominal=nominal)


def _number(
    name: str,
    unit: str,
    start: float,
    text: str,
    lowest: float | None = 0.0,
    highest: float | None = None,
    change: Variability = "tunable",
) -> Variable:
    return Variable(name, "parameter", change, text, unit, start=start, minimum=lowest, maximum=highest)


def _choice(name: str, choices: Iterable[str], text: str) -> Variable:
    names = tuple(choices)
    items = ", ".join(f"{k} {label}" for k, label in enumerate(names, start=1))
    return Variable(name, "parameter", "fixed", f"{text}: {items}", start=names[0], choices=names)
