"""A slave of PythonFMU that forwards every call to the FMU's native library: phases, refusals and numbers are there.

This module is copied into the FMU and needs the standard library and PythonFMU only. An exception that leaves a
callback would end the host process: every callback is guarded.
"""

from __future__ import annotations

import ctypes
import platform
import sys
import weakref
from collections.abc import Callable
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from functools import lru_cache, partial, wraps
from pathlib import Path
from struct import Struct
from typing import Any, TypeVar, cast

from pythonfmu.enums import Fmi2Status
from pythonfmu.fmi2slave import Fmi2Slave

LIBRARIES = "libraries"
"""Folder beside this module: a folder with one library for each platform, by its name in FMI 2."""

_OF_FMI_2 = {"linux": "linux", "win32": "win", "darwin": "darwin"}
_MOST_PLACES = 64  # different lists of value references that are remembered

_LOGGER = ctypes.PYFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p, c_char_p)
_BYTES = POINTER(ctypes.c_char)
_CALLS: dict[str, list[Any]] = {
    "SetupExperiment": [c_int, c_double, c_double, c_int, c_double],
    "EnterInitializationMode": [],
    "ExitInitializationMode": [],
    "Terminate": [],
    "DoStep": [c_double, c_double, c_int],
    **{f"{verb}{kind}": [c_void_p, c_size_t, c_void_p] for verb in ("Get", "Set") for kind in ("Real", "Integer")},
    "GetFMUstate": [POINTER(c_void_p)],
    "SetFMUstate": [c_void_p],
    "FreeFMUstate": [POINTER(c_void_p)],
    "SerializedFMUstateSize": [c_void_p, POINTER(c_size_t)],
    "SerializeFMUstate": [c_void_p, _BYTES, c_size_t],
    "DeSerializeFMUstate": [c_char_p, c_size_t, POINTER(c_void_p)],
}
"""Argument types of the functions of FMI 2, after the instance."""


class _Callbacks(ctypes.Structure):
    _fields_ = (("logger", _LOGGER), ("others", 4 * c_void_p))  # others: memory, end of a step, environment; NULL


Callback = TypeVar("Callback", bound=Callable[..., Any])


def guarded(fallback: Callable[..., Any] = lambda *_: None) -> Callable[[Callback], Callback]:
    """Make a callback log any exception and return `fallback` of its arguments instead."""

    def decorate(method: Callback) -> Callback:
        @wraps(method)
        def call(self: Slave, *args: Any) -> Any:
            try:
                return method(self, *args)
            except BaseException as error:  # also KeyboardInterrupt: the host would crash on it
                text = f"internal error in {method.__name__}: {type(error).__name__}: {error}"
                self.log(text, Fmi2Status.error)
                return fallback(*args)

        return cast("Callback", call)

    return decorate


def this_platform() -> str:
    """Return the name of the platform of this process in FMI 2, or a similar one: ``linux64``, ``aarch64-linux``."""
    machine = platform.machine().lower()
    system = _OF_FMI_2.get(sys.platform, sys.platform)
    if machine not in ("x86_64", "amd64") and system != "darwin":
        return f"{machine}-{system}"
    return f"{system}{8 * ctypes.sizeof(c_void_p)}"


def library(folder: Path) -> ctypes.PyDLL:
    """Return the library for this platform.

    Parameters
    ----------
    folder : Path
        The folder that contains a folder for each platform.

    Raises
    ------
    OSError
        If there is none, or the system does not load it.
    """
    files = sorted((folder / this_platform()).glob("*.*"))
    if not files:
        known = " and ".join(sorted(each.name for each in folder.iterdir()))
        raise OSError(f"the FMU has libraries for {known}, none for {this_platform()}: build it for that platform")
    # The interpreter lock is kept: PythonFMU waits for it with a lock of its own held.
    found = ctypes.PyDLL(str(files[0]))
    found.fmi2Instantiate.restype = c_void_p
    found.fmi2Instantiate.argtypes = [c_char_p, c_int, c_char_p, c_char_p, c_void_p, c_int, c_int]
    found.fmi2FreeInstance.restype, found.fmi2FreeInstance.argtypes = None, [c_void_p]
    for name, arguments in _CALLS.items():
        getattr(found, f"fmi2{name}").argtypes = [c_void_p, *arguments]
    return found


class Places:
    """A list of value references with memory for their values, as C arrays."""

    def __init__(self, kind: type[c_double | c_int], references: tuple[int, ...]) -> None:
        self.count = len(references)
        self.references = (c_uint * self.count)(*references)
        self.values: Any = (kind * self.count)()
        self.pack = Struct(f"{self.count}{'d' if kind is c_double else 'i'}").pack_into


class Slave(Fmi2Slave):  # type: ignore[misc]  # PythonFMU has no types
    """The methods that a host calls; subclasses name the build of the library.

    Attributes
    ----------
    token : str
        Token of the build, the GUID in the model description.
    """

    license = "MIT"
    token: str

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.guid = self.token
        # One for each instance: a host may step several at a time.
        self._numbers, self._items = (lru_cache(_MOST_PLACES)(partial(Places, kind)) for kind in (c_double, c_int))
        # Not beside this module's file: an earlier instance may have imported it, from a folder that is gone.
        self._library = library(Path(kwargs["resources"], *__name__.split(".")[:-1], LIBRARIES))
        me = weakref.ref(self)  # the library must not keep the slave alive

        def forward(_: object, __: object, status: int, ___: object, form: bytes, text: bytes) -> None:
            slave = me()
            if slave is not None:  # a text with a percent sign is the argument of a format
                slave.log((text if form == b"%s" else form).decode(errors="replace"), Fmi2Status(status))

        self._callbacks = _Callbacks(_LOGGER(forward))
        self._instance = self._library.fmi2Instantiate(
            self.instance_name.encode(), 1, self.token.encode(), b"", byref(self._callbacks), 0, 1
        )
        if not self._instance:
            raise OSError("the native library of the FMU returned no instance")
        # Bound to these objects, since the slave no longer exists when the instance is freed.
        free = self._library.fmi2FreeInstance  # the argument of the finalizer keeps the callbacks until then
        freed = weakref.finalize(self, lambda instance, _: free(instance), self._instance, self._callbacks)
        freed.atexit = False  # a host may call until the very end

    def log(
        self, msg: str, status: Fmi2Status = Fmi2Status.ok, category: str | None = None, debug: None = None
    ) -> None:
        """Log a message in the host; its logger takes a format, so percent signs of the text are doubled."""
        super().log(msg.replace("%", "%%"), status, category, debug)

    # --- phases and steps -----------------------------------------------------------------------------------------

    @guarded()
    def setup_experiment(self, start_time: float, stop_time: float | None = None, *_: float | None) -> None:
        """Set start and stop time; the tolerance is ignored."""
        stops = stop_time is not None
        self._library.fmi2SetupExperiment(self._instance, 0, 0.0, start_time, stops, stop_time if stops else 0.0)

    @guarded()
    def enter_initialization_mode(self) -> None:
        """Enter the initialization; outputs are computed when they are read."""
        self._library.fmi2EnterInitializationMode(self._instance)

    @guarded()
    def exit_initialization_mode(self) -> None:
        """Compute the outputs at the start; every later step logs a failure of this again."""
        self._library.fmi2ExitInitializationMode(self._instance)

    @guarded()
    def terminate(self) -> None:
        """Refuse further steps."""
        self._library.fmi2Terminate(self._instance)

    @guarded(lambda *_: False)
    def do_step(self, current_time: float, step_size: float) -> bool:
        """Take a communication step; False means fmi2Discard, with state and outputs as before."""
        return bool(self._library.fmi2DoStep(self._instance, current_time, step_size, 1) < Fmi2Status.discard.value)

    # --- variables ------------------------------------------------------------------------------------------------

    @guarded()
    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Set numbers; their values are checked when they are used."""
        at = self._numbers(tuple(vrs))
        at.pack(at.values, 0, *values)
        self._library.fmi2SetReal(self._instance, at.references, at.count, at.values)

    @guarded()
    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Set choices, by the numbers of their items."""
        at = self._items(tuple(vrs))
        at.values[:] = values
        self._library.fmi2SetInteger(self._instance, at.references, at.count, at.values)

    @guarded(lambda vrs: [float("nan")] * len(vrs))
    def get_real(self, vrs: list[int]) -> list[float]:
        """Return numbers, NaN where there is none."""
        at = self._numbers(tuple(vrs))
        self._library.fmi2GetReal(self._instance, at.references, at.count, at.values)
        found: list[float] = at.values[:]
        return found

    @guarded(lambda vrs: [0] * len(vrs))
    def get_integer(self, vrs: list[int]) -> list[int]:
        """Return the numbers of the chosen items, 0 for variables that are no choices."""
        at = self._items(tuple(vrs))
        at.values[:] = [0] * at.count
        self._library.fmi2GetInteger(self._instance, at.references, at.count, at.values)
        found: list[int] = at.values[:]
        return found

    # The FMU has no String and no Boolean variables; PythonFMU's own methods raise, which would end the host.

    @guarded()
    def set_string(self, vrs: list[int], _: list[Any]) -> None:
        """Log a warning; nothing is set."""
        self._refused(vrs, None)

    set_boolean = set_string

    @guarded(lambda vrs: [""] * len(vrs))
    def get_string(self, vrs: list[int]) -> list[str]:
        """Log a warning; return empty texts."""
        return self._refused(vrs, "")

    @guarded(lambda vrs: [False] * len(vrs))
    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Log a warning; return False."""
        return self._refused(vrs, False)

    def _refused(self, vrs: list[int], value: Any) -> list[Any]:
        if vrs:
            self.log("the FMU has no String and no Boolean variables; the call is ignored", Fmi2Status.warning)
        return [value] * len(vrs)

    # --- states ---------------------------------------------------------------------------------------------------

    @guarded(lambda: b"")
    def _get_fmu_state(self) -> bytes:
        """Return the complete state of the FMU."""
        state, size = c_void_p(), c_size_t()
        self._library.fmi2GetFMUstate(self._instance, byref(state))
        try:
            self._library.fmi2SerializedFMUstateSize(self._instance, state, byref(size))
            found = ctypes.create_string_buffer(size.value)
            self._library.fmi2SerializeFMUstate(self._instance, state, found, size.value)
            return found.raw
        finally:
            self._library.fmi2FreeFMUstate(self._instance, byref(state))

    @guarded()
    def _set_fmu_state(self, state: bytes) -> None:
        """Restore a state from `_get_fmu_state`; other bytes are refused and change nothing."""
        restored = c_void_p()
        self._library.fmi2DeSerializeFMUstate(self._instance, state, len(state), byref(restored))
        if restored:
            self._library.fmi2SetFMUstate(self._instance, restored)
            self._library.fmi2FreeFMUstate(self._instance, byref(restored))

    _fmu_state_to_bytes = _fmu_state_from_bytes = staticmethod(bytes)  # a state is its bytes already
