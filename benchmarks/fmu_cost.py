"""What the FMU costs its host: `make bench`, or `python benchmarks/fmu_cost.py [FMU] [--json]`.

* `cycle`: set the inputs, step, get the outputs, by the bare C functions. Beside it PythonFMU's own cost, measured with
  a slave that has as many inputs and outputs and computes nothing; its cycles alternate with those of the FMU.
* `feedback`: what a cycle takes beyond one without, with the twelve measured values set as well.
* `instance`: the first one and a second one in a process that has imported NumPy and CasADi already.

Times of cycles are process times, the smallest of many short runs, and ratios the median over runs that followed each
other: machines are busy.
"""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ctypes import byref, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from pythonfmu.builder import FmuBuilder

import servocore as sc
from crane_fmu.build import build_fmu
from crane_fmu.build.sampling import flat_motion

BATCHES, CYCLES, STEP = 200, 20, 0.005
SETTINGS: dict[str, dict[str, str]] = {
    "points, reduced (default)": {},
    "points, projected": {"formulation": "projected"},
    "generalized, reduced": {"model": "generalized"},
    "bodies, reduced": {"model": "bodies"},
}

FEEDBACK = {
    "with feedback, input_time start": {},
    "with feedback, input_time end": {"input_time": "end"},
}
"""To be compared with the first of the settings."""

BASE = "PythonFMU, nothing computed"

TRIVIAL = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Real

class Trivial(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        for k in range(15):
            setattr(self, f"u{k}", 0.0)
            self.register_variable(Real(f"u{k}", causality=Fmi2Causality.input))
        for k in range(8):
            setattr(self, f"y{k}", 0.0)
            self.register_variable(Real(f"y{k}", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        return True
"""


class Driven:
    """An instance of an unpacked FMU, initialized, that is driven by the C functions."""

    def __init__(self, folder: Path, inputs: np.ndarray, texts: dict[str, str] | None = None) -> None:
        description = fmpy.read_model_description(str(folder), validate=False)
        identifier = description.coSimulation.modelIdentifier
        self._dll = ctypes.CDLL(str(folder / "binaries" / "linux64" / f"{identifier}.so"))
        self._dll.fmi2Instantiate.restype = c_void_p
        self._callbacks = fmi2CallbackFunctions()
        self._callbacks.logger = fmi2CallbackLoggerTYPE(lambda *each: print(each[-1].decode(), file=sys.stderr))
        where = (folder / "resources").as_uri().encode()
        begin = time.perf_counter()
        made = self._dll.fmi2Instantiate(b"x", 1, description.guid.encode(), where, byref(self._callbacks), 0, 0)
        self.seconds = time.perf_counter() - begin
        self._component = c_void_p(made)
        by_name = {each.name: each for each in description.modelVariables}
        for name, text in (texts or {}).items():
            number = next(int(each.value) for each in by_name[name].declaredType.items if each.name == text)
            references, values = (c_uint * 1)(by_name[name].valueReference), (ctypes.c_int * 1)(number)
            self._dll.fmi2SetInteger(self._component, references, c_size_t(1), values)
        connected = [each.valueReference for each in description.modelVariables if each.causality == "input"]
        connected = connected[: inputs.shape[1]]  # the path first, then what is measured
        outputs = [each.valueReference for each in description.modelVariables if each.causality == "output"]
        self._u, self._y = (c_uint * len(connected))(*connected), (c_uint * len(outputs))(*outputs)
        self._values = [(c_double * len(connected))(*row) for row in inputs]
        self.results = (c_double * len(outputs))()
        self.steps = 0
        self._dll.fmi2SetupExperiment(self._component, 0, c_double(0), c_double(0), 0, c_double(0))
        self._dll.fmi2EnterInitializationMode(self._component)
        self._dll.fmi2SetReal(self._component, self._u, c_size_t(len(self._u)), self._values[0])
        self._dll.fmi2ExitInitializationMode(self._component)

    def cycle(self, count: int) -> None:
        """Set, step and get so many times; the inputs are repeated when they are used up."""
        dll, c, u, y, results = self._dll, self._component, self._u, self._y, self.results
        n, m, h, values = c_size_t(len(u)), c_size_t(len(y)), c_double(STEP), self._values
        for k in range(self.steps, self.steps + count):
            dll.fmi2SetReal(c, u, n, values[k % len(values)])
            if dll.fmi2DoStep(c, c_double(k * STEP), h, c_int(1)):
                raise SystemExit(f"step {k} was refused")
            dll.fmi2GetReal(c, y, m, results)
        self.steps += count

    def free(self) -> None:
        """End the instance."""
        self._dll.fmi2FreeInstance(self._component)


def path() -> np.ndarray:
    """Return inputs along the default manoeuvre and back, a row a step."""
    reference = sc.scenes.rotary_crane().reference
    t = np.arange(round(reference.duration / STEP) + 1) * STEP
    there = reference.jet(t, 4)
    back = there[::-1].copy()
    back[:, 1::2] *= -1.0  # odd derivatives of the path run backwards
    return np.concatenate([there, back]).reshape(2 * len(t), -1)


def with_measured(inputs: np.ndarray) -> np.ndarray:
    """Return inputs with what is measured of a crane that is on its path."""
    crane = sc.scenes.rotary_crane().parameter_values()
    p = [crane[name] for name in sc.scenes.rotary_crane().model().parameters.names]
    states = np.array(flat_motion().map(len(inputs))(inputs.T, np.tile(np.array(p)[:, None], len(inputs)))[0]).T
    (x, y), (x_dot, y_dot) = states[:, :2].T, states[:, 5:7].T
    s, length = np.hypot(x, y), np.linalg.norm(inputs[:, :3] - np.pad(states[:, :2], [(0, 0), (0, 1)]), axis=1)
    rates = (x * y_dot - y * x_dot) / s**2, (x * x_dot + y * y_dot) / s, np.gradient(length, STEP)
    drives = np.stack([np.unwrap(np.arctan2(y, x)), s, length, *rates], axis=1)
    return np.hstack([inputs, drives, inputs[:, :6]])


@contextmanager
def trivial() -> Iterator[Path]:
    """Offer the unpacked FMU of a slave that computes nothing."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        source = Path(folder) / "trivial_slave.py"
        source.write_text(TRIVIAL, encoding="utf-8")
        file = FmuBuilder.build_FMU(source, Path(folder))
        yield Path(str(fmpy.extract(str(file), folder)))


def microseconds(runs: dict[str, Callable[[int], None]]) -> dict[str, np.ndarray]:
    """Return times of a cycle, one a batch; batches of all runs take turns."""
    taken = {name: np.zeros(BATCHES) for name in runs}
    for k in range(BATCHES):
        for name, run in runs.items():
            begin = time.process_time()
            run(CYCLES)
            taken[name][k] = 1e6 * (time.process_time() - begin) / CYCLES
    return taken


def instantiation(folder: Path) -> tuple[float, float]:
    """Milliseconds that the first and the second instance take in a new process."""
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "import numpy, casadi, json\nfrom pathlib import Path\nfrom fmu_cost import Driven\n"
        f"rest = numpy.array([[5.0, 0.0, -5.0, *[0.0] * 12]])\n"
        f"print(json.dumps([1e3 * Driven(Path({str(folder)!r}), rest).seconds for _ in range(2)]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    first, second = json.loads(done.stdout)
    return float(first), float(second)


def measure(file: Path) -> dict[str, object]:
    """Return all figures of an FMU's file."""
    with trivial() as nothing, tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        folder = Path(str(fmpy.extract(str(file), scratch)))
        inputs = path()
        driven = {name: Driven(folder, inputs, texts) for name, texts in SETTINGS.items()}
        driven |= {name: Driven(folder, with_measured(inputs), texts) for name, texts in FEEDBACK.items()}
        driven[BASE] = Driven(nothing, inputs)
        cycles = microseconds({name: each.cycle for name, each in driven.items()})
        starts = [instantiation(folder) for _ in range(3)]
    return {
        "cycle": {name: float(each.min()) for name, each in cycles.items()},
        "ratio": {name: float(np.median(each / cycles[BASE])) for name, each in cycles.items()},
        "feedback": {name: float(cycles[name].min() - cycles[next(iter(SETTINGS))].min()) for name in FEEDBACK},
        "first instance": min(first for first, _ in starts),
        "second instance": min(second for _, second in starts),
    }


def main(arguments: list[str]) -> None:
    """Measure and print."""
    given = [each for each in arguments if each != "--json"]
    with tempfile.TemporaryDirectory() as folder:
        found = measure(Path(given[0]) if given else build_fmu(Path(folder)))
    if "--json" in arguments:
        print(json.dumps(found))
        return
    print(f"{'set, step, get':32} {'us':>8} {'ratio':>8}")
    cycles, ratios, feedback = found["cycle"], found["ratio"], found["feedback"]
    assert isinstance(cycles, dict)
    assert isinstance(ratios, dict)
    assert isinstance(feedback, dict)
    for name in cycles:
        print(f"{name:32} {cycles[name]:8.1f} {ratios[name]:8.2f}")
    for name, more in feedback.items():
        print(f"{name:32} takes {more:.1f} us more")
    print(f"first instance {found['first instance']:.0f} ms, second {found['second instance']:.0f} ms")


if __name__ == "__main__":
    main(sys.argv[1:])
