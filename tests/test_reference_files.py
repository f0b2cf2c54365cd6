"""Paths from CSV files: what is in the file comes back; what is wrong with it is named by line and column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from present import present
from test_references import relative_errors

import servocore as sc
from servocore.errors import InvalidReference
from servocore.numerics.compiled_calls import Array
from servocore.references.piecewise import hermite
from servocore.references.profiles import polynomial

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
GRAVITY = 9.81
LINE = sc.rest_to_rest((5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), 20.0)
CURVE = sc.through([[5, 0, -6], [5, 0, -3], [2, 4, -3], [-3, 4, -3], [-4, 3, -6]], [0, 12, 22, 31, 40])


def header(groups: int, columns: list[str] | str = "xyz") -> str:
    return ",".join(["time", *(prefix + name for prefix in ("", "v", "a", "j", "s")[:groups] for name in columns)])


def table(truth: sc.Reference, step: float, groups: int) -> Array:
    count = round(truth.duration / step) + 1
    t = np.linspace(truth.start_time, truth.end_time, count)
    return np.column_stack([t, truth.jet(t, groups - 1).reshape(count, -1)])


def write(path: Path, rows: Array, groups: int, fmt: str = "%.17g", columns: list[str] | str = "xyz") -> Path:
    np.savetxt(path, rows, fmt, ",", header=header(groups, columns), comments="")
    return path


@pytest.mark.parametrize("groups", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("truth", [LINE, CURVE], ids=["line", "curve"])
def test_a_file_gives_the_path_back_that_wrote_it_whatever_derivatives_it_holds(
    truth: sc.Reference, groups: int, tmp_path: Path
) -> None:
    path = sc.from_csv(write(tmp_path / "path.csv", table(truth, 0.1, groups), groups))
    assert relative_errors(path, truth, 4).max() < 1e-5
    assert present(path.fit_error) < 2e-12 * 6.0
    assert path.max_order == 9
    assert path.rests_before
    assert path.rests_after


@pytest.mark.parametrize("scene", [sc.scenes.overhead_crane(), sc.scenes.cars()], ids=lambda scene: scene.name)
@pytest.mark.parametrize("groups", [1, 5])
def test_columns_are_those_of_the_scene(scene: sc.Scene, groups: int, tmp_path: Path) -> None:
    columns = [each.name for each in scene.model().outputs]
    file = write(tmp_path / "path.csv", table(scene.reference, 0.01, groups), groups, columns=columns)
    path = sc.from_csv(file, columns=columns)
    assert scene.with_reference(path).reference.dimension == len(columns)
    t = np.linspace(scene.reference.start_time, scene.reference.end_time, 101)
    np.testing.assert_allclose(path.jet(t, 0), scene.reference.jet(t, 0), atol=1e-11)
    with pytest.raises(InvalidReference, match=r"header time,x,y,z.* was expected"):
        sc.from_csv(file)


@pytest.mark.parametrize("columns", [[], ["x", "x"], ["time"]])
def test_columns_need_names_of_their_own(columns: list[str], tmp_path: Path) -> None:
    with pytest.raises(InvalidReference, match="position columns with names of their own"):
        sc.from_csv(tmp_path / "path.csv", columns=columns)


def test_a_path_is_not_written_into_columns_of_one_name() -> None:
    for columns in (("x", "x", "z"), ("time", "y", "z")):
        with pytest.raises(sc.InvalidReference, match="position columns with names of their own"):
            sc.path_to_csv(sc.scenes.rotary_crane().reference, columns)


def test_a_wrong_derivative_is_named_by_the_column_that_was_asked_for(tmp_path: Path) -> None:
    rows = table(CURVE, 0.1, 2)
    rows[123, 5] += 0.1
    columns = ["east", "north", "up"]
    file = write(tmp_path / "bad.csv", rows, 2, columns=columns)
    with pytest.raises(InvalidReference, match=r"line 125 \(time 12.3 s\), column vnorth: "):
        sc.from_csv(file, columns=columns)


@pytest.mark.parametrize(("order", "smoothness"), [(1, 1), (2, 2), (4, 4)])
def test_as_many_derivatives_as_are_asked_for_make_a_hermite_path(order: int, smoothness: int, tmp_path: Path) -> None:
    truth = sc.rest_to_rest(LINE.start, LINE.end, 20.0, polynomial(2 * order + 1))
    path = sc.from_csv(write(tmp_path / "path.csv", table(truth, 20.0, order + 1), order + 1), rest_order=order)
    assert path.smoothness == smoothness
    assert relative_errors(path, truth, 2 * order + 1).max() < 1e-13


@pytest.mark.parametrize("step", [2.0, 0.5, 0.1, 0.01, 0.002])
@pytest.mark.parametrize("profile", [sc.DEGREE13, sc.three_phase(4.0)], ids=lambda p: p.name)
def test_rows_of_derivatives_keep_their_snap_however_dense_they_are(profile: sc.Profile, step: float) -> None:
    truth = sc.rest_to_rest(LINE.start, LINE.end, 20.0, profile)
    rows = table(truth, step, 5)
    path, worst = hermite(rows[:, 0], rows[:, 1:].reshape(-1, 5, 3))
    assert relative_errors(path, truth, 4)[4] < 1e-2  # with every row in use: far above 1 at 2 ms
    assert present(worst).fraction < 0.5
    np.testing.assert_allclose(path.jet(rows[:, 0], 0)[:, 0], rows[:, 1:4], rtol=0.0, atol=1e-12)


def test_rows_that_move_at_their_ends_are_continued_by_the_end_polynomials() -> None:
    t = np.linspace(0.0, 3.0, 31)
    derivatives = np.stack([np.sin(t + k * np.pi / 2) for k in range(5)], axis=1)[:, :, None]
    path, _ = hermite(t, derivatives)
    np.testing.assert_allclose(path.jet([-0.05, 3.05], 2)[:, 0, 0], np.sin([-0.05, 3.05]), atol=1e-10)
    assert not path.rests_before
    assert path.smoothness == 4


def test_a_path_at_rest_stays_where_it_is() -> None:
    path, _ = hermite(np.arange(5.0), np.zeros((5, 5, 3)))
    assert not path.jet([0.0, 2.5, 9.0], 9).any()


def test_rounded_positions_need_a_tolerance(tmp_path: Path) -> None:
    for groups in (1, 2):
        file = write(tmp_path / f"{groups}.csv", table(CURVE, 0.05, groups), groups, fmt="%.6f")
        with pytest.raises(InvalidReference, match="need a tolerance"):
            sc.from_csv(file)
        assert relative_errors(sc.from_csv(file, tolerance=1e-6), CURVE, 4).max() < 1e-3


@pytest.mark.parametrize("tolerance", [None, 1e-6])
def test_rounded_rows_of_all_derivatives_are_good_enough_as_they_are(tolerance: float | None, tmp_path: Path) -> None:
    file = write(tmp_path / "path.csv", table(CURVE, 0.05, 5), 5, fmt="%.6f")
    assert relative_errors(sc.from_csv(file, tolerance), CURVE, 4).max() < 2e-3


@pytest.mark.parametrize("groups", [2, 3, 5])
def test_a_derivative_of_the_wrong_sign_contradicts_the_positions(groups: int, tmp_path: Path) -> None:
    rows = table(CURVE, 0.1, groups)
    rows[:, -3] *= -1.0
    with pytest.raises(InvalidReference, match=r"bad\.csv, line \d+ \(time .* s\), column [vajs]?x: .* contradict"):
        sc.from_csv(write(tmp_path / "bad.csv", rows, groups))


def test_a_rough_file_is_refused_with_its_name_and_the_time(tmp_path: Path) -> None:
    rows = table(CURVE, 0.1, 1)
    rows[rows[:, 0] > 17.0, 3] += 0.01
    with pytest.raises(InvalidReference, match=r"rough\.csv: the samples are too rough near t = 17.* in position"):
        sc.from_csv(write(tmp_path / "rough.csv", rows, 1))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "line 1: the file is empty, but a header time,x,y,z was expected"),
        ("\n \n", "the file is empty"),
        ("seconds,x,y,z\n0,1,2,3\n", "line 1: the header time,x,y,z, .* was expected, but 'seconds,x,y,z' was found"),
        ("time,x,y,z,ax,ay,az\n", "optionally followed by vx,vy,vz, then ax,ay,az.* was expected"),
        ("time,x,y,z\n", "line 1: there is a header but no rows"),
        ("time,x,y,z\n0,1,2,3\n1,1,2\n", "line 3: 3 cells were found, but the header has 4 columns"),
        ("time,x,y,z\n0,1,2,3\n1,1,2,3,4\n", "line 3: 5 cells"),
        ("time,x,y,z\n0,1,2,3\n\n1,1,two,3\n", "line 4, column y: 'two' is not a finite number"),
        ("time,x,y,z\n0,1,2,nan\n", "line 2, column z: 'nan' is not a finite number"),
        ("time,x,y,z\n0,1,,3\n", "line 2, column y: '' is not a finite number"),
        ("time,x,y,z\ninf,1,2,3\n", "line 2, column time: 'inf'"),
        ("time,x,y,z\n0,1,2,3\n2,1,2,3\n2,1,2,3\n", "line 4, column time: 2 s does not come after 2 s"),
        ("time,x,y,z\n0,1,2,3\n1,1,2,3\n", "line 3: the file ends after 2 rows .* needs at least 20"),
        (header(5) + "\n" + ",".join("0" * 16) + "\n", "line 2: the file ends after 1 rows .* at least 2"),
    ],
)
def test_a_file_that_is_no_path_is_refused_by_name_line_and_column(text: str, sentence: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.csv"
    file.write_text(text)
    with pytest.raises(InvalidReference, match=r"bad\.csv, " + ".*" + sentence):
        sc.from_csv(file)


def test_waypoints_take_no_accelerations_and_at_least_two_rows(tmp_path: Path) -> None:
    with pytest.raises(InvalidReference, match="header time,x,y,z, optionally followed by vx,vy,vz, then stop was exp"):
        sc.waypoints_from_csv(write(tmp_path / "a.csv", table(LINE, 1.0, 3), 3))
    with pytest.raises(InvalidReference, match="1 rows of data, but such a path needs at least 2"):
        sc.waypoints_from_csv(write(tmp_path / "b.csv", table(LINE, 1.0, 1)[:1], 1))


# --- the examples -----------------------------------------------------------------------------------------


def test_the_sampled_working_cycle_is_the_one_through_the_waypoints() -> None:
    smooth = sc.waypoints_from_csv(EXAMPLES / "working_cycle_waypoints.csv")
    path = sc.from_csv(EXAMPLES / "working_cycle_sampled.csv")
    assert relative_errors(path, smooth, 4).max() < 1e-5
    assert present(path.fit_error) < 1e-11


@pytest.mark.usefixtures("empty_folder")
def test_the_script_in_the_readme_regenerates_the_sampled_working_cycle(tmp_path: Path) -> None:
    script = (EXAMPLES / "README.md").read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    waypoints = (EXAMPLES / "working_cycle_waypoints.csv").read_text()
    (tmp_path / "working_cycle_waypoints.csv").write_text(waypoints)
    exec(compile(script, "README.md", "exec"), {})
    made = np.loadtxt("working_cycle_sampled.csv", delimiter=",", skiprows=1)
    kept = np.loadtxt(EXAMPLES / "working_cycle_sampled.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(made, kept, rtol=0.0, atol=1e-14)


def test_the_working_cycle_is_gentle_and_stays_where_the_default_crane_can_go() -> None:
    path = sc.waypoints_from_csv(EXAMPLES / "working_cycle_waypoints.csv")
    jets = path.jet(np.linspace(0.0, path.duration, 2001), 2)
    position, velocity, acceleration = jets[:, 0], jets[:, 1], jets[:, 2]
    assert np.linalg.norm(velocity, axis=1).max() < 0.6
    assert np.linalg.norm(acceleration, axis=1).max() < 0.15
    assert position[:, 2].min() > -6.0 - 1e-9
    assert position[:, 2].max() < -2.0 + 1e-2
    lever = -position[:, 2] / (GRAVITY + acceleration[:, 2])  # theory.md, section 4
    trolley = np.linalg.norm(position[:, :2] + lever[:, None] * acceleration[:, :2], axis=1)
    assert trolley.min() > 3.8
    assert trolley.max() < 6.1
