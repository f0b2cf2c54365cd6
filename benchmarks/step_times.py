"""How the times of a million steps of exported FMUs are spread: `python -m benchmarks.step_times`.

A program in C, into which the sources of an FMU are compiled, follows the scene's own path a thousand times in a
thousand steps: it sets all inputs, steps and reads the outputs. The linker has it count heap calls. A shared machine
interrupts it now and then; the slowest step without that is the largest, along the path, of the medians of all rounds.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

import numpy as np

import servocore as sc
from servocore.export.building import inverse_model
from servocore.export.sources import compiled_files, fmu_sources
from servocore.numerics.machine_code import c_compiler

ROUNDS, STEPS = 1000, 1000
SCENES = ("rotary_crane", "cars", "mass_on_car", "passive_joint_arm")
EDGES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Upper ends of the histogram's bins in us."""

PROGRAM = """
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <time.h>
#include "model.h"
#define FMI2_FUNCTION_PREFIX FUNCTION_PREFIX
#include "fmi2Functions.h"
static long heap_calls;
#define COUNTED(result, name, given, passed) \\
    result __real_##name given; result __wrap_##name given { heap_calls++; return __real_##name passed; }
COUNTED(void *, malloc, (size_t a), (a))
COUNTED(void *, calloc, (size_t a, size_t b), (a, b))
COUNTED(void *, realloc, (void *a, size_t b), (a, b))
static double path[STEPS + 1][N_INPUTS], spent[ROUNDS * STEPS];
static void logger(fmi2ComponentEnvironment e, fmi2String i, fmi2Status s, fmi2String c, fmi2String m, ...) {}
int main(void)
{
    const fmi2CallbackFunctions host = {logger, 0, 0, 0, 0};
    const double h = DURATION / STEPS;
    fmi2ValueReference inputs[N_INPUTS], outputs[N_OUTPUTS];
    double found[N_OUTPUTS];
    fmi2Component c = fmi2Instantiate("timed", fmi2CoSimulation, INSTANTIATION_TOKEN, "", &host, 0, 0);
    for (int k = 0; k < N_INPUTS; k++) inputs[k] = k;
    for (int k = 0; k < N_OUTPUTS; k++) outputs[k] = N_INPUTS + k;
    for (int k = 0; k <= STEPS; k++)
        for (int i = 0; i < N_INPUTS; i++)
            if (scanf("%lf", &path[k][i]) != 1) return 1;
    for (int round = 0; round < ROUNDS; round++) {
        const fmi2ValueReference choice = N_INPUTS + N_OUTPUTS + N_PARAMETERS + N_SETTINGS + N_INTERNAL + INPUT_TIME;
        const int at_end = 2;
        fmi2Reset(c);
        fmi2SetReal(c, inputs, N_INPUTS, path[0]);
        fmi2SetInteger(c, &choice, 1, &at_end);
        if (fmi2EnterInitializationMode(c) || fmi2ExitInitializationMode(c)) return 2;
        if (round == 0) heap_calls = 0;
        for (int k = 0; k < STEPS; k++) {
            struct timespec begin, end;
            clock_gettime(CLOCK_MONOTONIC, &begin);
            fmi2SetReal(c, inputs, N_INPUTS, path[k + 1]);
            if (fmi2DoStep(c, k * h, h, 1)) return 3;
            fmi2GetReal(c, outputs, N_OUTPUTS, found);
            clock_gettime(CLOCK_MONOTONIC, &end);
            spent[round * STEPS + k] =
                1e6 * (double)(end.tv_sec - begin.tv_sec) + 1e-3 * (double)(end.tv_nsec - begin.tv_nsec);
        }
    }
    printf("%ld\\n", heap_calls);
    fwrite(spent, sizeof *spent, ROUNDS * STEPS, stdout);
    return 0;
}
"""
WRAPPED = "-Wl,--wrap=malloc,--wrap=calloc,--wrap=realloc"


def measured(name: str, folder: Path) -> tuple[int, np.ndarray]:
    """Return the number of heap calls in all steps, and their times in us, shape (ROUNDS * STEPS,)."""
    scene = sc.scenes.REGISTRY[name]()
    model, path = inverse_model(scene), scene.reference
    for file, text in (fmu_sources(model, 2) | {"main.c": PROGRAM}).items():
        (folder / file).write_text(text, encoding="utf-8")
    sizes = {"STEPS": STEPS, "ROUNDS": ROUNDS, "DURATION": path.duration}
    options = ["-O3", "-ffp-contract=off", "-w", WRAPPED, *(f"-D{key}={value}" for key, value in sizes.items())]
    files = [*compiled_files(model, 2), "main.c"]
    subprocess.run([*c_compiler(), *options, *files, "-o", "timed", "-lm"], cwd=folder, check=True)
    jets = path.jet(np.linspace(path.start_time, path.end_time, STEPS + 1), model.own["orders"] - 1)
    given = " ".join(map(repr, jets.ravel().tolist())).encode()
    printed = subprocess.run([folder / "timed"], input=given, capture_output=True, check=True).stdout
    count, _, rest = printed.partition(b"\n")
    return int(count), np.frombuffer(rest)


def main() -> None:
    """Print percentiles, heap calls and histograms as tables in Markdown."""
    rows, bins = [], []
    for name in SCENES:
        with tempfile.TemporaryDirectory() as folder:
            heap_calls, spent = measured(name, Path(folder))
        middle, most, rare = np.percentile(spent, [50.0, 99.0, 99.99])
        counts = np.histogram(spent, [0.0, *EDGES, np.inf])[0]
        slowest = np.median(spent.reshape(ROUNDS, STEPS), axis=0).max()
        rows.append(f"| `{name}` | {middle:.2f} | {most:.2f} | {rare:.1f} | {slowest:.2f} | {heap_calls} |")
        bins.append(f"| `{name}` | {' | '.join(map(str, counts))} |")
    head = ("p50, us", "p99", "p99.99", "slowest without interruption", "heap calls")
    print("\n".join([f"| FMU | {' | '.join(head)} |", "|---" * (len(head) + 1) + "|", *rows, ""]))
    ends = [f"<= {edge:g} us" for edge in EDGES] + ["above"]
    print("\n".join([f"| FMU | {' | '.join(ends)} |", "|---" * (len(ends) + 1) + "|", *bins]))


if __name__ == "__main__":
    main()
