"""The commands `servocore plan` and `crane-fmu plan` write the fastest motion as a table, or refuse in a sentence."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from command_lines import CommandLine, columns, table
from fmu_host import Host

import crane_fmu.cli.commands
import servocore as sc
from crane_fmu.build import build_fmu
from crane_fmu.catalogue import KINDS
from servocore.cli import commands

pytestmark = pytest.mark.usefixtures("empty_folder")

run, crane = CommandLine(commands.app, "servocore"), CommandLine(crane_fmu.cli.commands.app, "crane-fmu")
OVERHEAD = sc.scenes.overhead_crane()
LEVEL = ["--from", 0, -4, "--to", 5, -4]


def test_a_plan_of_any_scene_is_a_table_within_the_limits_and_a_picture() -> None:
    options = "--limit F=200 --step 0.05 -o p.csv --plot p.png --write-path way.csv"
    result = run("plan", "overhead_crane", *LEVEL, *options.split())
    assert result.exit_code == 0
    assert "3.46" in result.stdout.splitlines()[0]
    assert "limits          proved to be kept at all times" in result.stdout
    found = columns("p.csv")
    assert list(found) == ["time", "F", "M_w", "tension", "swing", "x", "z"]
    assert np.abs(found["F"]).max() <= 200.0
    assert found["x"][[0, -1]].tolist() == [0.0, 5.0]
    steps = np.diff(found["time"])
    assert steps.max() <= 0.05
    assert np.ptp(steps) < 1e-9
    assert Path("p.png").read_bytes().startswith(b"\x89PNG")
    way = sc.from_csv("way.csv", columns=("x", "z"))
    again = sc.ExactInversion(sc.scenes.overhead_crane().with_reference(way))(found["time"])
    off = np.abs(again - np.column_stack([found["F"], found["M_w"]])).max()
    assert off < 1e-3  # of 200 N: round-off by the fourth power of the step


def test_the_short_form_for_the_crane_writes_the_table_of_feedforward_and_the_swing_and_a_path_for_the_others() -> None:
    limits = [each for limit in ("M_b=1000", "F=60", "swing=5deg") for each in ("--limit", limit)]
    result = crane("plan", "--from", 5, 0, -5, "--to", -2, 2, -2, *limits, "--write-path", "way.csv")
    assert result.exit_code == 0
    names, rows = table(result.stdout)
    assert ",".join(names) == "time,M_b,F,M_w,phi,s,l,x,y,z,tension,swing"
    assert len(rows) == 201
    assert 7.1 < rows[-1, 0] < 7.2
    assert crane("feedforward", "--reference", "way.csv", *limits, "-o", "inputs.csv").exit_code == 0
    assert np.abs(columns("inputs.csv")["F"] - rows[:, 2]).max() < 1e-3
    fmu = build_fmu(Path("fmu"), kind=KINDS["LoadTrajectory"], path=sc.from_csv("way.csv"), targets="host")
    with Host(fmu) as host:
        host.set(profile="file").start(time=3.0)
        for now, after in ((3.0, rows[100, 0]), (rows[100, 0], rows[150, 0])):
            assert host.step(now, after - now), host.messages
            load = [host[f"load.position[{k}]"] for k in (1, 2, 3)]
            np.testing.assert_allclose(load, rows[rows[:, 0] == after, 7:10][0], atol=1e-9)


def test_a_plan_is_played_on_a_live_page_as_it_was_planned() -> None:
    path, report = sc.fastest(OVERHEAD, [(0, -4), (5, -4)], {"F": 200}, intervals=20)
    Path("way.csv").write_text(sc.path_to_csv(path, ["x", "z"]), encoding="utf-8")
    shown = run("view", "overhead_crane", "--reference", "way.csv", "--limit", "F=200", "-o", "v.html")
    assert shown.exit_code == 0, shown.stderr
    found = re.search(r'"duration":([\d.]+)', Path("v.html").read_text(encoding="utf-8"))
    assert found is not None
    assert float(found[1]) == pytest.approx(report.duration, abs=1e-9)
    t = np.linspace(0.0, report.duration, 4001)
    back = sc.from_csv("way.csv", columns=("x", "z"))
    np.testing.assert_allclose(back.jet(t, 0), path.jet(t, 0), atol=1e-6)
    assert np.abs(OVERHEAD.with_reference(back).exact(t)["F"]).max() <= 200.0


def test_sensitivities_are_a_table_a_file_and_a_picture() -> None:
    result = run("sensitivities", "overhead_crane", "--wrt", "load_mass", "-o", "s.csv", "--plot", "s.svg")
    assert result.exit_code == 0
    assert "\nload_mass  " in result.stdout
    assert "x drift" in result.stdout
    found = columns("s.csv")
    assert list(found) == ["time", *(f"{each}/load_mass" for each in ("F", "M_w", "x drift", "z drift"))]
    assert found["M_w/load_mass"][0] == pytest.approx(-0.981)
    assert "<svg" in Path("s.svg").read_text(encoding="utf-8")
