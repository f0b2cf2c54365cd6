"""The slave of RotaryCrane.fmu: the inputs that move the load along a path, with feedback if the motion is measured."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from crane_fmu.slave.base import TableSlave, load_once, required
from crane_fmu.slave.carried_functions import carried
from crane_fmu.slave.checks import internal_steps, require_finite
from crane_fmu.slave.estimate import Estimation, contradiction, estimation, in_motion, too_rough
from crane_fmu.slave.feedback import Feedback, fastest_pendulum, feedbacks
from crane_fmu.slave.interface import (
    CRANE_PARAMETERS,
    DIMENSION,
    FEEDBACK_FILE,
    FEEDBACK_INPUTS,
    LARGEST_TURN,
    ORDERS,
    program_file,
)
from crane_fmu.slave.motion import Snapshot, advance, begin, with_path
from crane_fmu.slave.paths import ROWS, Array, LoadPath, hermite, taylor
from crane_fmu.slave.quick_step import QuickStep, quick_step
from crane_fmu.slave.saved_state import PlainState
from servocore import InvalidReference, InvalidSetting, Program

_INPUTS = ROWS * DIMENSION
_NO_PATH = [0.0] * _INPUTS
_ACTUATORS = 3  # the first outputs are theirs
_SETTING_NAMES = ("internal_step", "feedback", "feedback_distance", "limit.M_b", "limit.F", "limit.M_w")
_SETTINGS = len(_SETTING_NAMES)


@dataclass(frozen=True, eq=False)
class CraneState(PlainState):
    """The crane's motion, and what estimation, feedback and remarks remember.

    Attributes
    ----------
    motion : Snapshot
        The motion that belongs to the path.
    forces : ndarray, shape (3,)
        Inputs of the crane: those of the motion, with feedback, within limits.
    path_inputs : sequence of float
        The path's inputs of the last step, empty before the first.
    samples : ndarray or None
        Memory of the estimation of derivatives; None where nothing is estimated.
    peak : float
        Largest |M_b| since derivatives are known, in N.m.
    memory : ndarray or None
        Of the feedback; None while there is none.
    is_far : bool
        Whether the feedback is left out because the load is too far from its path.
    is_odd : bool
        Whether the inputs of the last step contradicted each other.
    said : tuple of str
        What has been remarked upon.
    """

    motion: Snapshot
    forces: Array
    path_inputs: Sequence[float] = ()
    samples: Array | None = None
    peak: float = 0.0
    memory: Array | None = None
    is_far: bool = False
    is_odd: bool = False
    said: tuple[str, ...] = ()

    @property
    def time(self) -> float:
        """In s."""
        return self.motion.time

    def at(self, time: float) -> CraneState:
        """Return the same by another clock."""
        return replace(self, motion=self.motion.at(time))

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> CraneState:
        """Undo `to_plain`."""
        return cls(
            motion=Snapshot.from_plain(plain["motion"]),
            forces=np.array(plain["forces"], dtype=float),
            path_inputs=[float(each) for each in plain["path_inputs"]],
            samples=None if plain["samples"] is None else np.array(plain["samples"], dtype=float),
            peak=float(plain["peak"]),
            memory=None if plain["memory"] is None else np.array(plain["memory"], dtype=float),
            is_far=bool(plain["is_far"]),
            is_odd=bool(plain["is_odd"]),
            said=tuple(str(each) for each in plain["said"]),
        )


@dataclass(frozen=True, eq=False)
class Settings:
    """What parameters say: those of the program and of the crane, step, share, distance and limits of the feedback."""

    p: Array
    own: Array
    internal_step: float
    share: float
    distance: float
    limits: Array


class Slave(TableSlave):
    """Inputs of the rotary crane for a path of its load."""

    description = "Inverse dynamics of a rotary crane: bridge torque, trolley force and winch torque for a load path"
    state_type = CraneState

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._program: Program | None = None
        self._quick: QuickStep | None = None
        self._law: Feedback | None = None
        self._estimation: Estimation | None = None
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
        self._numbers = self._references(*program.parameters, *_SETTING_NAMES)
        text = self._folder / FEEDBACK_FILE
        laws, self._estimation = load_once(text, partial(_laws, library=text.with_suffix(".so")))
        self._law = laws[self._setting("input_time")]
        self._at_end, self._order, self._parameters = at_end, order, None
        self._program, self._quick = program, quick

    def _begin(self, time: float) -> CraneState:
        program, inputs = required(self._program), self._finite_inputs(_INPUTS, time)
        self._finite_measured(time)
        begin_estimates = required(self._estimation).begin
        samples = begin_estimates(inputs, self._order)[0] if self._order < ROWS - 1 else None
        settings = self._required_parameters()
        motion = begin(program, self._connected(inputs), settings.p, time)
        return CraneState(motion, self._limited(motion, settings), samples=samples)

    def _fits(self, state: CraneState) -> bool:
        program, motion = required(self._program), state.motion
        sizes = motion.state.size, motion.jet.shape, motion.values.size, state.forces.shape
        right = (program.state_size, (ROWS, DIMENSION), len(program.channels), (_ACTUATORS,))
        none, samples = self._order == ROWS - 1, state.samples
        estimates = none if samples is None else not none and samples.size == required(self._estimation).size
        return estimates and sizes == right and (state.memory is None or state.memory.size == required(self._law).size)

    # --- steps ----------------------------------------------------------------------------------------------------

    def _advance(self, now: CraneState, h: float) -> CraneState:
        program, motion = required(self._program), now.motion
        settings = self._required_parameters()
        time = motion.time + h if self._at_end else motion.time
        inputs = self._finite_inputs(_INPUTS, time)
        # Some masters pass connected values on after the first step only.
        if not now.path_inputs and inputs == _NO_PATH:
            inputs = motion.jet.ravel().tolist()
        said, is_odd = self._contradicted(now, inputs, time)
        jet, samples, doubt = inputs, now.samples, None
        if samples is not None:
            follow = required(self._estimation).follow
            samples, estimate, error, known = follow(samples, inputs, h, float(self._at_end), self._order)
            jet, doubt = estimate.tolist(), error.item() if known.item() else math.inf
        count = internal_steps(settings.internal_step, h)
        quick = self._quick if count == 1 else None
        usual = quick(motion, jet, 0.0 if self._at_end else h, h, settings.p) if quick else None
        after = usual or self._unusual_step(motion, program, _matrix(jet), h, count, settings.p)
        forces, peak = self._limited(after, settings), now.peak
        if doubt is not None:
            peak, said = self._doubted(doubt, after, peak, said, time)
        memory, is_far = None, now.is_far
        if any(self._finite_measured(motion.time)) and settings.share > 0.0:
            forces, memory, is_far, said = self._with_feedback(now, after, jet, h, settings, forces, said)
        state = object.__new__(CraneState)  # see `quick_step`: its own way takes three times as long
        state.__dict__.update(
            motion=after, forces=forces, path_inputs=inputs, samples=samples, peak=peak, memory=memory, is_far=is_far,
            is_odd=is_odd, said=said,
        )  # fmt: skip
        return state

    def _finite_measured(self, time: float) -> Sequence[float]:
        """Return what is measured, all zero if it is not connected; refuse what is not finite."""
        measured: Sequence[float] = self._reals[self._measured]
        require_finite(measured, self._interface.variables[self._measured], time)
        return measured

    def _doubted(
        self, error: float, after: Snapshot, peak: float, said: tuple[str, ...], time: float
    ) -> tuple[float, tuple[str, ...]]:
        """Return the peak of M_b, and tell once when what is estimated does not determine it well."""
        if math.isinf(error):
            return peak, self._told(said, "motion", time, in_motion(self._order))
        own, values = self._required_parameters().own, after.values[self._channels]
        worth = required(self._estimation).worth
        peak, wrong, least = worth(error, after.jet.ravel(), values, own, peak)[0].tolist()
        if wrong > least:
            said = self._told(said, "samples", time, too_rough(self._order) % (error, wrong, peak))
        return peak, said

    def _unusual_step(self, now: Snapshot, program: Program, jet: Array, h: float, count: int, p: Array) -> Snapshot:
        """Take a step that is the first, has another size, is divided, or is to be refused with a sentence."""
        path: LoadPath
        if not self._at_end:
            now = with_path(program, now, jet, p)
            path = partial(taylor, jet)
        elif count == 1 and program.nodes == (1.0,):
            path = lambda _: jet  # noqa: E731
        else:
            path = hermite(now.jet, jet, h)
        return advance(program, now, path, h, count, p)

    def _with_feedback(
        self, now: CraneState, after: Snapshot, jet: Sequence[float], h: float, settings: Settings, forces: Array,
        said: tuple[str, ...],
    ) -> tuple[Array, Array | None, bool, tuple[str, ...]]:  # fmt: skip
        """Return inputs, memory, whether the load is far from its path, and what has been said."""
        time, measured = now.motion.time, self._reals[self._measured]
        if not (measured[2] > 0.0 and measured[8] < 0.0):
            raise InvalidSetting(
                f"at t = {time:.6g} s the measured rope length is {measured[2]:g} m and the measured height of the"
                f" load {measured[8]:g} m: the feedback needs the length above 0 m, the height below 0 m and all"
                f" measured values connected; feedback = 0 does without"
            )
        before = now.motion.jet.ravel().tolist() if self._at_end else jet
        off, own = math.dist(measured[6:9], before[:3]), settings.own
        is_far = off > (0.5 if now.is_far else 1.0) * settings.distance
        if is_far:
            said = self._told(
                said, "far", time, f"the measured load is {off:.3g} m from its path, more than feedback_distance ="
                f" {settings.distance:g} m: it is left to the feedforward until it is within half of that"
            )  # fmt: skip
            return forces, None, True, said
        rate = fastest_pendulum(own, measured[2], before[8])
        if rate * h > LARGEST_TURN:
            said = self._told(
                said, "step", time, f"the step of {h:g} s is too long for the feedback: with this load, trolley and"
                f" rope it may be {LARGEST_TURN / rate:.3g} s at most; the load is left to the feedforward"
            )  # fmt: skip
            return forces, None, False, said
        law = required(self._law)
        memory = law.begin(before, measured, own, h)[0] if now.memory is None else now.memory
        memory, found = law.follow(
            memory, jet, before, measured, now.forces, after.values[self._channels[:_ACTUATORS]], own, h,
            settings.share, settings.limits,
        )  # fmt: skip
        if not math.isfinite(memory.dot(memory) + found.dot(found)):
            said = self._told(said, "lost", time, "the feedback finds no inputs; the load is left to the feedforward")
            return forces, None, False, said
        return found, memory, False, said

    def _limited(self, motion: Snapshot, settings: Settings) -> Array:
        wanted, most = motion.values[self._channels[:_ACTUATORS]], settings.limits
        forces: Array = np.minimum(np.maximum(wanted, -most), most)  # `clip` takes three times as long
        return forces

    def _contradicted(self, now: CraneState, inputs: Sequence[float], time: float) -> tuple[tuple[str, ...], bool]:
        """Tell if the path moves where derivatives that should be connected say it does not; refuse a second step."""
        before = now.path_inputs
        found = contradiction(before, inputs, self._order) if before and before != inputs else ""
        if found and now.is_odd:
            raise InvalidReference(f"at t = {time:.6g} s {found}")
        if found:
            consequence = "; the outputs are those of a load that stands still, and the next such step is refused"
            return self._told(now.said, "path", time, found + consequence), True
        return now.said, False

    def _told(self, said: tuple[str, ...], topic: str, time: float, sentence: str) -> tuple[str, ...]:
        """Remark upon a topic unless that has been done, and return what has been said."""
        if topic in said:
            return said
        self.remark(f"at t = {time:.6g} s {sentence}")
        return (*said, topic)

    def _output_values(self, state: CraneState) -> list[float]:
        outputs: list[float] = state.motion.values[self._channels].tolist()
        outputs[:_ACTUATORS] = state.forces.tolist()
        return outputs

    # --- what the variables say ----------------------------------------------------------------------------------

    def _connected(self, inputs: Sequence[float]) -> Array:
        """Return the inputs as a jet without what is not connected."""
        jet = _matrix(inputs)
        jet[self._order + 1 :] = 0.0
        return jet

    def _required_parameters(self) -> Settings:
        """Return what parameters say, checked when they have changed."""
        if self._parameters is None:
            values = self._checked(self._numbers)
            p, (internal_step, share, distance, *limits) = values[:-_SETTINGS], values[-_SETTINGS:]
            named = dict(zip(required(self._program).parameters, p, strict=True))
            own = np.array([named[name] for name in CRANE_PARAMETERS])
            self._parameters = Settings(np.array(p), own, internal_step, share, distance, np.array(limits))
        found: Settings = self._parameters
        return found


def _with_quick_step(text: str, library: Path) -> tuple[Program, QuickStep | None]:
    """Return a saved program with its quick step: both are made once in a process, for all instances."""
    program = Program.from_json(text)
    return program, quick_step(program, library)


def _laws(text: str, library: Path) -> tuple[dict[str, Feedback], Estimation]:
    """Return feedback by input time, and estimation."""
    functions = carried(text, library)
    return feedbacks(functions), estimation(functions)


def _matrix(jet: Sequence[float]) -> Array:
    return np.array(jet, dtype=float).reshape(ROWS, DIMENSION)
