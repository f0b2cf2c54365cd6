"""A small FMI 2.0 master for the tests: each FMU built once per run, instances driven call by call through fmpy."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import cache, partial
from io import BytesIO
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any, Self
from zipfile import ZipFile

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, defaultCallbacks, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave
from processes import python

from crane_fmu.catalogue import KINDS, ORDERS
from servocore.numerics.compiled_calls import Array

JET = tuple(f"load.{quantity}[{k}]" for quantity in ORDERS for k in (1, 2, 3))
OUTPUTS = ("M_b", "F", "M_w", "phi", "s", "l", "tension", "swing")
OK, WARNING, DISCARD, ERROR = range(4)
UNKNOWN = 99  # of no enumeration
TEMPORARY = tempfile.gettempdir()  # before a run of an FMU sets another for a while


@cache
def scratch() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="fmu tests ", dir=TEMPORARY))  # with a space
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def built_once(name: str, build: Callable[[Path], object], seconds: float = 900.0) -> Path:
    """Return a file or folder that the first process to ask for it has built; the others wait.

    The sign of a process that builds is a folder: making one either succeeds or finds it made.
    """
    from budgets import shared_by_all_files  # processes that host an FMU start without pytest

    folder = Path(os.environ.get("SERVOCORE_TEST_FMUS") or scratch() / "built")
    folder.mkdir(exist_ok=True)
    place, sign, until = folder / name, folder / f"{name}.busy", time.monotonic() + seconds
    while True:
        try:
            sign.mkdir()
            break
        except FileExistsError:
            if time.monotonic() > until:
                raise TimeoutError(f"{sign} has been held for {seconds:g} s") from None
            time.sleep(0.05)
    try:
        with shared_by_all_files():
            if not place.exists():
                build(place)
    finally:
        sign.rmdir()
    return place


@cache
def system(native: bool = False) -> Path:
    from crane_fmu.build import SystemOptions, build_ssp  # and without what builds FMUs

    options = SystemOptions(targets="host", native=native)
    return built_once(f"system{' native' * native}", partial(build_ssp, options=options)) / "Crane.ssp"


@cache
def fmu_file(name: str = "RotaryCrane") -> Path:
    """Return an FMU of the system, which is the one that `build_fmu` builds alone: none is built twice."""
    return system().parent / KINDS[name].file_name


def members(file: str | Path | BytesIO) -> dict[str, bytes]:
    """Return the contents of an archive by their names."""
    with ZipFile(file) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@cache
def extracted(file: Path) -> str:
    return str(extract(file, tempfile.mkdtemp(prefix="fmu ", dir=scratch())))


class Host:
    """One instance of an FMU of FMI 2 or 3; `step` returns whether doStep was accepted.

    Numbers are named as in FMI 2, ``load.position[1]``, in FMI 3 by their arrays.
    """

    path: tuple[str, ...] = JET
    """Inputs that `tell` sets."""

    def __init__(self, file: Path | None = None, *, logging: bool = True, name: str = "crane") -> None:
        file = file or fmu_file()
        self.messages: list[str] = []
        self.description = read_model_description(str(file), validate=False)
        variables = self.description.modelVariables
        self.references = {each.name: each.valueReference for each in variables}
        self.sizes = {each.name: size_of(each) for each in variables}
        self.items = {
            each.name: {item.name: int(item.value) for item in each.declaredType.items}
            for each in variables
            if each.type == "Enumeration"
        }
        self.fmi = int(self.description.fmiVersion[0])
        self.fmu: Any = (FMU2Slave if self.fmi == 2 else FMU3Slave)(
            guid=self.description.guid,
            unzipDirectory=extracted(file),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        if self.fmi == 2:
            self.callbacks = fmi2CallbackFunctions()
            self.callbacks.logger = fmi2CallbackLoggerTYPE(lambda *given: self.messages.append(given[4].decode()))
            self.callbacks.allocateMemory = defaultCallbacks.allocateMemory
            self.callbacks.freeMemory = defaultCallbacks.freeMemory
            self.fmu.instantiate(callbacks=self.callbacks, loggingOn=logging)
        else:
            self.fmu.instantiate(logMessage=lambda *given: self.messages.append(given[3].decode()))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.fmu.freeInstance()

    def set(self, **values: float | str) -> Self:
        """Set numbers, and choices by the names or the numbers of their items."""
        for name, value in values.items():
            if name in self.items:
                number = self.items[name].get(value, UNKNOWN) if isinstance(value, str) else value
                (self.fmu.setInteger if self.fmi == 2 else self.fmu.setInt64)([self.references[name]], [number])
            else:
                self.numbers_set([name], [float(value)])
        return self

    def numbers_set(self, names: Sequence[str], values: Sequence[float] | Array) -> None:
        setter = self.fmu.setReal if self.fmi == 2 else self.fmu.setFloat64
        setter([self.references[name] for name in names], [float(each) for each in values])

    def get(self, *names: str) -> np.ndarray:
        references = [self.references[name] for name in names]
        if self.fmi == 2:
            return np.array(self.fmu.getReal(references))
        return np.array(self.fmu.getFloat64(references, sum(self.sizes[name] for name in names)))

    def tell(self, jet: Array) -> Self:
        """Set the path, for a jet of shape (orders, m)."""
        self.numbers_set(self.path, np.ravel(jet)[: sum(self.sizes[name] for name in self.path)])
        return self

    def start(self, jet: Array | None = None, time: float = 0.0, **settings: float | str) -> Self:
        self.set(**settings)
        if self.fmi == 2:
            self.fmu.setupExperiment(startTime=time)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=time)
        if jet is not None:
            self.tell(jet)
        self.fmu.exitInitializationMode()
        return self

    def status(self, time: float, h: float) -> int:
        """Take a step and return the status of doStep."""
        try:
            self.fmu.doStep(time, h)
        except FMICallException as error:
            return int(error.status)
        return OK

    def step(self, time: float, h: float) -> bool:
        status = self.status(time, h)
        assert status in (OK, DISCARD), (status, self.messages)
        return status == OK

    def outputs(self) -> np.ndarray:
        return self.get(*OUTPUTS)

    def __getitem__(self, name: str) -> float:
        return float(self.get(name)[0])


def size_of(variable: Any) -> int:
    """Return how many numbers a variable has."""
    return int(np.prod([int(each.start) for each in variable.dimensions])) if variable.dimensions else 1


def follow(host: Host, jets: Array, times: Array, *, at: str = "start") -> dict[str, np.ndarray]:
    """Drive an instance along jets of a path; `at` is its input_time. Returns outputs by name at all times."""
    host.set(input_time=at).start(jets[0], float(times[0]))
    rows = [host.outputs()]
    for k in range(len(times) - 1):
        host.tell(jets[k + 1] if at == "end" else jets[k])
        assert host.step(float(times[k]), float(times[k + 1] - times[k])), host.messages
        rows.append(host.outputs())
    return dict(zip(OUTPUTS, np.array(rows).T, strict=True))


def in_a_process(
    code: str, *arguments: str | Path, seconds: float = 600.0, **environment: str
) -> CompletedProcess[str]:
    """Run code that may crash; it finds this module on its path."""
    here = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    return python("-c", code, *arguments, folder=scratch(), seconds=seconds, PYTHONPATH=here, **environment)


def promised(name: str = "RotaryCrane") -> list[str]:
    """Return the sentences of the user page's table of refusals, in its order."""
    page = Path(__file__).parents[1].joinpath("docs", KINDS[name].page).read_text(encoding="utf-8")
    _, _, table = page.partition("| situation | sentence |\n|---|---|\n")
    return [line.split(" | ")[1].removesuffix(" |") for line in table.partition("\n\n")[0].splitlines()]


def described(name: str = "RotaryCrane", causality: str = "") -> list[Any]:
    """Return the variables in the model description, of one causality where one is asked for."""
    every = read_model_description(str(fmu_file(name)), validate=False).modelVariables
    return [each for each in every if causality in ("", each.causality)]
