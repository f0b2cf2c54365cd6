"""What the standards ask of exported FMUs beyond their schemas: sources, descriptions, systems."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from native_fmu import FULL, Native, exported

from servocore.export.sources import compiled_files, fmu_sources

pytestmark = pytest.mark.usefixtures("compiler")

# Sources -------------------------------------------------------------------------------------------------------------

PROBE = """
#include "model.h"
#define FMI2_FUNCTION_PREFIX FUNCTION_PREFIX
#define FMI3_FUNCTION_PREFIX FUNCTION_PREFIX
#if FMI == 2
#include "fmi2Functions.h"
static void logger(fmi2ComponentEnvironment e, fmi2String i, fmi2Status s, fmi2String c, fmi2String m, ...) {}
double PROBE(void)
{
    const fmi2CallbackFunctions host = {logger, 0, 0, 0, 0};
    const fmi2ValueReference output = N_INPUTS;
    double found = NAN;
    fmi2Component c = fmi2Instantiate("probe", fmi2CoSimulation, INSTANTIATION_TOKEN, "", &host, 0, 0);
    if (c == NULL || fmi2EnterInitializationMode(c) || fmi2ExitInitializationMode(c) || fmi2DoStep(c, 0.0, 0.1, 1)
        || fmi2GetReal(c, &output, 1, &found)) return NAN;
    fmi2FreeInstance(c);
    return found;
}
#else
#include "fmi3Functions.h"
double PROBE(void)
{
    double found[16] = {NAN}, last;
    fmi3Boolean event, end, early;
    fmi3ValueReference output = 0;
    fmi3Instance c = fmi3InstantiateCoSimulation("probe", INSTANTIATION_TOKEN, "", 0, 0, 0, 0, 0, 0, 0, 0, 0);
    while (ARRAYS[output].first < N_INPUTS) output++;
    if (c == NULL || fmi3EnterInitializationMode(c, 0, 0.0, 0.0, 0, 0.0) || fmi3ExitInitializationMode(c)
        || fmi3DoStep(c, 0.0, 0.1, 1, &event, &end, &early, &last)
        || fmi3GetFloat64(c, &output, 1, found, ARRAYS[output].size)) return NAN;
    fmi3FreeInstance(c);
    return found[0];
}
#endif
"""
TEN = ("cars", "mass_on_car", "overhead_crane", "elastic_hoist", "rotary_crane trajectory", "cars plant",
       *(f"{name} trajectory" for name in ("cars", "mass_on_car", "overhead_crane", "gantry_crane")))  # fmt: skip


@pytest.mark.parametrize(("names", "fmi"), [(TEN[:2], 2), (TEN[:2], 3), (TEN, 2)])
def test_models_are_linked_into_one_program(
    names: tuple[str, ...], fmi: int, compiler: list[str], tmp_path: Path
) -> None:
    """FMI 2.0.5, 2.1.1: functions of sources begin with the model identifier, by the official headers."""
    if len(names) > 2 and not FULL:
        names = names[:2] + names[-4:]
    objects, probes = [], [f"probe_{k}" for k in range(len(names))]
    for name, probe in zip(names, probes, strict=True):
        folder = tmp_path / probe
        folder.mkdir()
        for file, text in (fmu_sources(exported(name), fmi) | {"probe.c": PROBE}).items():
            (folder / file).write_text(text, encoding="utf-8")
        files = *compiled_files(exported(name), fmi), "probe.c"
        subprocess.run([*compiler, "-std=c99", "-O0", "-w", "-c", f"-DFMI={fmi}", f"-DPROBE={probe}", *files],
                       cwd=folder, check=True)  # fmt: skip
        objects += [folder / Path(file).with_suffix(".o") for file in files]
    calls = "".join(f'printf("%.17g\\n", {each}());' for each in probes)
    declared = "".join(f"double {each}(void);" for each in probes)
    (tmp_path / "main.c").write_text(f"#include <stdio.h>\n{declared}\nint main(void) {{ {calls} return 0; }}\n")
    subprocess.run([*compiler, tmp_path / "main.c", *objects, "-o", tmp_path / "all", "-lm"], check=True)
    printed = subprocess.run([tmp_path / "all"], capture_output=True, text=True, check=True).stdout.split()
    for name, found in zip(names, printed, strict=True):
        with Native(name, fmi) as host:
            assert host.start().step(0.0, 0.1)
            assert float(found) == pytest.approx(host.values()[0], rel=1e-12, abs=1e-12)
        assert np.isfinite(float(found))
