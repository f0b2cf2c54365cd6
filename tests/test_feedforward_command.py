"""`servocore feedforward`: the inputs of any scene from the command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_lines import servocore, table
from thinned import thinned

import servocore as sc
from servocore.cli import export, view
from servocore.cli.run_summary import summary
from servocore.scenes import REGISTRY

SCENES = thinned(REGISTRY, lambda name: name not in ("heavy_rope", "loop_manipulator"))  # which take seconds
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_has_its_inputs_along_a_file_of_its_own(name: str, tmp_path: Path) -> None:
    scene = REGISTRY[name]()
    outputs = [each.name for each in scene.model().outputs]
    file = tmp_path / "path.csv"
    file.write_text(sc.path_to_csv(scene.reference, outputs, each=40), encoding="utf-8")
    step = scene.reference.duration / 50
    done = servocore("feedforward", name, "--reference", file, "--step", step, "-o", tmp_path / "inputs.csv")
    assert done.exit_code == 0, done.stderr
    names, values = table((tmp_path / "inputs.csv").read_text(encoding="utf-8"))
    path = sc.from_csv(file, columns=outputs, rest_order=sc.Problem.of(scene).array.reference_order)
    expected = sc.solve(scene.with_reference(path), step=step)
    assert names[0] == "time"
    for column, each in zip(values.T[1:], names[1:], strict=True):
        assert (column == expected[each]).all()
    assert "at rest at start and end" in done.stderr
    assert "peak" in done.stderr


def with_units_and_commas(file: Path, scene: sc.Scene) -> Path:
    """Write a file of a path once more, with units in the header, semicolons and decimal commas."""
    header, _, rows = file.read_text(encoding="utf-8").partition("\n")
    units = {"time": "s", **{each.name: each.unit for each in scene.model().outputs}}
    names = [f"{name} [{units[name]}]" if name in units else name for name in header.split(",")]
    other = file.with_name("other.csv")
    other.write_text(";".join(names) + "\n" + rows.replace(",", ";").replace(".", ","), encoding="utf-8")
    return other


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_is_viewed_and_exported_along_a_file_of_its_own(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = REGISTRY[name]()
    outputs = [each.name for each in scene.model().outputs]
    file = tmp_path / "path.csv"
    file.write_text(sc.path_to_csv(scene.reference, outputs, each=40), encoding="utf-8")
    order = sc.Problem.of(scene).array.reference_order
    expected = sc.from_csv(file, columns=outputs, rest_order=order)
    shown: list[sc.Reference] = []
    # Making pages and FMUs has tests of its own for every scene: here is what the commands hand on.
    part = SimpleNamespace(why="")
    monkeypatch.setattr(view, "solve", lambda scene, **_: shown.append(scene.reference))
    monkeypatch.setattr(view, "live_part", lambda *_, **__: part)
    monkeypatch.setattr(view, "page_text", lambda *_: "page")
    monkeypatch.setattr(export, "require_built", lambda *_: None)
    monkeypatch.setattr(export, "export_trajectory", lambda _, __, options, **___: shown.append(options.path))
    page, fmu = tmp_path / "page.html", tmp_path / "path.fmu"
    viewed = servocore("view", name, "--reference", with_units_and_commas(file, scene), "-o", page)
    exported = servocore("export", name, "--trajectory", "--reference", file, "-o", fmu)
    assert (viewed.exit_code, exported.exit_code) == (0, 0), viewed.stderr + exported.stderr
    assert page.read_text() == "page"
    t = np.linspace(expected.start_time, expected.end_time, 41)
    for path in shown:
        assert path.smoothness >= order
        assert (path.jet(t, order) == expected.jet(t, order)).all()
    assert len(shown) == 2


def test_a_line_takes_a_law_that_is_smooth_enough_for_the_scene() -> None:
    done = servocore("feedforward", "cars", "--from", "0", "--to", "2", "--duration", "5", "--step", "0.5")
    names, values = table(done.stdout)
    scene = REGISTRY["cars"]().with_reference(sc.rest_to_rest((0.0,), (2.0,), 5.0))
    np.testing.assert_allclose(values[:, names.index("u")], sc.solve(scene, step=0.5)["u"], rtol=0, atol=1e-12)


def test_few_rows_are_waypoints_and_that_is_said() -> None:
    file = EXAMPLES / "working_cycle_waypoints.csv"
    done = servocore("feedforward", "rotary_crane", "--reference", file)
    asked = servocore("feedforward", "rotary_crane", "--waypoints", file)
    assert "its 7 rows are read as waypoints" in done.stderr
    assert done.stdout == asked.stdout


def test_few_rows_with_derivatives_are_a_path(tmp_path: Path) -> None:
    scene = REGISTRY["overhead_crane"]()
    file = tmp_path / "path.csv"
    file.write_text(sc.path_to_csv(scene.reference, ["x", "z"]), encoding="utf-8")
    done = servocore("feedforward", "overhead_crane", "--reference", file)
    names, values = table(done.stdout)
    assert "waypoints" not in done.stderr
    np.testing.assert_allclose(values[:, names.index("F")], sc.solve(scene)["F"], rtol=0, atol=1e-9)


def test_what_is_undefined_is_told_with_its_first_time() -> None:
    solution = sc.solve(REGISTRY["overhead_crane"](), step=0.3)
    values = solution.values.copy()
    values[4:6, solution.names.index("swing")] = np.nan
    assert "  swing: undefined in 2 of 11 rows, first at t = 1.2 s" in summary(replace(solution, values=values))
