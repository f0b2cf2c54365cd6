"""Exported FMUs of every kind under a foreign maker's name, in tools that nobody here wrote.

`make native` exports all scenes. It asks these tools as well where they are given, nothing is downloaded: the simulator
``FMUSIM=path`` of Modelica's Reference FMUs (its program, or a folder with it), schemas ``FMI_SCHEMAS=folder`` and
``SSP_SCHEMAS=folder`` of the standards' projects, and the checker ``VDMCHECK="command"``, to which a file is added.
"""

from __future__ import annotations

import csv
import os
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest
from command_lines import servocore as run
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from fmu_host import members
from lxml import etree  # type: ignore[import-untyped]  # it has no types
from native_fmu import FULL, put_vendor, scene_called

import servocore as sc

pytestmark = pytest.mark.usefixtures("compiler", "empty_folder")

SCENES = sorted(sc.scenes.REGISTRY) if FULL else ["overhead_crane"]
KINDS = {"inverse": "--cross-check", "plant": "--plant", "trajectory": "--trajectory"}


def given(name: str) -> Path | None:
    """Return a tool or folder that the environment names."""
    place = os.environ.get(name)
    return Path(place) if place else None


def require_valid(document: bytes, folder: Path, schema: str) -> None:
    rules = etree.XMLSchema(etree.parse(folder / schema))
    assert rules.validate(etree.fromstring(document)), rules.error_log


def numbers(file: Path) -> dict[str, np.ndarray]:
    """Return the columns of a table, an array's in one cell."""
    with file.open(newline="", encoding="utf-8") as lines:
        names, *rows = csv.reader(lines)
    return {name: np.array([row[k].split() for row in rows], dtype=float) for k, name in enumerate(names)}


def judged_by_tools(file: Path, fmi: int) -> None:
    """Ask the validator of FMPy, and schemas and checker where they are given."""
    assert not validate_fmu(str(file))
    described = read_model_description(str(file))  # against FMPy's schemas
    assert (described.author, described.license) == ("Jane Doe, ACME & Sons", "proprietary")
    if (folder := given("FMI_SCHEMAS")) and (folder / f"fmi{fmi}ModelDescription.xsd").exists():
        require_valid(members(file)["modelDescription.xml"], folder, f"fmi{fmi}ModelDescription.xsd")
    if checker := os.environ.get("VDMCHECK"):
        done = subprocess.run([*shlex.split(checker), file], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout


def as_in_fmusim(file: Path, program: Path) -> None:
    """Compare a run of the reference simulator with `solve`: it sets inputs of the start of a step, told as its end."""
    program = program / "fmusim" if program.is_dir() else program
    options = dict(line.split(",") for line in file.with_name("x_ref.opt").read_text().splitlines())
    times = [options[name] for name in ("StartTime", "StopTime", "StepSize")]
    words = ["--interface-type", "cs", "--start-time", times[0], "--stop-time", times[1], "--output-interval", times[2],
             "--start-value", "input_time", "2", "--input-file", "x_in.csv", "--output-file", "out.csv"]  # fmt: skip
    subprocess.run([program.resolve(), *words, file], cwd=file.parent, check=True, capture_output=True, timeout=300)
    found, wanted = numbers(file.with_name("out.csv")), numbers(file.with_name("x_ref.csv"))
    for name in set(wanted) - {"time"}:
        count, peak = min(len(found[name]), len(wanted[name])), np.abs(wanted[name]).max()
        assert np.abs(found[name][1:count] - wanted[name][: count - 1]).max() <= 1e-9 * peak, name


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", SCENES)
def test_a_component_of_a_maker_is_valid_and_runs(name: str, kind: str, fmi: int, tmp_path: Path) -> None:
    put_vendor(tmp_path)
    line = ("export", name, KINDS[kind], "-o", "x.fmu", "--fmi", fmi, "--targets", "host", "--about", "vendor.toml")
    done = run(*line, "--no-certify")
    assert done.exit_code == 0, done.output
    judged_by_tools(tmp_path / "x.fmu", fmi)
    if kind == "inverse" and (program := given("FMUSIM")):
        as_in_fmusim(tmp_path / "x.fmu", program)


@pytest.mark.skipif(not given("SSP_SCHEMAS"), reason="SSP_SCHEMAS names no folder")
@pytest.mark.parametrize("name", SCENES)
def test_systems_are_valid_by_the_schemas_of_ssp_2(name: str, tmp_path: Path) -> None:
    folder, file = given("SSP_SCHEMAS"), sc.export_ssp(scene_called(name), tmp_path / "x.ssp", fmi=3, targets="host")
    assert folder is not None
    kinds = {".ssd": "Description", ".ssv": "ParameterValues", ".ssm": "ParameterMapping"}
    for member, document in members(file).items():
        if (ending := Path(member).suffix) in kinds:
            require_valid(document, folder, f"SystemStructure{kinds[ending]}.xsd")
