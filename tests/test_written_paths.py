"""Tables of paths: what `path_to_csv` writes `from_csv` reads by default, and finds the same path in it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy
from present import present

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.references.bspline import REST_ORDER
from servocore.references.csv_file import RETURNS
from servocore.references.csv_table import PREFIXES
from servocore.references.profiles import DEGREE3, DEGREE5, DEGREE7, TIME_LAWS, polynomial

STEEPEST = 1e3
"""The fourth derivative of the polynomials of degree 9 from 0 to 1 stays below it."""
START, END = (5.0, 0.0, -5.0), (-2.0, 2.0, -2.0)
ROUGH = {1: DEGREE3, 2: DEGREE5, 3: DEGREE7}
"""Time laws by the derivatives of them that are continuous: too few for a path that is read by default."""


def read_back(folder: Path, path: sc.Reference, each: int | None = None, **options: Any) -> sc.Reference:
    columns = "xyz"[: path.dimension]
    file = folder / "path.csv"
    file.write_text(sc.path_to_csv(path, columns, each), encoding="utf-8")
    return sc.from_csv(file, columns=columns, **options)


def instants(path: sc.Reference) -> Array:
    """Return times between start and end, many in every stretch, and its begin."""
    ends = path.stretches
    return np.unique(np.concatenate([ends[:-1] + part * np.diff(ends) for part in np.linspace(0.0, 1.0, 97)[:-1]]))


def deviations(found: sc.Reference, path: sc.Reference, order: int = REST_ORDER) -> Array:
    """Return the largest difference of every derivative between start and end, as a fraction of its peak."""
    t = instants(path)
    expected = path.jet(t, order)
    peaks = np.abs(expected).max(axis=(0, 2))
    return np.asarray(np.abs(found.jet(t, order) - expected).max(axis=(0, 2)) / np.where(peaks > 0.0, peaks, 1.0))


def round_off(path: sc.Reference) -> float:
    """Return how much of its peak the fourth derivative may lose to the last digits of rows in half of a stretch."""
    largest = np.abs(path.jet(instants(path), REST_ORDER)).max(axis=(0, 2))
    nearest = float(np.diff(path.stretches).min()) / 2.0
    return float(STEEPEST * np.finfo(np.float64).eps * largest[0] / nearest**REST_ORDER / (largest[-1] or 1.0))


@st.composite
def lines(draw: Callable[[SearchStrategy[Any]], Any]) -> sc.Reference:
    """Draw straight lines of any time law that commands offer, ramps of any length, at any time."""
    start, end = (draw(st.lists(st.integers(-900, 900), min_size=3, max_size=3)) for _ in range(2))
    duration = draw(st.floats(1.0, 1e3))
    ramp = duration * draw(st.floats(0.02, 0.5))
    laws = [*TIME_LAWS.values(), *([sc.three_phase(ramp)] if 2.0 * ramp <= duration else [])]
    law, begin = draw(st.sampled_from(laws)), draw(st.sampled_from([0.0, -3.0, 12.5, 86_400.0]))
    first, last = (np.array(start) / 100).tolist(), (np.array(end) / 100 + 0.01).tolist()
    return sc.rest_to_rest(first, last, duration, law, begin)


@st.composite
def curves(draw: Callable[[SearchStrategy[Any]], Any]) -> sc.Reference:
    """Draw paths through waypoints, with a stop or without, or the samples of one at uneven times."""
    count = draw(st.integers(3, 7))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    points, times = rng.uniform(-6.0, 6.0, (count, 3)), np.cumsum(rng.uniform(2.0, 9.0, count))
    stops = None if draw(st.booleans()) else np.arange(count) == count // 2
    path = sc.through(points, times, stops=stops)
    if stops is not None or draw(st.booleans()):
        return path
    t = np.unique(np.linspace(path.start_time, path.end_time, draw(st.integers(20 * count, 60 * count))))
    t[1:-1] += rng.uniform(-0.2, 0.2, len(t) - 2) * np.diff(t)[1:]
    return sc.sampled(t, path.jet(t, 0)[:, 0])


@settings(max_examples=60)
@given(path=st.one_of(lines(), curves()))
def test_what_is_written_is_read_by_default_and_is_the_same_path(
    path: sc.Reference, tmp_path_factory: pytest.TempPathFactory
) -> None:
    found = read_back(tmp_path_factory.mktemp("written"), path)
    assert (found.start_time, found.end_time) == (path.start_time, path.end_time)
    away = deviations(found, path)
    assert away.max() < max(RETURNS, round_off(path))
    outside = [path.start_time - 1.0, path.end_time + 1.0]
    np.testing.assert_array_equal(found.jet(outside, REST_ORDER)[:, 1:], 0.0)


@pytest.mark.parametrize("profile", TIME_LAWS.values(), ids=TIME_LAWS)
@pytest.mark.parametrize("duration", [1e-3, 20.0, 1e5])
def test_every_time_law_comes_back_after_its_rows_have_passed_through_a_file(
    profile: sc.Profile, duration: float, tmp_path: Path
) -> None:
    path = sc.rest_to_rest(START, END, duration, profile)
    assert deviations(read_back(tmp_path, path), path).max() < RETURNS


@pytest.mark.parametrize("ramp", [0.2, 1.0, 5.0, 10.0])
@pytest.mark.parametrize("each", [2, 3, 5, 10])
def test_ramps_are_read_though_no_row_where_they_end_follows_from_its_neighbours(
    ramp: float, each: int, tmp_path: Path
) -> None:
    path = sc.rest_to_rest(START, END, 20.0, sc.three_phase(ramp))
    assert deviations(read_back(tmp_path, path, each), path).max() < 1e-6


def test_few_rows_are_read_with_the_fit_that_they_have(tmp_path: Path) -> None:
    path = sc.rest_to_rest(START, END, 20.0, sc.DEGREE13)
    found = read_back(tmp_path, path, 3)
    away = np.linalg.norm(found.jet(instants(path), 0)[:, 0] - path.jet(instants(path), 0)[:, 0], axis=1).max()
    assert 1e-5 < away < present(found.fit_error)


@pytest.mark.parametrize("column", range(15))
def test_a_wrong_number_in_few_rows_is_no_better_than_in_many(column: int, tmp_path: Path) -> None:
    path = sc.rest_to_rest(START, END, 20.0, sc.three_phase())
    header, *lines = sc.path_to_csv(path, each=4).splitlines()
    rows = np.array([line.split(",") for line in lines], dtype=float)
    rows[2, 1 + column] += 2.0 * np.abs(rows[:, 1 + column]).max()
    file = tmp_path / "wrong.csv"
    np.savetxt(file, rows, "%.17g", ",", header=header, comments="")
    with pytest.raises(sc.InvalidReference, match=r"wrong\.csv, line \d+ .* contradict one another"):
        sc.from_csv(file)


def test_motion_that_does_not_rest_comes_back_between_its_ends(tmp_path: Path) -> None:
    path = sc.figure_of_eight((5.0, 0.0, -5.0), (1.0, 0.0, 0.5), (0.0, 0.5, 0.0), 20.0, cycles=3)
    assert deviations(read_back(tmp_path, path), path).max() < RETURNS


@pytest.mark.parametrize("order", ROUGH)
def test_a_path_with_few_derivatives_is_written_with_those_and_asks_for_no_more(order: int, tmp_path: Path) -> None:
    path = sc.rest_to_rest(START, END, 20.0, ROUGH[order])
    text = sc.path_to_csv(path)
    assert text.splitlines()[0].split(",") == ["time", *(p + axis for p in PREFIXES[: order + 1] for axis in "xyz")]
    assert deviations(read_back(tmp_path, path, rest_order=order), path, order).max() < RETURNS
    with pytest.raises(sc.InvalidReference, match=r"path\.csv, line 4: the file ends after 3 rows .* at least 20, for"):
        read_back(tmp_path, path)


def test_a_table_without_the_derivatives_that_few_rows_need_says_how_many_it_holds(tmp_path: Path) -> None:
    with pytest.raises(sc.InvalidReference, match="for its columns hold 3 of the 4 derivatives with which"):
        read_back(tmp_path, sc.rest_to_rest(START, END, 20.0, DEGREE7))


@pytest.mark.parametrize(("end", "duration"), [(END, 2e4), ((2000.0, 2.0, -2.0), 20.0)], ids=["slow", "far"])
def test_what_a_reader_would_ask_about_units_the_header_says(
    end: tuple[float, float, float], duration: float, tmp_path: Path
) -> None:
    path = sc.rest_to_rest(START, end, duration)
    assert "[" in sc.path_to_csv(path).splitlines()[0]
    assert deviations(read_back(tmp_path, path), path).max() < 1e-12


def test_ramps_of_half_a_duration_but_for_round_off_are_two_stretches(tmp_path: Path) -> None:
    ramp = 10.0 / 3.0
    path = sc.rest_to_rest(START, END, np.nextafter(2.0 * ramp, 9.0), sc.three_phase(ramp), start_time=0.7)
    assert np.diff(path.stretches).min() < 1e-12
    assert len(sc.path_to_csv(path).splitlines()) == 1 + 5
    found, t = read_back(tmp_path, path), np.linspace(path.start_time, path.end_time, 999)
    np.testing.assert_allclose(found.jet(t, REST_ORDER), path.jet(t, REST_ORDER), atol=1e-9)


def test_columns_and_rows_that_do_not_fit_a_path_are_refused() -> None:
    path = sc.rest_to_rest((0.0, 1.0), (1.0, 1.0), 2.0)
    with pytest.raises(sc.InvalidReference, match="a path with 2 components needs as many columns, not 3"):
        sc.path_to_csv(path)
    for each in (0, -1, 2.5):
        with pytest.raises(sc.InvalidReference, match="one or more whole rows, not"):
            sc.path_to_csv(path, "xy", each)  # type: ignore[arg-type] # a user's mistake


def test_a_path_that_no_table_holds_is_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    path = sc.rest_to_rest(START, END, 20.0, polynomial(15))
    sc.path_to_csv(path)
    monkeypatch.setattr("servocore.references.csv_file._MOST_EACH", 2)
    with pytest.raises(sc.InvalidReference, match=r"no table holds the path: with 2 rows for each .* near t = 10 s"):
        sc.path_to_csv(path)
