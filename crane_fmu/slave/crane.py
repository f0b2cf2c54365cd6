"""The slave of RotaryCrane.fmu: the inputs that move the load along a path, with feedback if the motion is measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from crane_fmu.slave.base import TableSlave, load_once, required
from crane_fmu.slave.checks import internal_steps, require_finite
from crane_fmu.slave.estimate import Sample, completed, contradiction, kept_samples
from crane_fmu.slave.feedback import Control, controlled
from crane_fmu.slave.interface import CRANE_PARAMETERS, DIMENSION, FEEDBACK_INPUTS, ORDERS, PLANT_FILE, program_file
from crane_fmu.slave.motion import SHORTEST_STEP, Snapshot, advance, begin, told
from crane_fmu.slave.paths import ROWS, Array, LoadPath, hermite, taylor
from crane_fmu.slave.quick import QuickStep, quick_step
from crane_fmu.slave.state import PlainState
from servocore import InvalidSetting, Plant, Program

_INPUTS = ROWS * DIMENSION
_NOTHING_TOLD = [0.0] * _INPUTS
_ACTUATORS = 3  # the first channels of a program, and the first outputs


@dataclass(frozen=True, eq=False)
class CraneState(PlainState):
    """The crane's motion, and what estimation, feedback and remarks remember.

    Attributes
    ----------
    motion : Snapshot
        The motion that belongs to the path.
    heard : sequence of float
        The path's inputs of the last step, empty before the first.
    samples : tuple of Sample
        For the estimation of derivatives.
    control : Control or None
        None while there is no feedback.
    gain : float
        Share of the feedback in the outputs.
    said : bool
        Whether contradicting inputs have been remarked upon.
    """

    motion: Snapshot
    heard: Sequence[float] = ()
    samples: tuple[Sample, ...] = ()
    control: Control | None = None
    gain: float = 0.0
    said: bool = False

    @property
    def time(self) -> float:
        """In s."""
        return self.motion.time

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> CraneState:
        """Undo `to_plain`."""
        return cls(
            Snapshot.from_plain(plain["motion"]),
            [float(each) for each in plain["heard"]],
            tuple((float(time), tuple(float(each) for each in value)) for time, value in plain["samples"]),
            None if plain["control"] is None else Control.from_plain(plain["control"]),
            float(plain["gain"]),
            bool(plain["said"]),
        )


class Slave(TableSlave):
    """Inputs of the rotary crane for a path of its load."""

    description = "Inverse dynamics of a rotary crane: bridge torque, trolley force and winch torque for a load path"
    state_type = CraneState

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._program: Program | None = None
        self._quick: QuickStep | None = None
        self._at_end = False
        self._order = ROWS - 1
        self._channels: list[int] = []
        self._numbers: list[int] = []
        first = self._interface.index(FEEDBACK_INPUTS[0])
        self._measured = slice(first, first + len(FEEDBACK_INPUTS))

    # --- start ----------------------------------------------------------------------------------------------------

    def _prepare(self) -> None:
        at_end = self._setting("input_time") == "end"
        order = ORDERS.index(self._setting("connected"))
        file = self._folder / program_file(self._setting("model"), self._setting("formulation"))
        program, quick = load_once(file, partial(_with_quick_step, library=file.with_suffix(".so")))
        names = [channel.name for channel in program.channels]
        self._channels = [names.index(self._interface.variables[k].name) for k in self._outputs]
        self._numbers = self._references(*program.parameters, "internal_step", "feedback")
        self._at_end, self._order, self._parameters = at_end, order, None
        self._program, self._quick = program, quick

    def _begin(self, time: float) -> CraneState:
        program, heard = required(self._program), self._finite_inputs(_INPUTS, time)
        samples = kept_samples((), time, self._highest(heard), self._order) if self._order < ROWS - 1 else ()
        return CraneState(begin(program, self._connected(heard), self._required_parameters()[0], time), (), samples)

    def _fits(self, state: CraneState) -> bool:
        program, motion = required(self._program), state.motion
        sizes = motion.state.size, motion.jet.shape, motion.values.size
        return sizes == (program.state_size, (ROWS, DIMENSION), len(program.channels))

    # --- steps ----------------------------------------------------------------------------------------------------

    def _advance(self, now: CraneState, h: float) -> CraneState:
        program, motion = required(self._program), now.motion
        p, internal_step, gain = self._required_parameters()
        time = motion.time + h if self._at_end else motion.time
        heard = self._finite_inputs(_INPUTS, time)
        if not now.heard and heard == _NOTHING_TOLD:  # some masters pass connected values on after the first step only
            heard = motion.jet.ravel().tolist()
        said = now.said or self._remarked(now.heard, heard, time)
        jet, samples = heard, now.samples
        if self._order < ROWS - 1:
            samples = kept_samples(samples, time, self._highest(heard), self._order) if h >= SHORTEST_STEP else samples
            jet = completed(samples, self._connected(heard), self._order, h).ravel().tolist()
        count = internal_steps(internal_step, h)
        quick = self._quick if count == 1 else None
        usual = quick(motion, jet, 0.0 if self._at_end else h, h, p) if quick else None
        after = usual or self._unusual_step(motion, program, _matrix(jet), h, count, p)
        control = self._feedback(now, jet, p, h, after.time) if gain > 0.0 else None
        state = object.__new__(CraneState)  # see `quick`: its own way takes three times as long
        state.__dict__.update(motion=after, heard=heard, samples=samples, control=control, gain=gain, said=said)
        return state

    def _unusual_step(self, now: Snapshot, program: Program, jet: Array, h: float, count: int, p: Array) -> Snapshot:
        """Take a step that is the first, has another size, is divided, or is to be refused with a sentence."""
        path: LoadPath
        if not self._at_end:
            now = told(program, now, jet, p)
            path = partial(taylor, jet)
        elif count == 1 and program.nodes == (1.0,):
            path = lambda _: jet  # noqa: E731
        else:
            path = hermite(now.jet, jet, h)
        return advance(program, now, path, h, count, p)

    def _feedback(self, now: CraneState, jet: Sequence[float], p: Array, h: float, end: float) -> Control | None:
        """Return the feedback for the next step, or None while no motion is measured: a rope has a length."""
        measured = self._reals[self._measured]
        if not any(measured):
            return None
        require_finite(measured, self._interface.variables[self._measured], end - h)
        if not (measured[2] > 0.0 and measured[8] < 0.0):
            raise InvalidSetting(
                f"at t = {end - h:.6g} s the measured rope length is {measured[2]:g} m and the measured height of the"
                f" load {measured[8]:g} m: the feedback needs the length above 0 m, the height below 0 m and all"
                f" measured values connected; feedback = 0 does without"
            )
        plant = load_once(self._folder / PLANT_FILE, Plant.from_json)
        motion = now.motion
        present = motion.jet if self._at_end else _matrix(jet)
        values = dict(zip(required(self._program).parameters, p, strict=True))
        own = np.array([values[name] for name in CRANE_PARAMETERS])
        inputs = motion.values[self._channels[:_ACTUATORS]]
        return controlled(plant, own, present, inputs, np.array(measured), h, now.control)

    def _remarked(self, before: Sequence[float], now: Sequence[float], time: float) -> bool:
        """Tell once if the path moves where the derivatives that should be connected say that it does not."""
        if not before or before == now:
            return False
        found = contradiction(before, now, self._order)
        if found:
            self.remark(f"at t = {time:.6g} s {found}")
        return bool(found)

    def _output_values(self, state: CraneState) -> list[float]:
        values = state.motion.values.tolist()
        outputs: list[float] = [values[channel] for channel in self._channels]
        if state.control is not None:
            for k in range(_ACTUATORS):
                outputs[k] += state.gain * float(state.control.now[k])
        return outputs

    # --- what the variables say ----------------------------------------------------------------------------------

    def _highest(self, heard: Sequence[float]) -> tuple[float, ...]:
        return tuple(heard[DIMENSION * self._order : DIMENSION * (self._order + 1)])

    def _connected(self, heard: Sequence[float]) -> Array:
        """Return the inputs as a jet without what is not connected."""
        jet = _matrix(heard)
        jet[self._order + 1 :] = 0.0
        return jet

    def _required_parameters(self) -> tuple[Array, float, float]:
        """Return the program's parameters, the internal step and the feedback, checked when they have changed."""
        if self._parameters is None:
            values = self._checked(self._numbers)
            self._parameters = np.array(values[:-2]), values[-2], values[-1]
        found: tuple[Array, float, float] = self._parameters
        return found


def _with_quick_step(text: str, library: Path) -> tuple[Program, QuickStep | None]:
    """Return a saved program with its quick step: both are made once in a process, for all instances."""
    program = Program.from_json(text)
    return program, quick_step(program, library)


def _matrix(jet: Sequence[float]) -> Array:
    return np.array(jet, dtype=float).reshape(ROWS, DIMENSION)
