"""An FMU by its bare C functions: statuses instead of exceptions, any pointers and values."""

from __future__ import annotations

import ctypes
import math
import struct
from collections.abc import Callable, Sequence
from ctypes import byref, c_char, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from itertools import takewhile
from pathlib import Path
from random import Random
from typing import Any

from fmpy import read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave

OK, WARNING, DISCARD, ERROR = range(4)
HOSTILE = (math.nan, math.inf, -math.inf, 1e300, -1e300, -0.0, 5e-324, 0.0)
HANGING = (0.0, 5.0, 5.0, 0.0, 0.0, 0.0, 5.0, 0.0, -5.0, 0.0, 0.0, 0.0)
"""Measured values of the default crane at rest."""


class Fmu:
    """An unpacked FMU.

    Parameters
    ----------
    folder : Path
        Where it is unpacked.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.description = read_model_description(str(folder), validate=False)
        identifier = self.description.coSimulation.modelIdentifier
        self.has_shim = len(list((folder / "binaries" / "linux64").iterdir())) > 1
        self.is_deferred = (folder / "resources" / "slavemodule.txt").exists()  # a PythonFMU: its setters cannot fail
        loaded = FMU2Slave(guid=self.description.guid, unzipDirectory=str(folder), modelIdentifier=identifier)
        self.dll = loaded.dll  # with the types of all arguments
        variables = self.description.modelVariables
        self.reals = [each for each in variables if each.type == "Real"]
        self.choices = [each for each in variables if each.type == "Enumeration"]
        self.beyond = 1 + max(each.valueReference for each in self.reals)  # the first reference of no number
        self.items = {each.name: len(each.declaredType.items) for each in self.choices}
        # The path; what can be measured comes later in the table.
        first = list(takewhile(lambda each: each.causality == "input", variables))
        self.inputs = [each.valueReference for each in first]
        self.start_inputs = [float(each.start) for each in first]
        path = [each.name for each in first if not each.name.startswith("measured.")]
        self.components = sum(".position" in name for name in path)
        self.follows_a_path = self.components > 0
        self._path = len(path) * self.follows_a_path
        self.good = [self.start_inputs, *(self.swinging(t, 0.3) for t in (0.3, 1.1, 2.5))]
        """Inputs that nothing is wrong with."""
        if len(first) > len(path):
            self.good.append([*self.start_inputs[: len(path)], *HANGING])
        self.outputs = [each.name for each in variables if each.causality == "output"]
        others = [each for each in variables if each.causality in ("parameter", "input") and each not in first]
        self.usual = {each.name: float(each.start) for each in others if each.type == "Real"}
        self._by_reference = {each.valueReference: each for each in variables}

    def settable(self, reference: int, *, late: bool) -> bool:
        """Return whether a variable may be set, after the initialization if `late`."""
        variable = self._by_reference[reference]
        return variable.causality == "input" or (
            variable.causality == "parameter" and not (late and variable.variability == "fixed")
        )

    def swinging(self, t: float, size: float) -> list[float]:
        """Return inputs of a path that goes to and fro, with its derivatives; without a path those of the start."""
        phases = [t + 0.5 * math.pi * (k // self.components) for k in range(self._path)]
        return [*(x + size * math.sin(phase) for x, phase in zip(self.start_inputs, phases, strict=False)),
                *self.start_inputs[self._path :]]  # fmt: skip

    def instantiated(self, guid: bytes, callbacks: fmi2CallbackFunctions) -> int | None:
        """Return a new instance, for a description with some GUID."""
        where = (self.folder / "resources").as_uri().encode()
        made: int | None = self.dll.fmi2Instantiate(b"crane", 1, guid, where, byref(callbacks), 0, 1)
        return made


class Instance:
    """One instance; every method is one FMI call, or few."""

    def __init__(self, fmu: Fmu, tell: Callable[[str], None]) -> None:
        self._fmu, self._tell = fmu, tell
        self.messages: list[str] = []
        self._callbacks = fmi2CallbackFunctions()
        self._callbacks.logger = fmi2CallbackLoggerTYPE(lambda *each: self.messages.append(each[-1].decode()))
        tell("Instantiate")
        self._component = fmu.instantiated(fmu.description.guid.encode(), self._callbacks)
        assert self._component, self.messages
        tell(f"  is {self._component:x}")

    def call(self, name: str, *arguments: object, shown: object = "") -> int:
        """Make an FMI call and return its status."""
        self._tell(f"{self._component:x} {name} {shown or arguments}")
        return int(getattr(self._fmu.dll, f"fmi2{name}")(self._component, *arguments))

    def free(self) -> None:
        self._tell(f"{self._component:x} FreeInstance")
        self._fmu.dll.fmi2FreeInstance(self._component)

    def do(self, call: tuple[object, ...]) -> int:
        """Make a call of an account."""
        name, *arguments = call
        plain = {"enter": "EnterInitializationMode", "leave": "ExitInitializationMode", "terminate": "Terminate"}
        if name in plain:
            return self.call(plain[str(name)])
        return int(getattr(self, str(name))(*arguments))

    def setup(self, time: float) -> int:
        return self.call("SetupExperiment", 0, 0.0, time, 0, 0.0)

    def step(self, time: float, h: float) -> int:
        return self.call("DoStep", time, h, 1)

    def set_reals(self, references: Sequence[int], values: Sequence[float]) -> int:
        n = len(references)
        shown = list(zip(references, values, strict=True))
        return self.call("SetReal", (c_uint * n)(*references), n, (c_double * n)(*values), shown=shown)

    def get_reals(self, references: Sequence[int]) -> tuple[int, list[float]]:
        n, values = len(references), (c_double * len(references))()
        return self.call("GetReal", (c_uint * n)(*references), n, values, shown=references), list(values)

    def set_integers(self, kind: str, references: Sequence[int], values: Sequence[int]) -> int:
        n = len(references)
        return self.call(f"Set{kind}", (c_uint * n)(*references), n, (c_int * n)(*values), shown=references)

    def get_integers(self, kind: str, references: Sequence[int]) -> tuple[int, list[int]]:
        n, values = len(references), (c_int * len(references))()
        return self.call(f"Get{kind}", (c_uint * n)(*references), n, values, shown=references), list(values)

    def set_text(self, reference: int, text: bytes) -> int:
        return self.call("SetString", (c_uint * 1)(reference), 1, (c_char_p * 1)(text), shown=(reference, text))

    def get_texts(self, references: Sequence[int]) -> tuple[int, list[bytes | None]]:
        n, values = len(references), (c_char_p * len(references))()
        return self.call("GetString", (c_uint * n)(*references), n, values, shown=references), list(values)

    def differentiate(self, unknowns: Sequence[int], knowns: Sequence[int], seeds: Sequence[float]) -> int:
        n, m = len(unknowns), len(knowns)
        given = (c_uint * n)(*unknowns), n, (c_uint * m)(*knowns), m, (c_double * m)(*seeds), (c_double * n)()
        return self.call("GetDirectionalDerivative", *given, shown=(unknowns, knowns, seeds))

    def everything(self) -> tuple[object, ...]:
        """Bits of all Reals, and all choices, with statuses: outputs of a start that fails cannot be read."""
        status, values = self.get_reals([each.valueReference for each in self._fmu.reals])
        bits = [b"nan" if value != value else struct.pack("d", value) for value in values]  # noqa: PLR0124
        return status, bits, self.get_integers("Integer", [each.valueReference for each in self._fmu.choices])

    def get_state(self) -> tuple[int, int]:
        state = c_void_p()
        return self.call("GetFMUstate", byref(state), shown=" "), state.value or 0

    def set_state(self, state: int) -> int:
        return self.call("SetFMUstate", state)

    def free_state(self, state: int) -> int:
        return self.call("FreeFMUstate", byref(c_void_p(state)), shown=f"{state:x}")

    def serialized(self, state: int) -> bytes:
        size = c_size_t()
        assert self.call("SerializedFMUstateSize", state, byref(size)) == OK
        text = ctypes.create_string_buffer(size.value)
        assert self.call("SerializeFMUstate", state, text, size.value) == OK
        return text.raw

    def restore(self, text: bytes) -> int:
        """Read a state from its bytes and restore it; returns the status of the call that refuses."""
        state = c_void_p()
        given = (c_char * len(text)).from_buffer_copy(text)
        status = self.call("DeSerializeFMUstate", given, len(text), byref(state), shown=text[:60])
        if status == OK:
            status = self.set_state(state.value or 0)
            assert self.free_state(state.value or 0) == OK
        return status


class Vectors:
    """Calls of an FMI 3 FMU about variables that do not exist, in counts that do not fit.

    What lies behind them both versions of FMI share.
    """

    def __init__(self, folder: Path, random: Random) -> None:
        description = read_model_description(str(folder), validate=False)
        identifier = description.coSimulation.modelIdentifier
        self.fmu = FMU3Slave(guid=description.guid, unzipDirectory=str(folder), modelIdentifier=identifier)
        self.random, self.time, self.statuses = random, 0.0, set[int]()
        numbers = [each for each in description.modelVariables if each.type == "Float64" and each.name != "time"]
        self.starts = {each.valueReference: [float(x) for x in str(each.start or "0").split()] for each in numbers}
        self.sizes = {each.valueReference: math.prod(int(d.start) for d in each.dimensions) for each in numbers}

    def some(self, usual: float) -> tuple[Any, int, Any, int]:
        """Return references, most of which exist, and as many values, or one more: beyond lies nobody's memory."""
        known = [*self.sizes, *range(len(self.sizes), len(self.sizes) + 4 * (self.random.random() < 0.1))]
        chosen = self.random.choices(known, k=self.random.randrange(len(known) + 4))
        count = sum(self.sizes.get(each, 1) for each in chosen) + (self.random.random() < 0.2)
        values = [usual if self.random.random() < 0.95 else self.random.choice(HOSTILE) for _ in range(count)]
        return (ctypes.c_uint * len(chosen))(*chosen), len(chosen), (ctypes.c_double * count)(*values), count

    def call(self, name: str, *arguments: object) -> int:
        try:
            status = int(getattr(self.fmu, f"fmi3{name}")(self.fmu.component, *arguments))
        except FMICallException as error:
            status = int(error.status)
        self.statuses.add(status)
        return status

    def event(self) -> None:
        of, by = self.some(0.5), self.some(1.0)
        match self.random.randrange(7):
            case 0:
                self.call("GetFloat64", *of)
            case 1:
                self.call("SetFloat64", *of)
            case 2:
                self.call("GetDirectionalDerivative", *of[:2], *by, *of[2:])
            case 3:
                self.call("GetAdjointDerivative", *of[:2], *by[:2], *of[2:], *by[2:])
            case 4:
                choice = ctypes.c_uint(self.random.randrange(len(self.sizes) + 6))
                value, count = ctypes.c_longlong(self.random.randrange(-1, 4)), self.random.choice((1, 1, 2))
                self.call("SetInt64", ctypes.byref(choice), 1, ctypes.byref(value), count)
            case 5:
                for reference, start in self.starts.items():
                    given = (ctypes.c_uint * 1)(reference), 1, (ctypes.c_double * len(start))(*start), len(start)
                    self.call("SetFloat64", *given)
            case 6:
                flags, last = [ctypes.byref(ctypes.c_bool()) for _ in range(3)], ctypes.c_double()
                h = self.random.choice((0.01, 0.01, 0.01, -1.0))
                if self.call("DoStep", self.time, h, False, *flags, ctypes.byref(last)) <= WARNING:
                    self.time = last.value

    def run(self, calls: int) -> None:
        self.fmu.instantiate(logMessage=lambda *_: None)
        self.time = 0.0
        if self.random.random() < 0.75:
            self.call("EnterInitializationMode", False, 0.0, 0.0, False, 0.0)
        if self.random.random() < 0.75:
            self.call("ExitInitializationMode")
        for _ in range(calls):
            self.event()
        self.fmu.fmi3FreeInstance(self.fmu.component)  # FMPy's method unloads the library too
