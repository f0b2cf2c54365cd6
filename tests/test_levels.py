"""What the models of a scene cost: sizes that count, errors that hold, text for humans and machines."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from present import present

import servocore as sc
from benchmarks.levels.__main__ import main
from benchmarks.levels.costs import Cost, Level, Spread
from benchmarks.levels.measurement import compiled_run, measure_levels, timed_in_turn
from benchmarks.levels.tables import (
    HEADINGS,
    csv_text,
    markdown_page,
    read_levels,
    remarks,
    rows,
)

INSTANTS = 50


@cache
def levels(name: str) -> tuple[Level, ...]:
    return measure_levels(sc.scenes.REGISTRY[name](), instants=INSTANTS, repeats=2)


def error_of(level: Level, route: str) -> float:
    return present(level.costs[route].error)


def test_levels_count_coordinates_and_unknowns_of_every_model_of_the_crane() -> None:
    found = [
        (each.model, each.needed, each.coordinates, each.costs["exact"].unknowns, each.costs["projected"].unknowns)
        for each in levels("rotary_crane")
    ]
    assert found == [
        ("points", True, 9, 42, 25),
        ("generalized", False, 5, 18, 13),
        ("bodies", False, 42, 172, 124),
    ]
    assert {(each.index, each.internal_degrees_of_freedom) for each in levels("rotary_crane")} == {(5, 0)}


def test_exact_inversion_is_exact_and_the_projected_step_is_not() -> None:
    for level in levels("rotary_crane"):
        assert error_of(level, "exact") < 1e-12
        assert 0.1 < error_of(level, "projected") < 2.0


def test_internal_dynamics_are_integrated_and_said_to_be() -> None:
    found = levels("mass_on_car")
    assert [each.internal_degrees_of_freedom for each in found] == [2, 2]
    assert all(error_of(level, "exact") < 1e-4 for level in found)
    assert "It has internal dynamics of 2 states" in " ".join(remarks(found))


def test_a_spread_is_median_and_quartiles() -> None:
    assert Spread.of([4.0, 1.0, 2.0, 3.0, 5.0]) == Spread(3.0, 2.0, 4.0)
    assert Spread.of([7.0]) == Spread(7.0, 7.0, 7.0)


def test_the_measured_run_is_the_one_that_solve_returns() -> None:
    scene = sc.scenes.rotary_crane()
    for method in (sc.BackwardEuler(), sc.RadauIIA(2), sc.BDF(3)):
        states = compiled_run(scene, sc.Projected(), method, "points", INSTANTS)()[0]
        stepper = sc.Stepper(scene, sc.Projected(), method, 20.0 / INSTANTS)
        solution = sc.solve(scene, sc.Projected(), method, step=20.0 / INSTANTS)
        last = stepper.values(states[:, -1], scene.reference.jet(20.0, stepper.start_order))
        for name in ("M_b", "F", "M_w"):
            assert last[name] == pytest.approx(solution[name][-1], rel=1e-9)


def test_runs_are_timed_in_turn_after_a_round_to_warm_up() -> None:
    order: list[str] = []
    seconds = timed_in_turn({name: partial(order.append, name) for name in "ab"}, 2)
    assert "".join(order) == "ababab"
    assert {name: len(each) for name, each in seconds.items()} == {"a": 2, "b": 2}


def test_a_route_that_a_model_does_not_offer_says_why_and_the_others_are_measured() -> None:
    massless = replace(sc.scenes.cars().model(), mass=sc.scenes.cars().model().mass[:, :] * 0)
    scene = replace(sc.scenes.cars(), models={"massless": lambda: massless})
    (level,) = measure_levels(scene, instants=INSTANTS, repeats=1)
    assert "needs inertia in the servo constrained directions" in level.costs["projected"].refusal
    assert level.costs["exact"].microseconds is not None
    assert rows(level)[1][4:] == ("projected", "-", "-", "-", "-", "-")
    assert rows(level)[0][8] == "-"
    assert any(each.startswith("massless, projected: ") for each in remarks([level]))
    lines = list(csv.DictReader(io.StringIO(csv_text([level], "here"))))
    assert lines[1]["microseconds"] == ""
    assert "needs inertia" in lines[1]["refusal"]


def test_unstable_internal_dynamics_are_not_stepped_forward() -> None:
    unstable = sc.scenes.mass_on_car().with_parameters(stiffness=-5.0)
    found = measure_levels(unstable, instants=INSTANTS, repeats=1)
    assert {cost.microseconds for level in found for cost in level.costs.values()} == {None}
    assert any("StableInversion" in each for each in remarks(found))


def test_a_scene_without_an_exact_answer_has_costs_but_no_errors() -> None:
    scene = replace(sc.scenes.cars(), closed_form=None)
    (level,) = measure_levels(scene, instants=INSTANTS, repeats=1)
    assert [cost.error for cost in level.costs.values()] == [None, None]
    assert [row[-1] for row in rows(level)] == ["-", "-"]


@pytest.mark.parametrize(
    ("instants", "repeats", "lacking"),
    [(0, 1, "instant is needed, not 0"), (1, 0, "repeat is needed, not 0"), (-3, 5, "instant is needed, not -3")],
)
def test_nothing_to_measure_is_refused(instants: int, repeats: int, lacking: str) -> None:
    with pytest.raises(sc.InvalidSetting, match=f"at least one {lacking}"):
        measure_levels(sc.scenes.cars(), instants=instants, repeats=repeats)


def test_the_page_is_the_same_from_the_file() -> None:
    refused = Level("massless", "points", True, 3, 5, 0, {"exact": Cost(9), "projected": Cost(refusal="no inertia")})
    found = [*levels("rotary_crane"), refused]
    again, on = read_levels(csv_text(found, "here"))
    pages = [markdown_page(each, instants=INSTANTS, repeats=2, on=on) for each in (found, again)]
    assert pages[0] == pages[1]
    assert "massless, points, projected: no inertia." in pages[1]


def test_the_page_that_is_committed_belongs_to_the_file_beside_it(tmp_path: Path) -> None:
    docs = Path(__file__).resolve().parent.parent / "docs"
    main(["--stored", str(docs / "model-levels.csv"), "--page", str(tmp_path / "page.md")])
    assert (tmp_path / "page.md").read_bytes() == (docs / "model-levels.md").read_bytes()


def test_the_ratio_is_that_of_the_medians() -> None:
    costs = {
        "exact": Cost(9, Spread(3.0, 2.0, 4.0), 1e-15),
        "projected": Cost(5, Spread(1.5, 1.0, 2.0), 1e-2),
    }
    first, second = rows(Level("cars", "points", True, 2, 5, 0, costs))
    assert first == ("points", "2", "5", "0", "exact", "9", "3", "2 to 4", "2", "1.0e-15")
    assert second == ("", "", "", "", "projected", "5", "1.5", "1 to 2", "1", "1.0e-02")
    np.testing.assert_equal(len(first), len(HEADINGS))


def test_the_command_prints_a_table_and_writes_the_same_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, page = tmp_path / "levels.csv", tmp_path / "levels.md"
    main(["cars", "--instants", "20", "--csv", str(file), "--page", str(page)])
    printed = capsys.readouterr().out
    assert "cars has one model, points." in printed
    lines = list(csv.DictReader(file.read_text(encoding="utf-8").splitlines()))
    assert [(each["route"], each["unknowns"]) for each in lines] == [
        ("exact", "9"),
        ("projected", lines[1]["unknowns"]),
    ]
    assert f"{float(lines[0]['microseconds']):.3g}" in printed
    assert "| cars | points |" in page.read_text(encoding="utf-8")


def test_a_scene_that_there_is_not_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["train"])
    assert "no scene is called train" in capsys.readouterr().err
