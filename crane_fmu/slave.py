"""The crane as an FMI 2.0 co-simulation slave on PythonFMU.

What a host can do wrong is answered by one logged sentence and `fmi2Discard`; the slave is then as before and stays
usable. An exception that leaves a callback would be fatal to the host, memory included: every callback is guarded.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pythonfmu.default_experiment import DefaultExperiment
from pythonfmu.enums import Fmi2Causality, Fmi2Initial, Fmi2Status, Fmi2Variability
from pythonfmu.variables import Real, String

from crane_fmu.interface import DIMENSION, Interface, Variable
from crane_fmu.slave_checks import internal_steps, require_finite, require_legal, require_step
from crane_fmu.slave_guard import GuardedSlave, guarded, nothing
from crane_fmu.slave_motion import Snapshot, advance, begin, told
from crane_fmu.slave_paths import ROWS, Array, LoadPath, hermite, taylor
from crane_fmu.slave_quick import quick_step
from servocore import InvalidSetting, Program

INTERFACE_FILE = "interface.json"
_STATE_FORMAT = "rotary crane state 1"
_INSTANTIATED, _INITIALISING, _STEPPING, _TERMINATED = "instantiated", "initialising", "stepping", "terminated"
_BUNDLE = Path(__file__).parents[1].name
_INPUTS = ROWS * DIMENSION
_INPUT_REFERENCES = list(range(_INPUTS))


def program_file(model: str, formulation: str) -> str:
    """Name of the file with the compiled functions."""
    return f"{model}-{formulation}.json"


def _programs() -> Callable[[Path, str, str], Program]:
    """Return a loader that reads each program once in a process; they do not change."""
    loaded: dict[tuple[str, str], Program] = {}

    def load(folder: Path, model: str, formulation: str) -> Program:
        if (model, formulation) not in loaded:
            text = (folder / program_file(model, formulation)).read_text(encoding="utf-8")
            loaded[model, formulation] = Program.from_json(text)
        return loaded[model, formulation]

    return load


_load_program = _programs()


class CraneSlave(GuardedSlave):
    """Inputs of the rotary crane for a path of its load."""

    author = None
    description = "Inverse dynamics of a rotary crane: bridge torque, trolley force and winch torque for a load path"
    license = "MIT"

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._folder = Path(kwargs["resources"]) / _BUNDLE
        self._interface = Interface.from_json((self._folder / INTERFACE_FILE).read_text(encoding="utf-8"))
        self.guid = self._interface.guid
        self.default_experiment = DefaultExperiment(start_time=0.0, stop_time=20.0, step_size=0.1)
        variables = self._interface.variables
        self._outputs = [k for k, each in enumerate(variables) if each.causality == "output"]
        self._reals = [math.nan if each.is_text or each.start is None else float(each.start) for each in variables]
        self._texts = [str(each.start) if each.is_text else "" for each in variables]
        self._channels: list[int] = []
        self._phase = _INSTANTIATED
        self._stale = True  # outputs do not belong to the inputs: computed when leaving or reading
        self._failure = ""
        self._start_time = 0.0
        self._snapshot: Snapshot | None = None
        self._program: Program | None = None
        self._at_end = False
        self._numbers: list[int] = []
        self._parameters: tuple[Array, float] | None = None  # checked, or None
        for each in variables:
            self.register_variable(_registered(each), nested=False)

    # --- phases -------------------------------------------------------------------------------------------------

    @guarded(nothing)
    def setup_experiment(self, start_time: float, *_: float | None) -> None:
        """Take the start time; stop time and tolerance are of no use here."""
        self._require_phase("setupExperiment", _INSTANTIATED)
        self._start_time = float(start_time)

    @guarded(nothing)
    def enter_initialization_mode(self) -> None:
        """From now on outputs are computed when they are read."""
        self._require_phase("enterInitializationMode", _INSTANTIATED)
        self._phase = _INITIALISING
        self._stale = True

    @guarded(nothing)
    def exit_initialization_mode(self) -> None:
        """Compute the outputs at the start time; a failure is told again by every step."""
        self._require_phase("exitInitializationMode", _INITIALISING)
        self._phase = _STEPPING
        if self._stale:
            self._initialise()

    @guarded(nothing)
    def terminate(self) -> None:
        """Refuse further steps."""
        self._require_phase("terminate", _STEPPING)
        self._phase = _TERMINATED

    def _require_phase(self, call: str, phase: str) -> None:
        if self._phase != phase:
            raise InvalidSetting(f"{call} is ignored: the FMU is {self._phase}, not {phase}")

    def _initialise(self) -> None:
        self._stale = False
        self._snapshot = None
        try:
            if not math.isfinite(self._start_time):
                raise InvalidSetting(f"the start time must be a finite number, not {self._start_time} s")
            self._program = self._require_program()
            jet = _matrix(self._required_jet(self._start_time))
            p, _ = self._required_parameters()
            self._adopt(begin(self._program, jet, p, self._start_time))
            self._failure = ""
        except BaseException as error:
            self._failure = f"the initialisation failed: {error}"
            for k in self._outputs:
                self._reals[k] = math.nan
            raise InvalidSetting(self._failure) from error

    # --- steps --------------------------------------------------------------------------------------------------

    @guarded(lambda *_: False)
    def do_step(self, current_time: float, step_size: float) -> bool:
        """Compute the outputs at `current_time` + `step_size`; False leaves everything as it was."""
        now, program = self._ready()
        require_step(now.time, current_time, step_size)
        p, internal_step = self._required_parameters()
        jet = self._required_jet(current_time + step_size if self._at_end else current_time)
        count = internal_steps(internal_step, step_size)
        quick = quick_step(program) if count == 1 else None
        usual = quick(now, jet, 0.0 if self._at_end else step_size, step_size, p) if quick else None
        self._adopt(usual or self._unusual_step(now, program, _matrix(jet), step_size, count, p))
        return True

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

    def _ready(self) -> tuple[Snapshot, Program]:
        if self._phase != _STEPPING:
            raise InvalidSetting(f"doStep needs a finished initialisation, but the FMU is {self._phase}")
        if self._snapshot is None or self._program is None:
            raise InvalidSetting(self._failure or "the FMU has no state to step from")
        return self._snapshot, self._program

    def _adopt(self, snapshot: Snapshot) -> None:
        """Make a snapshot the present; the only place where outputs change."""
        self._snapshot = snapshot
        values = snapshot.values.tolist()
        for k, channel in zip(self._outputs, self._channels, strict=True):
            self._reals[k] = values[channel]

    # --- what the variables say ----------------------------------------------------------------------------------

    def _setting(self, name: str) -> str:
        k = self._interface.index(name)
        require_legal(self._interface.variables[k], self._texts[k])
        return self._texts[k]

    def _require_program(self) -> Program:
        at_end = self._setting("input_time") == "end"
        program = _load_program(self._folder, self._setting("model"), self._setting("formulation"))
        names = [channel.name for channel in program.channels]
        self._channels = [names.index(self._interface.variables[k].name) for k in self._outputs]
        self._numbers = [self._interface.index(name) for name in (*program.parameters, "internal_step")]
        self._at_end, self._parameters = at_end, None
        return program

    def _required_jet(self, time: float) -> list[float]:
        inputs = self._reals[:_INPUTS]
        require_finite(inputs, self._interface.variables, time)
        return inputs

    def _required_parameters(self) -> tuple[Array, float]:
        """Return the program's parameters and the internal step, checked when they have changed."""
        if self._parameters is None:
            values = [self._reals[k] for k in self._numbers]
            for k, value in zip(self._numbers, values, strict=True):
                require_legal(self._interface.variables[k], value)
            self._parameters = np.array(values[:-1]), values[-1]
        return self._parameters

    # --- setters and getters --------------------------------------------------------------------------------------

    @guarded(nothing)
    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Take inputs and parameters; what they are worth is judged when they are used."""
        reals = self._reals
        self._stale = True
        if vrs == _INPUT_REFERENCES:
            reals[:_INPUTS] = values
            return
        for vr, value in zip(vrs, values, strict=True):
            if 0 <= vr < _INPUTS:
                reals[vr] = value
            elif self._settable(vr, text=False):
                reals[vr] = value
                self._parameters = None

    @guarded(nothing)
    def set_string(self, vrs: list[int], values: list[str]) -> None:
        """Take settings."""
        for vr, value in zip(vrs, values, strict=True):
            if self._settable(vr, text=True):
                self._texts[vr] = str(value)
        self._stale = True

    def _settable(self, vr: int, *, text: bool) -> bool:
        if not self._known(vr):
            return False
        variable = self._interface.variables[vr]
        late = variable.variability == "fixed" and self._phase in (_STEPPING, _TERMINATED)
        if late or variable.causality == "output" or variable.is_text != text:
            reason = "cannot change after the initialisation" if late else "cannot be set as such"
            self.log(f"{variable.name} {reason}; the new value is ignored", Fmi2Status.warning)
            return False
        return True

    def _known(self, vr: int) -> bool:
        """Return whether a value reference is in the table; the host's unsigned numbers may arrive negative."""
        known = 0 <= vr < len(self._reals)
        if not known:
            self.log(f"there is no variable with the value reference {vr % 2**32}; it is ignored", Fmi2Status.warning)
        return known

    @guarded(lambda vrs: [math.nan] * len(vrs))
    def get_real(self, vrs: list[int]) -> list[float]:
        """Return values; during initialisation the outputs follow the inputs set so far."""
        if self._phase == _INITIALISING and self._stale:
            try:
                self._initialise()
            except BaseException as error:  # the outputs are not numbers then; the inputs still are
                self.report_error("get_real", error)
        reals = self._reals
        if vrs and min(vrs) >= 0 and max(vrs) < len(reals):
            return [reals[vr] for vr in vrs]
        return [reals[vr] if self._known(vr) else math.nan for vr in vrs]

    @guarded(lambda vrs: [""] * len(vrs))
    def get_string(self, vrs: list[int]) -> list[str]:
        """Return settings."""
        return [self._texts[vr] if self._known(vr) else "" for vr in vrs]

    # --- state ----------------------------------------------------------------------------------------------------

    @guarded(lambda: {})
    def _get_fmu_state(self) -> dict[str, Any]:
        snapshot = self._snapshot
        return {
            "format": _STATE_FORMAT,
            "guid": self.guid,
            "phase": self._phase,
            "stale": self._stale,
            "failure": self._failure,
            "start_time": self._start_time,
            "reals": list(self._reals),
            "texts": list(self._texts),
            "snapshot": None if snapshot is None else snapshot.to_plain(),
        }

    @guarded(nothing)
    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        if state.get("format") != _STATE_FORMAT or state.get("guid") != self.guid:
            raise InvalidSetting("the state to restore is not one of this FMU; nothing was changed")
        snapshot = None if state["snapshot"] is None else Snapshot.from_plain(state["snapshot"])
        reals, texts = [float(each) for each in state["reals"]], [str(each) for each in state["texts"]]
        if (len(reals), len(texts)) != (len(self._reals), len(self._texts)):
            raise InvalidSetting("the state to restore is damaged; nothing was changed")
        phase, stale, failure = str(state["phase"]), bool(state["stale"]), str(state["failure"])
        start_time = float(state["start_time"])
        before = self._texts
        self._texts = texts
        try:
            program = None if snapshot is None else self._require_program()
            if snapshot is not None and program is not None and not snapshot.fits(program):
                raise InvalidSetting("the state to restore is damaged; nothing was changed")
        except BaseException:
            self._texts = before
            if self._program is not None:
                self._require_program()
            raise
        self._program = program
        self._reals, self._snapshot, self._parameters = reals, snapshot, None
        self._phase, self._stale, self._failure, self._start_time = phase, stale, failure, start_time

    @staticmethod
    def _fmu_state_to_bytes(state: dict[str, Any]) -> bytes:
        return json.dumps(state).encode()

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> dict[str, Any]:
        try:
            found = json.loads(state.decode())
        except ValueError:
            return {}
        return found if isinstance(found, dict) else {}


def _matrix(jet: list[float]) -> Array:
    return np.array(jet).reshape(ROWS, DIMENSION)


def _registered(variable: Variable) -> Any:
    """Return PythonFMU's object for a row of the table."""
    kind = String if variable.is_text else Real
    return kind(
        variable.name,
        causality=Fmi2Causality[variable.causality],
        variability=Fmi2Variability[variable.variability],
        initial=Fmi2Initial.calculated if variable.causality == "output" else None,
        description=variable.description,
        getter=nothing,
        setter=nothing,
    )
