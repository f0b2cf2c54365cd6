"""docs/scenes.md: every scene has its section, and what is claimed there is so."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from present import present

import servocore as sc

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "scenes.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^## (\w+)\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE))
BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
(PREAMBLE,) = BLOCK.findall(PAGE.partition("\n## ")[0])


def test_every_scene_has_a_section_and_every_section_a_scene() -> None:
    assert set(SECTIONS) == set(sc.scenes.REGISTRY)


def test_the_table_of_parameters_is_that_of_all_scenes_and_effects() -> None:
    script = DOCS / "write_parameters.py"
    assert runpy.run_path(str(script))["table"]() == (DOCS / "parameters.csv").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", SECTIONS)
def test_its_example_has_three_lines_and_runs(name: str) -> None:
    (example,) = BLOCK.findall(SECTIONS[name])
    assert len(example.strip().splitlines()) <= 4 if "import" in example else 3
    exec(compile(PREAMBLE + example, "docs/scenes.md", "exec", dont_inherit=True), {})


@pytest.mark.parametrize("name", SECTIONS)
def test_its_sketch_models_index_exact_answer_and_limits_are_there(name: str) -> None:
    section = SECTIONS[name]
    assert re.search(r"^     *.*[|/\\=\[]", section, re.MULTILINE)
    for heading in ("Needs", "Models", "Kind", "Exact answer", "Limits"):
        assert f"* **{heading}**" in section
    for model in sc.scenes.REGISTRY[name]().models:
        assert f"`{model}`" in section


@pytest.mark.parametrize("name", sc.scenes.REGISTRY)
def test_the_table_names_its_inputs_and_the_number_of_coordinates_of_its_models(name: str) -> None:
    (row,) = re.findall(rf"^\| \[`{name}`\].*", PAGE, re.MULTILINE)
    cells = [cell.strip() for cell in row.split("|")]
    scene = sc.scenes.REGISTRY[name]()
    assert cells[2] == ", ".join(each.name for each in scene.model().inputs)
    listed = dict(re.findall(r"`(\w+)` (\w+)", cells[3]))
    assert set(listed) == set(scene.models)
    for model, count in listed.items():
        assert count in ("n", "N") or int(count) == len(scene.model(model).coordinates)


@pytest.mark.parametrize("name", SECTIONS)
def test_the_errors_of_the_projected_form_are_those_of_the_page(name: str) -> None:
    percent, input_name = present(re.search(r"`Projected`: ([\d.]+) % of (\w+)", SECTIONS[name])).groups()
    scene = sc.scenes.REGISTRY[name]()
    solution = sc.solve(scene, sc.Projected(), sc.BackwardEuler(), step=scene.reference.duration / 800)
    exact = scene.exact(solution.t)[input_name]
    error = 100 * np.abs(solution[input_name] - exact).max() / np.abs(exact).max()
    assert error == pytest.approx(float(percent), rel=0.1)
