"""Calls of an FMU of FMI 3 about variables that do not exist, in counts that do not fit."""

from __future__ import annotations

import ctypes
import math
from pathlib import Path
from random import Random
from typing import Any

from fmpy import read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from hostile_fmu import HOSTILE, WARNING


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
