"""An FMI 2.0 co-simulation slave made of a table of variables: phases, values, states; what it computes is left open.

What a host can do wrong is answered by one logged sentence and `fmi2Discard`; the slave is then as before and stays
usable. An exception that leaves a callback would be fatal to the host, memory included: every callback is guarded.
"""

from __future__ import annotations

import json
import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar

from pythonfmu.default_experiment import DefaultExperiment
from pythonfmu.enums import Fmi2Causality, Fmi2Initial, Fmi2Status, Fmi2Variability
from pythonfmu.variables import Integer, Real

from crane_fmu.slave.checks import chosen_item, require_duration, require_finite, require_legal, require_step
from crane_fmu.slave.guarded_callbacks import ONE_AT_A_TIME, GuardedSlave, guarded, nothing
from crane_fmu.slave.interface import INTERFACE_FILE, Interface
from servocore import InvalidSetting

_STATE_FORMAT = "servocore fmu state 3"
_INSTANTIATED, _INITIALIZING, _STEPPING, _TERMINATED = "instantiated", "initializing", "stepping", "terminated"
_DAMAGED = "the state to restore is damaged; nothing was changed"
_BUNDLE = Path(__file__).parents[2].name


_LOADED: dict[Path, Any] = {}
Found = TypeVar("Found")


def load_once(file: Path, read: Callable[[str], Found]) -> Found:
    """Return what `read` makes of a file's text, once in a process for all instances; the files do not change."""
    if file not in _LOADED:
        _LOADED[file] = read(file.read_text(encoding="utf-8"))
    found: Found = _LOADED[file]
    return found


class State(Protocol):
    """All that a slave knows at an instant; never changed in place."""

    @property
    def time(self) -> float:
        """In s."""

    def at(self, time: float) -> Self:
        """Return the same by another clock."""

    def to_plain(self) -> dict[str, Any]:
        """Return plain numbers, texts and lists."""

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Self:
        """Undo `to_plain`."""


def required(found: Found | None) -> Found:
    """Return what an initialization has made; raises `InvalidSetting` if there was none."""
    if found is None:
        raise InvalidSetting("the FMU is not initialized")
    return found


class TableSlave(GuardedSlave):
    """Phases, variables, refusals and states of an FMU; subclasses say what a start and a step are."""

    state_type: type[State]
    license = "MIT"

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._resources = Path(kwargs["resources"])
        self._folder = self._resources / _BUNDLE
        self._interface = load_once(self._folder / INTERFACE_FILE, Interface.from_json)
        self.guid = self._interface.guid
        self.default_experiment = DefaultExperiment(start_time=0.0, stop_time=20.0, step_size=0.05)
        variables = self._interface.variables
        self._outputs = [k for k, each in enumerate(variables) if each.causality == "output"]
        self._output_place = slice(self._outputs[0], self._outputs[-1] + 1)  # outputs follow each other in the table
        self._inputs = frozenset(k for k, each in enumerate(variables) if each.causality == "input")
        self._leading = next(k for k, each in enumerate(variables) if each.causality != "input")  # inputs come first
        self._leading_references = list(range(self._leading))
        self._reals = [math.nan if each.is_choice or each.start is None else float(each.start) for each in variables]
        self._items = [each.choices.index(str(each.start)) + 1 if each.is_choice else 0 for each in variables]
        self._phase = _INSTANTIATED
        self._stale = True  # outputs do not belong to the inputs: computed when leaving or reading
        self._failure = ""
        self._start_time, self._stop_time = 0.0, math.inf
        self._snapshot: State | None = None
        self._parameters: Any = None  # what a subclass made of parameters; None when one has changed
        for each in variables:
            variable = (Integer if each.is_choice else Real)(
                each.name,
                causality=Fmi2Causality[each.causality],
                variability=Fmi2Variability[each.variability],
                initial=Fmi2Initial.calculated if each.causality == "output" else None,
                description=each.description,
                getter=nothing,
                setter=nothing,
            )
            self.register_variable(variable, nested=False)

    # --- what a subclass computes ----------------------------------------------------------------------------------

    @abstractmethod
    def _prepare(self) -> None:
        """Make ready for the settings, which are fixed once the initialization is over."""

    @abstractmethod
    def _begin(self, time: float) -> State:
        """Return the state at the start."""

    @abstractmethod
    def _advance(self, now: Any, h: float) -> State:
        """Return the state h seconds later."""

    @abstractmethod
    def _output_values(self, state: Any) -> Sequence[float]:
        """Return the outputs of a state in the order of the table."""

    def remark(self, sentence: str) -> None:
        """Log something that is no reason to refuse a step."""
        self.log(sentence, Fmi2Status.warning)

    def _fits(self, state: Any) -> bool:  # noqa: ARG002
        """Return whether a restored state belongs to the settings restored with it."""
        return True

    # --- phases -------------------------------------------------------------------------------------------------

    @guarded(nothing)
    def setup_experiment(self, start_time: float, stop_time: float | None = None, *_: float | None) -> None:
        """Take start and stop time; a tolerance is of no use here."""
        self._require_phase("setupExperiment", _INSTANTIATED)
        self._start_time, self._stop_time = float(start_time), math.inf if stop_time is None else float(stop_time)

    @guarded(nothing)
    def enter_initialization_mode(self) -> None:
        """From now on outputs are computed when they are read."""
        self._require_phase("enterInitializationMode", _INSTANTIATED)
        self._phase = _INITIALIZING
        self._stale = True

    @guarded(nothing)
    def exit_initialization_mode(self) -> None:
        """Compute the outputs at the start time; a failure is told again by every step."""
        self._require_phase("exitInitializationMode", _INITIALIZING)
        self._phase = _STEPPING
        if self._stale:
            self._initialize()

    @guarded(nothing)
    def terminate(self) -> None:
        """Refuse further steps."""
        self._require_phase("terminate", _STEPPING)
        self._phase = _TERMINATED

    def _require_phase(self, call: str, phase: str) -> None:
        if self._phase != phase:
            raise InvalidSetting(f"{call} is ignored: the FMU is {self._phase}, not {phase}")

    def _initialize(self) -> None:
        self._stale = False
        self._snapshot = None
        try:
            if not math.isfinite(self._start_time):
                raise InvalidSetting(f"the start time must be a finite number, not {self._start_time} s")
            require_duration(self._start_time, self._stop_time)
            self._parameters = None
            with ONE_AT_A_TIME:
                self._prepare()
                self._adopt(self._begin(self._start_time))
            self._failure = ""
        except BaseException as error:
            self._failure = f"the initialization failed: {error}"
            for k in self._outputs:
                self._reals[k] = math.nan
            raise InvalidSetting(self._failure) from error

    @guarded(lambda *_: False)
    def do_step(self, current_time: float, step_size: float) -> bool:
        """Compute the outputs at `current_time` + `step_size`; False leaves everything as it was."""
        now = self._ready()
        require_step(now.time, current_time, step_size, self._stop_time)
        if current_time != now.time:
            now = now.at(current_time)
        with ONE_AT_A_TIME:
            self._adopt(self._advance(now, step_size))
        return True

    def _ready(self) -> State:
        if self._phase != _STEPPING:
            raise InvalidSetting(f"doStep needs a finished initialization, but the FMU is {self._phase}")
        if self._snapshot is None:
            raise InvalidSetting(self._failure or "the FMU has no state to step from")
        return self._snapshot

    def _adopt(self, snapshot: State) -> None:
        """Make a snapshot the present; the only place where outputs change."""
        values = self._output_values(snapshot)
        if len(values) != len(self._outputs):
            raise ValueError(f"{len(values)} values for {len(self._outputs)} outputs")
        self._snapshot = snapshot
        self._reals[self._output_place] = values

    # --- what the variables say ----------------------------------------------------------------------------------

    def _setting(self, name: str) -> str:
        k = self._interface.index(name)
        return chosen_item(self._interface.variables[k], self._items[k])

    def _checked(self, references: Sequence[int]) -> list[float]:
        """Return numbers after a look at their ranges."""
        values = [self._reals[k] for k in references]
        for k, value in zip(references, values, strict=True):
            require_legal(self._interface.variables[k], value)
        return values

    def _finite_inputs(self, count: int, time: float) -> list[float]:
        """Return the first inputs of the table, which shall be those of an instant."""
        inputs = self._reals[:count]
        require_finite(inputs, self._interface.variables, time)
        return inputs

    def _references(self, *names: str) -> list[int]:
        return [self._interface.index(name) for name in names]

    # --- setters and getters --------------------------------------------------------------------------------------

    @guarded(nothing)
    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Take inputs and parameters; what they are worth is judged when they are used."""
        reals = self._reals
        self._stale = True
        count = len(vrs)
        if vrs == self._leading_references[:count] and len(values) == count:
            reals[:count] = values
            return
        for vr, value in zip(vrs, values, strict=True):
            if vr in self._inputs:
                reals[vr] = value
            elif self._settable(vr, choice=False):
                reals[vr] = value
                self._parameters = None

    @guarded(nothing)
    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Take choices by the numbers of their items."""
        for vr, value in zip(vrs, values, strict=True):
            if self._settable(vr, choice=True):
                self._items[vr] = int(value)
        self._stale = True

    def _settable(self, vr: int, *, choice: bool) -> bool:
        if not self._known(vr):
            return False
        variable = self._interface.variables[vr]
        late = variable.variability == "fixed" and self._phase in (_STEPPING, _TERMINATED)
        calculated = variable.causality == "output"
        if late or calculated or variable.is_choice != choice:
            reason = "cannot change after the initialization" if late else "cannot be set as such"
            reason = "is calculated and cannot be set" if calculated else reason
            self.remark(f"{variable.name} {reason}; the new value is ignored")
            return False
        return True

    def _known(self, vr: int) -> bool:
        """Return whether a value reference is in the table; the host's unsigned numbers may arrive negative."""
        known = 0 <= vr < len(self._reals)
        if not known:
            self.remark(f"there is no variable with the value reference {vr % 2**32}; it is ignored")
        return known

    @guarded(lambda vrs: [math.nan] * len(vrs))
    def get_real(self, vrs: list[int]) -> list[float]:
        """Return values; during initialization the outputs follow the inputs set so far."""
        if self._phase == _INITIALIZING and self._stale:
            try:
                self._initialize()
            except BaseException as error:  # the outputs are not numbers then; the inputs still are
                self.report_error("get_real", error)
        reals = self._reals
        if vrs == self._outputs:
            return reals[self._output_place]
        if vrs and min(vrs) >= 0 and max(vrs) < len(reals):
            return [reals[vr] for vr in vrs]
        return [reals[vr] if self._known(vr) else math.nan for vr in vrs]

    @guarded(lambda vrs: [0] * len(vrs))
    def get_integer(self, vrs: list[int]) -> list[int]:
        """Return the numbers of the items that are chosen."""
        return [self._items[vr] if self._known(vr) else 0 for vr in vrs]

    # --- state ----------------------------------------------------------------------------------------------------

    @guarded(lambda: {})
    def _get_fmu_state(self) -> dict[str, Any]:
        # while initializing, what was computed before a setting changed is obsolete, and may not fit the settings
        snapshot = None if self._stale and self._phase == _INITIALIZING else self._snapshot
        return {
            "format": _STATE_FORMAT,
            "guid": self.guid,
            "phase": self._phase,
            "stale": self._stale,
            "failure": self._failure,
            "start_time": self._start_time,
            "stop_time": None if math.isinf(self._stop_time) else self._stop_time,
            "reals": list(self._reals),
            "items": list(self._items),
            "snapshot": None if snapshot is None else snapshot.to_plain(),
        }

    @guarded(nothing)
    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        if state.get("format") != _STATE_FORMAT or state.get("guid") != self.guid:
            raise InvalidSetting("the state to restore is not one of this FMU; nothing was changed")
        snapshot = None if state["snapshot"] is None else self.state_type.from_plain(state["snapshot"])
        reals, items = [float(each) for each in state["reals"]], [int(each) for each in state["items"]]
        phase, stale, failure = str(state["phase"]), bool(state["stale"]), str(state["failure"])
        start_time, end = float(state["start_time"]), state["stop_time"]
        stop_time = math.inf if end is None else float(end)
        if (len(reals), len(items)) != (len(self._reals), len(self._items)):
            raise InvalidSetting(_DAMAGED)
        before = self._items, self._reals
        self._items, self._reals, self._parameters = items, reals, None
        try:
            if snapshot is not None:
                with ONE_AT_A_TIME:
                    self._prepare()
                if not self._fits(snapshot):
                    raise InvalidSetting(_DAMAGED)
        except BaseException:
            self._items, self._reals, self._parameters = *before, None
            if self._snapshot is not None:
                self._prepare()
            raise
        self._snapshot = snapshot
        self._phase, self._stale, self._failure = phase, stale, failure
        self._start_time, self._stop_time = start_time, stop_time

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> dict[str, Any]:
        try:
            found = json.loads(state.decode())
        except ValueError:
            return {}
        return found if isinstance(found, dict) else {}
