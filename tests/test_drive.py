"""``crane-fmu drive``: plants of other people, driven by our inputs."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from command_lines import crane_fmu as run
from fmu_host import fmu_file, scratch
from pythonfmu.builder import FmuBuilder

LINE = ["--from", "5", "0", "-5", "--to", "4", "1", "-4", "--duration", "6"]
NAMES = {"M_b": "slew.torque", "F": "trolley.force", "M_w": "hoist.torque"}

# The crane in NumPy of `plain_crane`, which holds its inputs.
FOREIGN = """
import numpy as np
from plain_crane import CRANE, advance
from pythonfmu import Fmi2Causality, Fmi2Slave, Real

P = np.array(list(CRANE.parameter_values().values()))


class Foreign(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.tau, self.f, self.hoist = 0.0, 0.0, -98.1
        self.px, self.py, self.pz = 5.0, 0.0, -5.0
        self.x = np.array([5.0, 0.0, 5.0, 0.0, -5.0, 0, 0, 0, 0, 0])
        for name in ("tau", "f", "hoist"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        for name in ("px", "py", "pz"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))

    def do_step(self, t, h):
        self.x = advance(False, self.x, np.array([self.tau, self.f, self.hoist]), np.zeros(3), np.zeros(3), P, h)
        self.px, self.py, self.pz = map(float, self.x[2:5])
        return True
"""


def renamed() -> Path:
    """Our plant with other names for its inputs and with outputs of one word."""
    file = scratch() / "Other.fmu"
    with zipfile.ZipFile(fmu_file("CranePlant")) as source, zipfile.ZipFile(file, "w") as target:
        for name in source.namelist():
            data = source.read(name)
            if name == "modelDescription.xml":
                for ours, theirs in NAMES.items():
                    data = data.replace(f'name="{ours}"'.encode(), f'name="{theirs}"'.encode())
            target.writestr(name, data)
    return file


def maps(names: dict[str, str]) -> list[str]:
    return [part for ours, theirs in names.items() for part in ("--map", f"{ours}={theirs}")]


def farthest(said: str) -> float:
    return float(said.split(" is ")[1].split(" mm", maxsplit=1)[0])


@pytest.mark.parametrize("in_file", [False, True])
def test_our_own_plant_under_other_names_follows_the_path(tmp_path: Path, in_file: bool) -> None:
    given = maps(NAMES)
    if in_file:
        given = ["--map", str(tmp_path / "names.toml")]
        Path(given[1]).write_text("".join(f'{ours} = "{theirs}"\n' for ours, theirs in NAMES.items()), "utf-8-sig")
    result = run("drive", renamed(), *given, *LINE, "--output", tmp_path / "motion.csv")
    assert result.exit_code == 0, result.output
    assert farthest(result.stdout) < 2.0
    table = np.genfromtxt(tmp_path / "motion.csv", delimiter=",", names=True)
    assert table["time"][-1] == pytest.approx(6.0)
    assert 1e3 * table["distance"].max() == pytest.approx(farthest(result.stdout), rel=1e-2)


def test_a_foreign_plant_written_by_hand_follows_the_path_too(tmp_path: Path) -> None:
    (tmp_path / "foreign.py").write_text(FOREIGN)
    file = FmuBuilder.build_FMU(tmp_path / "foreign.py", dest=tmp_path)
    names = {"M_b": "tau", "F": "f", "M_w": "hoist", "x": "px", "y": "py", "z": "pz"}
    errors = []
    for step in ("0.01", "0.005"):
        result = run("drive", file, *maps(names), *LINE, "--step", step)
        assert result.exit_code == 0, result.output
        errors.append(farthest(result.stdout))
    assert errors[0] < 20.0
    assert errors[1] < 0.6 * errors[0]  # it holds its inputs: late by half a step, no more


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--map", "M_b=none"], "Other.fmu has no input 'none'; its inputs are slew.torque, trolley.force"),
        ([], "Other.fmu has no input 'M_b'; map one with --map M_b=NAME; its inputs are slew.torque"),
    ],
)
def test_what_is_wrong_is_one_sentence(arguments: list[str], sentence: str) -> None:
    result = run("drive", renamed(), *arguments, *LINE)
    run.assert_refused(result, sentence)


def test_a_load_that_starts_elsewhere_is_told() -> None:
    result = run("drive", renamed(), *maps(NAMES), "--set", "start.position[1]=5.1", *LINE)
    assert "It starts 0.1 m off its path: set the plant's start so that the load is at (5, 0, -5) m." in result.stdout
