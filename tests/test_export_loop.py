"""The whole system in C goes where the one in Python goes: cranes, paths, masters, steps, feedback, estimates."""

from __future__ import annotations

import os
import warnings
import zipfile
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command_lines import CommandLine, write
from fmpy import simulate_fmu
from fmpy.ssp.simulation import simulate_ssp
from fmu_host import scratch
from loops import Case, Loop, fastest, jets_of, random_case
from native_fmu import path_of
from present import of_kind, present
from test_ssp import MASTERS, places, system
from thinned import thinned

import servocore as sc
from crane_fmu.build import Wishes, build_fmu, build_ssp
from crane_fmu.catalogue import FROM_FILE, KINDS
from crane_fmu.cli.commands import app as crane_app
from crane_fmu.run import nothing_left
from servocore.numerics.compiled_calls import Array
from servocore.references.csv_file import csv_of
from servocore.references.rest_to_rest import RestToRest

FULL = os.environ.get("SERVOCORE_NATIVE") == "full"

pytestmark = pytest.mark.usefixtures("compiler")
crane = CommandLine(crane_app, "crane-fmu")


# Random cranes and paths, in masters of our own ----------------------------------------------------------------------

CONNECTED = ("snap", "velocity", "position")
SEEDS = range(40) if FULL else range(1)


def way(case: Case, h: float, at: str, seconds: float, native: bool, **settings: float | str) -> Array:
    """Return where the load is after each step, shape (N, 3)."""
    jets = jets_of(case.reference, h)[: round(seconds / h) + 1]
    with Loop(case, at, native, **settings) as loop:
        return np.array([loop.step(jets, k, h) for k in range(len(jets) - 1)])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("connected", CONNECTED)
@pytest.mark.parametrize(("h", "seconds"), [(0.1, 30.0), (0.01, 30.0 if FULL else 4.0)])
@pytest.mark.parametrize("at", ["start", "end"])
def test_any_crane_goes_where_that_in_python_goes(at: str, h: float, seconds: float, connected: str, seed: int) -> None:
    random = np.random.default_rng([seed, CONNECTED.index(connected), at == "end"])
    disturbed = bool(random.integers(2))
    cases = (random_case(random, any_crane=True, disturbed=disturbed) for _ in range(100))
    case = next(each for each in cases if fastest(each) * h <= 1.0)
    python, native = (way(case, h, at, seconds, each, connected=connected) for each in (False, True))
    assert np.abs(native - python).max() < 1e-9, case


# Real masters --------------------------------------------------------------------------------------------------------

PUSHED = {"plant.gust[1]": 20.0, "plant.gust_start": 8.03, "plant.gust_duration": 2.0, "plant.mass_error": 0.05}


@cache
def systems(connected: str, seed: int | None = None) -> tuple[Path, ...]:
    """Return the system in Python and the native one whose inverse models are told no more than a derivative.

    With a seed, of a crane and with a path by chance.
    """
    parts, told = list[Path](), connected != "snap" or seed is not None
    wishes: dict[str, Any] = {"parameters": {"connected": connected}} if told else {}
    if seed is not None:
        case = random_case(np.random.default_rng(seed), any_crane=True)
        path = of_kind(RestToRest, case.reference)
        wishes["profile"] = path.profile.name.replace("degree-", "degree")
        wishes["parameters"] |= {**case.crane, "duration": path.duration}
        for vector, place in (("start", path.start), ("end", path.end), ("start.position", path.start)):
            wishes["parameters"] |= {f"{vector}[{k}]": place[k - 1] for k in (1, 2, 3)}
        wishes["parameters"] |= {f"load.position[{k}]": path.start[k - 1] for k in (1, 2, 3)}
    for native in (False, True):
        folder = scratch() / f"{connected} {native} {seed}"
        if native or told:
            build_ssp(folder, wishes=Wishes(native=native, targets="host", **wishes))
        parts.append(folder / "Crane.ssp" if native or told else system())
    return tuple(parts)


def by_fmpy(file: Path, stop: float, h: float, settings: dict[str, float]) -> Array:
    """Return where the load goes in FMPy's own master, shape (3, N)."""
    values = [SimpleNamespace(name=name, value=value) for name, value in settings.items()]
    with nothing_left(), warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        given = SimpleNamespace(parameters=values)
        rows = simulate_ssp(str(file), stop_time=stop, step_size=h, parameter_set=given)
    assert len(rows) >= round(stop / h)
    return np.array([rows[f"plant.load.position[{k}]"] for k in (1, 2, 3)])


@pytest.mark.skipif(not FULL, reason="make native")
@pytest.mark.parametrize("settings", [{}, {"crane.feedback": 0.0}, PUSHED], ids=["feedback", "feedforward", "pushed"])
@pytest.mark.parametrize("h", [0.1, 0.01])
@pytest.mark.parametrize("connected", ["snap", "velocity", "position"])
def test_the_native_system_goes_where_the_one_in_python_goes(
    connected: str, h: float, settings: dict[str, float]
) -> None:
    python, native = (by_fmpy(file, 20.0, h, settings) for file in systems(connected))
    assert np.abs(native - python).max() < 1e-9


@pytest.mark.skipif(not FULL, reason="make native")
@pytest.mark.parametrize("h", [0.1, 0.01])
@pytest.mark.parametrize("package", MASTERS)
@pytest.mark.parametrize("connected", ["snap", "position"])
def test_other_masters_take_the_native_system_where_the_one_in_python_goes(
    connected: str, package: str, h: float
) -> None:
    python, native = (places(package, file, round(15.0 / h), h) for file in systems(connected))
    assert np.abs(native - python).max() < 1e-9


@pytest.mark.skipif(not FULL, reason="make native")
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("h", [0.1, 0.01])
@pytest.mark.parametrize("master", ["fmpy", *MASTERS])
def test_every_master_takes_any_native_crane_where_the_one_in_python_goes(master: str, h: float, seed: int) -> None:
    if master == "fmpy":
        python, native = (by_fmpy(file, 10.0, h, PUSHED) for file in systems("snap", seed))
    else:
        python, native = (places(master, file, round(8.0 / h), h) for file in systems("snap", seed))
    assert np.abs(native - python).max() < 1e-9


@pytest.mark.skipif(not FULL, reason="make native")
def test_path_and_crane_of_ones_own_are_in_the_native_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write("path.csv", csv_of(present(path_of("rotary_crane"))))
    write("heavy.toml", "load_mass = 80.0\n")
    options = ("--native", "--targets", "host", "--reference", "path.csv", "--parameters", "heavy.toml")
    assert crane("ssp", *options).exit_code == 0
    with nothing_left():
        rows = simulate_ssp("system/Crane.ssp", stop_time=20.0, step_size=0.01)
    wanted, found = (np.array([rows[f"{n}.load.position[{k}]"] for k in (1, 2, 3)]) for n in ("trajectory", "plant"))
    np.testing.assert_allclose(wanted.T, present(path_of("rotary_crane")).jet(rows["time"] + 0.01, 0)[:, 0], atol=1e-12)
    assert np.abs(wanted - found).max() < 1e-4
    assert rows["plant.tension"][0] == pytest.approx(80.0 * 9.81, rel=1e-2)
    with zipfile.ZipFile("system/Crane.ssp") as archive:
        for name in archive.namelist():
            if name.endswith(".fmu"):
                with zipfile.ZipFile(archive.open(name)) as fmu:
                    assert not any(each.endswith(".py") or "python" in each for each in fmu.namelist())


@pytest.mark.parametrize("seed", thinned(range(3), lambda seed: seed == 0))
def test_a_path_from_a_file_is_the_same_in_both_systems(seed: int, tmp_path: Path) -> None:
    random = np.random.default_rng(seed)
    path = random_case(random, any_crane=False).reference
    t = np.linspace(path.start_time, path.end_time, round(path.duration / 0.07) + 1)
    rows = np.column_stack([t, path.jet(t, 0)[:, 0]])
    file = tmp_path / "path.csv"
    file.write_text("time,x,y,z\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows.tolist()))
    read = sc.from_csv(file, 1e-6)
    written = sc.export_trajectory(
        sc.scenes.rotary_crane(), tmp_path / "native.fmu", sc.TrajectoryWishes(read), fmi=2, targets="host"
    )
    python = build_fmu(tmp_path, kind=KINDS["LoadTrajectory"], path=read, starts={"profile": FROM_FILE}, targets="host")
    jets = []
    for trajectory in (python, written):
        with nothing_left():
            found = simulate_fmu(str(trajectory), stop_time=path.end_time, output_interval=0.1)
        jets.append(np.array([found[name] for name in found.dtype.names or () if name.startswith("load.")]))
    assert jets[0].shape == (15, len(found))
    np.testing.assert_allclose(jets[1], jets[0], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("native", [(), ("--native",)], ids=["python", "native"])
def test_a_path_that_starts_before_the_run_is_refused(
    native: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write("path.csv", "time,x,y,z\n-3,5,0,-5\n13,4,3,-5\n")
    crane.assert_refused(
        crane("ssp", *native, "--waypoints", "path.csv"), "the path starts at t = -3 s, but the system's"
    )
    assert [each.name for each in tmp_path.iterdir()] == ["path.csv"]
