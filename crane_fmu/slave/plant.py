"""The slave of CranePlant.fmu: where the crane goes under its inputs, by Runge-Kutta steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crane_fmu.slave.base import TableSlave, load_once, required
from crane_fmu.slave.checks import internal_steps
from crane_fmu.slave.interface import CRANE_PARAMETERS, DIMENSION, PLANT_FILE, START_ORDERS, components
from crane_fmu.slave.paths import Array
from crane_fmu.slave.saved_state import PlainState
from servocore import IntegrationFailed, InvalidReference, Plant

SMALLEST_RADIUS = 1e-3
_INPUTS = 3


@dataclass(frozen=True, eq=False)
class PlantState(PlainState):
    """The crane at an instant.

    Attributes
    ----------
    time : float
        In s.
    state : ndarray, shape (10,)
        phi, s, l, two swing angles, and their rates.
    released : bool
        False while the brakes hold.
    inputs : ndarray, shape (3,)
        Of the last step.
    last_step : float
        Its length in s; 0 if there is none to continue the inputs from.
    acting : ndarray, shape (3,)
        Inputs at `time`, continued.
    stepped : bool
        Whether a step has been taken.
    """

    time: float
    state: Array
    released: bool
    inputs: Array
    last_step: float
    acting: Array
    stepped: bool


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Parameters that may change between steps: the crane's own, wind, gust, and the longest step of the solver."""

    p: Array
    wind: Array
    gust: Array
    gust_start: float
    gust_end: float
    longest: float

    def force(self, time: float) -> Array:
        """Return the force on the load just after `time`."""
        return self.wind + self.gust if self.gust_start <= time < self.gust_end else self.wind


class Slave(TableSlave):
    """Forward dynamics of the crane."""

    description = "Forward dynamics of a rotary crane: where bridge, trolley, winch and load go under their inputs"
    state_type = PlantState

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._plant: Plant | None = None
        self._at_end = self._held = self._brakes = False
        self._own = self._references(*CRANE_PARAMETERS, "mass_error")
        self._weather = self._references(*components("wind", "gust"), "gust_start", "gust_duration", "internal_step")
        start = components(*(f"start.{order}" for order in START_ORDERS))
        self._initial = self._references(*start, "start.swing[1]", "start.swing[2]", "gravity")

    # --- start ----------------------------------------------------------------------------------------------------

    def _prepare(self) -> None:
        self._at_end = self._setting("input_time") == "end"
        self._held = self._setting("hold") == "zero_order"
        self._brakes = self._setting("brakes") == "until_inputs"
        self._plant = load_once(self._folder / PLANT_FILE, Plant.from_json)

    def _begin(self, time: float) -> PlantState:
        start = self._checked(self._initial)
        *numbers, swing_in, swing_out, gravity = start
        motion = np.array(numbers).reshape(len(START_ORDERS), DIMENSION)
        state = _in_motion(motion, gravity, f"at t = {time:.6g} s")
        state[3:5] += swing_in, swing_out
        u = np.array(self._finite_inputs(_INPUTS, time))
        # One that starts in motion has open brakes: they keep velocities as they are, and would stop nothing.
        released = bool(u.any()) or bool(motion[1:].any()) or not self._brakes
        found = PlantState(time, state, released, u, 0.0, u, stepped=False)
        self._require_well(found)
        return found

    def _fits(self, state: PlantState) -> bool:
        return (state.state.shape, state.inputs.shape, state.acting.shape) == ((10,), (3,), (3,))

    # --- steps ----------------------------------------------------------------------------------------------------

    def _advance(self, now: PlantState, h: float) -> PlantState:
        u = np.array(self._finite_inputs(_INPUTS, now.time + h if self._at_end else now.time))
        if self._brakes and not (now.stepped or u.any()):
            u = now.inputs  # some masters pass connected values on after the first step only
        around, end = self._surroundings(), now.time + h
        if now.released or u.any():
            begin, slope = self._reconstructed(now, u, h)
            state = self._integrated(now.state, now.time, h, begin, slope, around)
            after = PlantState(end, state, True, u, 0.0 if self._held else h, begin + slope * h, stepped=True)
        else:
            state = self._integrated(now.state, now.time, h, None, u, around)
            after = PlantState(end, state, False, u, 0.0, u, stepped=True)
        if not np.isfinite(after.state).all():
            raise IntegrationFailed(
                f"the step from t = {now.time:.6g} s to {end:.6g} s has no finite result: the inputs are too large, or"
                f" internal_step is"
            )
        self._require_well(after)
        return after

    def _reconstructed(self, now: PlantState, u: Array, h: float) -> tuple[Array, Array]:
        """Return inputs at the start of the step and their rate of change."""
        if self._held or not now.released:
            return u, np.zeros(_INPUTS)
        if self._at_end:
            return now.inputs, (u - now.inputs) / h
        return u, (u - now.inputs) / now.last_step if now.last_step else np.zeros(_INPUTS)

    def _integrated(
        self, state: Array, time: float, h: float, u: Array | None, slope: Array, around: Surroundings
    ) -> Array:
        """Integrate over a step, divided where the gust begins and ends; u is None while the brakes hold."""
        plant, end = required(self._plant), time + h
        edges = [each for each in (around.gust_start, around.gust_end) if time < each < end]
        for begin, finish in zip([time, *edges], [*edges, end], strict=True):
            count = internal_steps(around.longest, finish - begin) if finish - begin > around.longest else 1
            step, force = (finish - begin) / count, around.force(begin)
            for k in range(count):
                if u is None:
                    state = plant.advance_held(state, force, around.p, step)
                else:
                    elapsed = begin - time + k * step
                    state = plant.advance(state, u + slope * elapsed, slope, force, around.p, step)
        return state

    # --- outputs ---------------------------------------------------------------------------------------------------

    def _values(self, now: PlantState) -> dict[str, float]:
        around = self._surroundings()
        force = around.force(now.time)
        values = required(self._plant).values(now.state, now.acting if now.released else None, force, around.p)
        for k, axis in enumerate("xyz", start=1):
            values[f"load.position[{k}]"], values[f"load.velocity[{k}]"] = values[axis], values[f"{axis}_dot"]
        return values

    def _require_well(self, now: PlantState) -> None:
        values = self._values(now)
        when = f"at t = {now.time:.6g} s"
        for name, value in values.items():
            if not math.isfinite(value):
                raise IntegrationFailed(f"{when} {name} is {value:g}, not a finite number")
        if not values["s"] > SMALLEST_RADIUS:
            raise InvalidReference(
                f"{when} the trolley reaches the slewing axis: s is {values['s']:.4g} m, it must stay above"
                f" {SMALLEST_RADIUS:g} m"
            )
        if not (values["z"] < 0.0 and values["l"] > 0.0):
            raise InvalidReference(
                f"{when} the load is not below the girder: z is {values['z']:.4g} m, it must stay below 0 m"
            )
        if not values["tension"] > 0.0:
            raise InvalidReference(
                f"{when} the rope goes slack: its tension is {values['tension']:.4g} N, it must stay above 0 N"
            )

    def _output_values(self, state: PlantState) -> Sequence[float]:
        values = self._values(state)
        return [values[self._interface.variables[k].name] for k in self._outputs]

    # --- what the variables say ----------------------------------------------------------------------------------

    def _surroundings(self) -> Surroundings:
        """Return what parameters say, checked when they have changed."""
        if self._parameters is None:
            *crane, error = self._checked(self._own)
            *forces, gust_start, duration, longest = self._checked(self._weather)
            crane[2] *= 1.0 + error
            wind, gust = np.array(forces[:3]), np.array(forces[3:])
            self._parameters = Surroundings(np.array(crane), wind, gust, gust_start, gust_start + duration, longest)
        found: Surroundings = self._parameters
        return found


def _in_motion(load: Array, gravity: float, when: str) -> Array:
    """Return the state of a crane whose load has a position, velocity, acceleration and jerk."""
    (x, y, z), v, (a_x, a_y, a_z), j = load
    lift = a_z + gravity
    if not lift > 0.0:
        raise InvalidReference(f"{when} the rope goes slack: g + z'' is {lift:.4g} m/s2, it must stay above 0 m/s2")
    if not z < 0.0:
        raise InvalidReference(
            f"{when} the load is not below the girder: the load's depth below the girder is {0.0 - z:.4g} m, it must"
            " stay above 0 m"
        )
    # The rope points along the load's acceleration less gravity, from the load up to the trolley at z = 0.
    lean, lean_rate = np.array([a_x, a_y]) / lift, (j[:2] - np.array([a_x, a_y]) / lift * j[2]) / lift
    p_x, p_y = x - z * lean[0], y - z * lean[1]
    rate_x, rate_y = v[:2] - v[2] * lean - z * lean_rate
    s = math.hypot(p_x, p_y)
    if not s > SMALLEST_RADIUS:
        raise InvalidReference(
            f"{when} the trolley reaches the slewing axis: the trolley's distance from the slewing axis is {s:.4g} m,"
            f" it must stay above {SMALLEST_RADIUS:g} m"
        )
    along, turning = (p_x * rate_x + p_y * rate_y) / s, (p_x * rate_y - p_y * rate_x) / s**2
    # In the bridge's frame: how far the rope leans outwards and sidewards a metre down, and how fast that changes.
    cos, sin = p_x / s, p_y / s
    turn = np.array([[-cos, -sin], [sin, -cos]])  # the load is on the other side of the trolley than the lean
    (out, side), (out_rate, side_rate) = turn @ lean, turn @ lean_rate
    out_rate, side_rate = out_rate + turning * side, side_rate - turning * out
    inner, long = math.hypot(1.0, out), math.hypot(1.0, out, side)
    swing_in, swing_out = math.atan(out), math.atan2(side, inner)
    swing_in_rate = out_rate / inner**2
    swing_out_rate = (side_rate * inner - side * out * out_rate / inner) / long**2
    rope_rate = -v[2] * long - z * (out * out_rate + side * side_rate) / long
    place = [math.atan2(p_y, p_x), s, -z * long, swing_in, swing_out]
    return np.array([*place, turning, along, rope_rate, swing_in_rate, swing_out_rate])
