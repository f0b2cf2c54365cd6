"""An FMU by its bare C functions: statuses instead of exceptions, any pointers and values."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Sequence
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any

from fmpy import read_model_description
from fmpy.fmi2 import fmi2CallbackFunctions, fmi2CallbackLoggerTYPE

OK, DISCARD, ERROR = 0, 2, 3

_ARGUMENTS: dict[str, list[type[ctypes._SimpleCData[Any]] | type[ctypes._Pointer[Any]]]] = {
    "SetupExperiment": [c_void_p, c_int, c_double, c_double, c_int, c_double],
    "DoStep": [c_void_p, c_double, c_double, c_int],
    "SetFMUstate": [c_void_p, c_void_p],
    "GetFMUstate": [c_void_p, POINTER(c_void_p)],
    "FreeFMUstate": [c_void_p, POINTER(c_void_p)],
    "SerializedFMUstateSize": [c_void_p, c_void_p, POINTER(c_size_t)],
    "SerializeFMUstate": [c_void_p, c_void_p, c_char_p, c_size_t],
    "DeSerializeFMUstate": [c_void_p, c_char_p, c_size_t, POINTER(c_void_p)],
    **{f"{verb}{kind}": [c_void_p, c_void_p, c_size_t, c_void_p]
       for verb in ("Get", "Set") for kind in ("Real", "Integer", "Boolean", "String")},
}  # fmt: skip


@dataclass(frozen=True)
class Variable:
    """Of the model description."""

    name: str
    reference: int


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
        binary = folder / "binaries" / "linux64" / f"{identifier}.so"
        self.has_shim = len(list(binary.parent.iterdir())) > 1
        self.dll = ctypes.CDLL(str(binary))
        self.dll.fmi2Instantiate.restype = c_void_p
        self.dll.fmi2Instantiate.argtypes = [c_char_p, c_int, c_char_p, c_char_p, c_void_p, c_int, c_int]
        self.dll.fmi2FreeInstance.restype, self.dll.fmi2FreeInstance.argtypes = None, [c_void_p]
        variables = self.description.modelVariables
        self.reals = [Variable(each.name, each.valueReference) for each in variables if each.type == "Real"]
        self.choices = [Variable(each.name, each.valueReference) for each in variables if each.type == "Enumeration"]
        self.items = {each.name: len(each.declaredType.items) for each in variables if each.type == "Enumeration"}
        # The path; what can be measured comes later in the table.
        first = list(takewhile(lambda each: each.causality == "input", variables))
        self.inputs = [each.valueReference for each in first]
        self.start_inputs = [float(each.start) for each in first]
        self.follows_a_path = [each.name for each in first[:1]] == ["load.position[1]"]
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

    def instance(self, tell: Callable[[str], None]) -> Instance:
        """Make an instance that tells every call before it is made."""
        return Instance(self, tell)


class Instance:
    """One instance; every method is one FMI call, or few."""

    def __init__(self, fmu: Fmu, tell: Callable[[str], None]) -> None:
        self._fmu, self._tell = fmu, tell
        self.messages: list[str] = []
        self._callbacks = fmi2CallbackFunctions()
        self._callbacks.logger = fmi2CallbackLoggerTYPE(lambda *each: self.messages.append(each[-1].decode()))
        where = (fmu.folder / "resources").as_uri().encode()
        tell("Instantiate")
        guid = fmu.description.guid.encode()
        self._component = fmu.dll.fmi2Instantiate(b"crane", 1, guid, where, byref(self._callbacks), 0, 1)
        assert self._component, self.messages
        tell(f"  is {self._component:x}")

    def call(self, name: str, *arguments: object, shown: object = "") -> int:
        """Make an FMI call and return its status."""
        self._tell(f"{self._component:x} {name} {shown or arguments}")
        function = self._fmu.dll[f"fmi2{name}"]
        function.restype, function.argtypes = c_int, _ARGUMENTS.get(name, [c_void_p])
        return int(function(self._component, *arguments))

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

    def get_texts(self, references: Sequence[int]) -> list[bytes | None]:
        n, values = len(references), (c_char_p * len(references))()
        assert self.call("GetString", (c_uint * n)(*references), n, values, shown=references) == OK
        return list(values)

    def everything(self) -> tuple[list[bytes], list[int]]:
        """Bits of all Reals, and all choices."""
        status, values = self.get_reals([each.reference for each in self._fmu.reals])
        assert status == OK
        bits = [b"nan" if value != value else struct.pack("d", value) for value in values]  # noqa: PLR0124
        status, chosen = self.get_integers("Integer", [each.reference for each in self._fmu.choices])
        assert status == OK
        return bits, chosen

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

    def deserialized(self, text: bytes) -> int:
        state = c_void_p()
        assert self.call("DeSerializeFMUstate", text, len(text), byref(state), shown=text[:60]) == OK
        return state.value or 0
