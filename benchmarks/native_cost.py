"""What native FMUs cost their host: `make bench`, or `python benchmarks/native_cost.py`.

A host in C sets all inputs of a step (the path and its derivatives), steps, and gets the outputs of the drives, along
the scene's own path. Beside it, in the same run and by the same host, an FMU in C that copies its inputs to its
outputs, and the crane's PythonFMU. Times are those of the fastest of many rounds: machines are busy.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

import fmpy
import numpy as np

import servocore as sc
from crane_fmu.build import SystemOptions, build_fmu, build_ssp
from servocore.export.building import inverse_model
from servocore.export.inverse_functions import METHOD
from servocore.export.native_model import NativeModel
from servocore.numerics.machine_code import c_compiler

ROUNDS, STEPS = 200, 500
FEW_ROUNDS = 10  # where instances take long
HERE = Path(__file__).parent
HEADERS = Path(fmpy.__file__).parent / "c-code"
HOST = HERE.parent / "tests" / "native" / "host.c"

TRIVIAL = """
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"
typedef struct { double u[64], y[64]; } Slave;
fmi2Component fmi2Instantiate(fmi2String n, fmi2Type t, fmi2String g, fmi2String r, const fmi2CallbackFunctions *f,
                              fmi2Boolean v, fmi2Boolean l) { return calloc(1, sizeof(Slave)); }
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real d, fmi2Boolean e, fmi2Real f)
{ return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[])
{ for (size_t k = 0; k < n; k++) ((Slave *)c)->u[r[k]] = v[k]; return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[])
{ for (size_t k = 0; k < n; k++) v[k] = ((Slave *)c)->y[r[k]]; return fmi2OK; }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean n)
{ memcpy(((Slave *)c)->y, ((Slave *)c)->u, sizeof(double) * 64); return fmi2OK; }
"""
NO_CHOICE = 1000
"""In place of the value reference of input_time where there is none."""


def measured_time(
    host: Path,
    library: Path,
    token: str,
    sizes: tuple[int, int, int],
    choice: int,
    signals: tuple[str, float],
    rounds: int = ROUNDS,
) -> tuple[float, float]:
    """Return microseconds of a step and of an instantiation; `signals` are the path as text, and the step in s."""
    inputs, first, outputs = sizes
    words = [library, token, inputs, inputs, first, outputs, choice, STEPS, signals[1], rounds]
    resources = (library.parent.parent.parent / "resources").as_uri()
    done = subprocess.run(
        [host, *map(str, words), resources],
        input=signals[0],
        capture_output=True,
        text=True,
        check=True,
    )
    step, start = map(float, done.stdout.split())
    return step, start


def path_of(scene: sc.Scene, model: NativeModel) -> tuple[str, float]:
    """Return the scene's own path as text for the host, and its step."""
    reference = scene.reference
    t = np.linspace(reference.start_time, reference.end_time, STEPS + 1)
    jets = reference.jet(t, model.own["orders"] - 1)
    return " ".join(map(repr, jets.ravel().tolist())), float(t[1] - t[0])


def native(folder: Path, host: Path) -> dict[str, tuple[str, float, float, int]]:
    """Return method, microseconds of step and instantiation, and bytes, of all scenes."""
    found = {}
    for name, factory in sc.scenes.REGISTRY.items():
        scene = factory()
        file = sc.export_fmu(scene, folder / f"{name}.fmu", fmi=2, targets="host")
        unpacked = Path(str(fmpy.extract(str(file), str(folder / name))))
        description = fmpy.read_model_description(str(unpacked))
        model = inverse_model(scene)
        library = unpacked / "binaries" / "linux64" / f"{model.identifier}.so"
        inputs = model.numbers("input")
        numbers = sum(each.size or 1 for each in model.variables)
        sizes = inputs, inputs, len(scene.model().inputs)
        step, start = measured_time(host, library, description.guid, sizes, numbers, path_of(scene, model))
        found[name] = (
            METHOD.name if model.of("local") else "every instant by itself",
            step,
            start,
            library.stat().st_size,
        )
    return found


def python_fmu(folder: Path, host: Path) -> tuple[float, float]:
    """Return microseconds of step and instantiation of the crane's PythonFMU, whose variables have the same places."""
    unpacked = Path(str(fmpy.extract(str(build_fmu(folder)), str(folder / "python"))))
    description = fmpy.read_model_description(str(unpacked))
    places = {each.name: each.valueReference for each in description.modelVariables}
    scene = sc.scenes.rotary_crane()
    library = unpacked / "binaries" / "linux64" / f"{description.coSimulation.modelIdentifier}.so"
    sizes, signals = (15, places["M_b"], 3), path_of(scene, inverse_model(scene))
    return measured_time(host, library, description.guid, sizes, places["input_time"], signals, FEW_ROUNDS)


def system(folder: Path, host: Path) -> dict[str, float]:
    """Return microseconds of a step of 10 ms of the native system: trajectory, inverse model with feedback, plant."""
    build_ssp(folder / "system", options=SystemOptions(native=True, targets="host"))
    crane, h = sc.scenes.rotary_crane(), 0.01
    motion = sc.solve(crane, step=h)
    rows = slice(200, 201 + STEPS)
    jets = crane.reference.jet(motion.t, 4)
    moving = [np.gradient(motion[each], h) for each in ("phi", "s", "l")]
    measured = np.column_stack([*(motion[each] for each in ("phi", "s", "l")), *moving, jets[:, 0], jets[:, 1]])
    measured[:, 6] += 0.001  # a millimetre off: the law has something to do
    forces = np.column_stack([motion[each] for each in ("M_b", "F", "M_w")])
    told = {
        "LoadTrajectory": (np.zeros((STEPS + 1, 0)), 15),
        "RotaryCrane": (np.hstack([jets.reshape(len(jets), -1), measured])[rows], 3),
        "CranePlant": (forces[: STEPS + 1], 6),
    }
    found = {}
    for name, (signals, results) in told.items():
        unpacked = Path(str(fmpy.extract(str(folder / "system" / f"{name}.fmu"), str(folder / name))))
        description = fmpy.read_model_description(str(unpacked))
        places = {each.name: each.valueReference for each in description.modelVariables}
        library = unpacked / "binaries" / "linux64" / f"{description.coSimulation.modelIdentifier}.so"
        count = signals.shape[1]
        text = " ".join(map(repr, signals.ravel().tolist())), h
        choice = places.get("input_time", NO_CHOICE)
        found[name] = measured_time(host, library, description.guid, (count, count, results), choice, text)[0]
    return found


def main() -> None:
    """Measure and print a table."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        folder = Path(scratch)
        host, trivial = folder / "host", folder / "trivial.so"
        (folder / "trivial.c").write_text(TRIVIAL, encoding="utf-8")
        compiler = [*c_compiler(), "-O2", "-w", f"-I{HEADERS}"]
        subprocess.run([*compiler, HOST, "-o", host, "-ldl"], check=True)
        subprocess.run([*compiler, "-fPIC", "-shared", folder / "trivial.c", "-o", trivial], check=True)
        rest = " ".join(["0.5"] * 15 * (STEPS + 1))
        nothing = measured_time(host, trivial, "", (15, 0, 3), NO_CHOICE, (rest, 0.01))
        scenes, python = native(folder, host), python_fmu(folder, host)
        parts = system(folder, host)
    print("| FMU | steps by | step, us | instantiate, us | library, kB |\n|---|---|---:|---:|---:|")
    for name, (method, step, start, size) in scenes.items():
        print(f"| `{name}` | {method} | {step:.2f} | {start:.0f} | {size / 1000:.0f} |")
    print(f"| copies 15 inputs to outputs, C | | {nothing[0]:.3f} | {nothing[1]:.0f} | |")
    print(f"| `RotaryCrane.fmu`, PythonFMU | every instant by itself | {python[0]:.1f} | {python[1]:.0f} | |")
    for name, step in parts.items():
        print(f"| `{name}.fmu`, native, step of 10 ms | | {step:.2f} | | |")
    print(f"\nThe crane: {python[0] / scenes['rotary_crane'][1]:.0f} times faster than as PythonFMU.")


if __name__ == "__main__":
    main()
