"""Independent simulation tools: each runs every FMU in a process of its own and must get what `solve` gets.

The tools come with the extra `masters` (`pip install -e .[masters]`; ecos also needs the system's libtbb12). Tests with
a tool that is missing are skipped; with SERVOCORE_REQUIRE_MASTERS set, as in .ci/run, they fail.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_model_description
from fmu_host import JET, OUTPUTS, described, fmu_file, in_a_process, scratch
from processes import in_bare_environment, python

import servocore as sc
from crane_fmu.build import build_fmu
from crane_fmu.build.native import native_model
from crane_fmu.catalogue import KINDS, ORDERS, ROTARY_CRANE
from servocore.export.fmu import written

CRANE = sc.scenes.rotary_crane()
STEP, COUNT = 0.1, 60
TOLERANCE = 1e-9  # of each output's peak

# Each script gets a `task` and prints rows of outputs. Where a master runs several, a second instance has nothing
# connected.
HEAD = """
import json, sys
from pathlib import Path
task = json.loads(Path(sys.argv[1]).read_text())
jets, names, wanted, step = task["jets"], task["inputs"], task["outputs"], task["step"]
rows = []
"""

FMPY = """
import fmpy, numpy as np
# inputs of the end of a step are set at its start, but for the initialization; see docs/fmu.md
times = [-step, 0.0] + [step * k for k in range(len(jets) - 1)]
table = np.zeros(len(times), dtype=[("time", float), *((name, float) for name in names)])
table["time"] = times
for row, jet in zip(table, [jets[0], *jets]):
    for name, value in zip(names, jet):
        row[name] = value
result = fmpy.simulate_fmu(
    task["file"], start_time=0.0, stop_time=step * (len(jets) - 1), output_interval=step, input=table,
    output=wanted,
)
rows = [[float(row[name]) for name in wanted] for row in result]
"""

ECOSPY = """
import os
from ecospy import EcosSimulation, EcosSimulationStructure
with EcosSimulationStructure() as structure:
    structure.add_model("crane", task["file"])
    structure.add_model("another", task["file"])
    initial = dict(zip(names, map(float, jets[0])))
    structure.add_parameter_set("initial", {f"crane::{name}": value for name, value in initial.items()})
    with EcosSimulation(structure=structure, step_size=step) as simulation:
        assert simulation.init(parameter_set="initial")
        rows.append([simulation.get_real(f"crane::{name}") for name in wanted])
        for jet in jets[1:]:
            for name, value in zip(names, jet):
                simulation.set_real(f"crane::{name}", value)
            simulation.step()
            rows.append([simulation.get_real(f"crane::{name}") for name in wanted])
"""

LIBCOSIM = """
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimManipulator import CosimManipulator
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave
execution = CosimExecution.from_step_size(round(step * 1e9))
slave = execution.add_local_slave(CosimLocalSlave(fmu_path=task["file"], instance_name="crane"))
execution.add_local_slave(CosimLocalSlave(fmu_path=task["file"], instance_name="another"))
references = task["references"]
inputs, outputs = [references[name] for name in names], [references[name] for name in wanted]
for reference, value in zip(inputs, jets[0]):
    assert execution.real_initial_value(slave, reference, value)
observer, manipulator = CosimObserver.create_last_value(), CosimManipulator.create_override()
assert execution.add_observer(observer) and execution.add_manipulator(manipulator)
for jet in jets[1:]:
    assert not inputs or manipulator.slave_real_values(slave, inputs, jet)
    assert execution.step()
    rows.append(list(observer.last_real_values(slave, outputs)))
"""

TAIL = "\nprint('rows:', json.dumps(rows), flush=True)\n"

MASTERS = {"fmpy": FMPY, "ecospy": ECOSPY, "libcosimpy": LIBCOSIM}


@cache
def missing(module: str) -> str:
    """Return why a tool cannot be used, or nothing."""
    if find_spec(module) is None:
        return f"{module} is not installed: pip install -e .[masters]"
    done = in_a_process(f"import {module}")
    if done.returncode:
        return f"{module} does not load (ecos needs libtbb12): {done.stderr.strip().splitlines()[-1]}"
    return ""


def required(module: str) -> None:
    """Skip, or fail where masters are required, if a tool is missing or does not load."""
    if reason := missing(module):
        (pytest.fail if os.environ.get("SERVOCORE_REQUIRE_MASTERS") else pytest.skip)(reason)


@cache
def solution() -> sc.Solution:
    return sc.solve(CRANE, sc.Reduced(), step=STEP)


def task(file: Path, jets: list[list[float]], inputs: Sequence[str], outputs: Sequence[str]) -> dict[str, object]:
    """Return what a script is given: a file, inputs at the ends of all steps, and the outputs to print."""
    references = {each.name: each.valueReference for each in read_model_description(str(file)).modelVariables}
    return {
        "file": str(file),
        "step": STEP,
        "jets": jets,
        "inputs": inputs,
        "outputs": outputs,
        "references": references,
    }


def in_master(script: str, given: dict[str, object], place: Path) -> np.ndarray:
    place.write_text(json.dumps(given))
    done = in_a_process(HEAD + script + TAIL, place)
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"
    (line,) = [each for each in done.stdout.splitlines() if each.startswith("rows: ")]
    return np.array(json.loads(line.removeprefix("rows: ")))


@cache
def at_end(native: bool, connected: str = ORDERS[-1]) -> Path:
    """Return an FMU built for inputs of the end of a step: not every master sets enumerations."""
    starts = {"input_time": "end", "connected": connected}
    if not native:
        return build_fmu(scratch() / f"{connected} at end", starts=starts, targets="host")
    file = scratch() / f"native {connected} at end.fmu"
    return written(native_model(ROTARY_CRANE, starts=starts), file, 2, "host", lambda _: None)


@pytest.mark.parametrize("native", [False, True], ids=["Python", "native"])
@pytest.mark.parametrize("master", MASTERS)
def test_every_master_gets_what_solve_gets(master: str, native: bool, tmp_path: Path) -> None:
    required(master)
    file = at_end(native)
    wanted = solution()
    times = wanted.t[40 : 40 + COUNT + 1] - wanted.t[40]  # in motion from the first step
    jets = CRANE.reference.jet(wanted.t[40 : 40 + COUNT + 1], 4)
    given = task(file, jets.reshape(len(times), -1).tolist(), JET, OUTPUTS)
    found = in_master(MASTERS[master], given, tmp_path / "task.json")
    assert len(found) in (COUNT, COUNT + 1)  # libcosim does not show the initial values
    for name, column in zip(OUTPUTS, found.T, strict=True):
        exact = wanted[name][40 : 40 + COUNT + 1][-len(found) :]
        worst = np.abs(column - exact).max() / np.abs(wanted[name]).max()
        assert worst < TOLERANCE, f"{name} differs by {worst:.1e} of its peak"


@pytest.mark.nightly
@pytest.mark.parametrize("count", [1, 2], ids=["position", "velocity"])
@pytest.mark.parametrize("master", MASTERS)
def test_both_fmus_estimate_the_same_in_every_master(master: str, count: int, tmp_path: Path) -> None:
    required(master)
    jets = CRANE.reference.jet(solution().t[40 : 40 + COUNT + 1], count - 1).reshape(COUNT + 1, -1)
    found = []
    for script, native in ((FMPY, True), (MASTERS[master], True), (MASTERS[master], False)):
        given = task(at_end(native, ORDERS[count - 1]), jets.tolist(), JET[: jets.shape[1]], OUTPUTS)
        found.append(in_master(script, given, tmp_path / "task.json")[-COUNT:])
    assert (np.abs(np.subtract(found[1:], found[0])).max(axis=(0, 1)) < 1e-13 * np.abs(found[0]).max(axis=0)).all()


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("master", MASTERS)
def test_every_fmu_runs_in_every_master_with_nothing_connected(master: str, name: str, tmp_path: Path) -> None:
    required(master)
    outputs = [each.name for each in described(name, "output")]
    found = in_master(MASTERS[master], task(fmu_file(name), [[]] * 11, (), outputs), tmp_path / "task.json")
    assert len(found) in (10, 11)  # libcosim does not show the initial values
    assert np.isfinite(found).all()


@pytest.mark.parametrize("name", KINDS)
def test_fmutool_finds_no_problems(name: str) -> None:
    required("fmu_manipulation_toolbox")
    code = "import sys; from fmu_manipulation_toolbox.cli.fmutool import fmutool; sys.exit(fmutool())"
    done = python("-c", code, "-input", fmu_file(name), "-check", folder=scratch())
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    assert "WARNING" not in said
    assert "ERROR" not in said


@pytest.mark.parametrize("name", KINDS)
def test_the_command_line_of_ecos_a_native_host_runs_every_fmu(name: str, tmp_path: Path) -> None:
    required("ecospy")
    program = Path(str(find_spec("ecospy").origin)).parent / "binaries" / "ecos"  # type: ignore[union-attr]  # it is there
    if not program.is_file():
        pytest.skip("this ecospy has no command line")
    copy = tmp_path / "ecos"  # the package forgets to make it executable
    shutil.copy(program, copy)
    copy.chmod(0o755)
    options = ("--path", fmu_file(name), "--stopTime", "1", "--stepSize", "0.1")
    done = in_bare_environment(copy, "simulate", *options, folder=tmp_path, HOME=str(tmp_path))
    assert done.returncode == 0, done.stdout + done.stderr
    (table,) = tmp_path.glob("*.csv")
    head, *rows = [line.split(", ") for line in table.read_text().splitlines()]
    assert len(rows) == 11
    if name == "RotaryCrane":
        last = dict(zip(head, rows[-1], strict=True))
        assert float(last["instance::M_w[REAL]"]) == pytest.approx(-98.1, abs=1e-6)
        assert float(last["instance::l[REAL]"]) == pytest.approx(5.0, abs=1e-6)
