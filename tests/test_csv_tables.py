"""Files of other programs: read where it is clear what they mean, and told; else refused with the remedy."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import servocore as sc
from servocore.errors import InvalidReference, ServocoreWarning
from servocore.files import csv_pieces, csv_text, write_together
from servocore.references import bspline, splines
from servocore.references.piecewise import PiecewisePolynomial

LINE = sc.rest_to_rest((5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), 20.0)
T = np.linspace(0.0, 20.0, 41)
ROWS = np.column_stack([T, LINE.jet(T, 0)[:, 0]])


def dated(rows: np.ndarray, ending: str = "Z", **more: str) -> str:
    """Return rows with dates for times: from ten seconds before midnight on of a 28th of February."""
    instants = np.datetime64("2026-02-28T23:59:50") + np.round(rows[:, 0] * 1e3).astype("timedelta64[ms]")
    header, *lines = text(rows, **more).splitlines()
    delimiter = more.get("delimiter", ",")
    cells = [
        f"{instant}{ending}{delimiter}{line.partition(delimiter)[2]}"
        for instant, line in zip(instants, lines, strict=True)
    ]
    return "\n".join([header, *cells]) + "\n"


def text(rows: np.ndarray, header: str = "time,x,y,z", delimiter: str = ",", point: str = ".") -> str:
    lines = [delimiter.join(repr(float(each)).replace(".", point) for each in row) for row in rows]
    return "\n".join([header, *lines]) + "\n"


def read(tmp_path: Path, content: str | bytes) -> tuple[PiecewisePolynomial, list[str]]:
    """Return the path of a file and what was told, without the name of the file."""
    file = tmp_path / "path.csv"
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", ServocoreWarning)
        path = sc.from_csv(file, tolerance=1e-9)
    return path, [str(each.message).removeprefix(f"{file} is read with ") for each in told]


def as_line(path: sc.Reference) -> bool:
    """Whether a path is the line, in position and jerk."""
    t = np.linspace(0.0, 20.0, 301)
    off = np.abs(path.jet(t, 3) - LINE.jet(t, 3)).max(axis=(0, 2)) / np.abs(LINE.jet(t, 3)).max(axis=(0, 2))
    return bool(off.max() < 1e-5)


MILLI = ROWS * [1e3, 1e3, 1e3, 1e3]
CLEAR = {
    "semicolons": (text(ROWS, "time;x;y;z", ";"), "semicolons between cells"),
    "decimal commas": (text(ROWS, "time;x;y;z", ";", ","), "semicolons between cells, decimal commas"),
    "tabs": (text(ROWS, "time\tx\ty\tz", "\t"), "tabs between cells"),
    "UTF-16": (text(ROWS).encode("utf-16"), "UTF-16 as its encoding"),
    "UTF-16 without a mark": (text(ROWS).encode("utf-16-le"), "UTF-16 as its encoding"),
    "units": (text(MILLI, "time [ms],x (mm),y [mm],z[mm]"), "time in ms, x, y, z in mm"),
    "seconds since 1970": (
        text(np.add(ROWS, [1763850000.0, 0, 0, 0])), "times in s since 1970, of which the first becomes 0"
    ),
    "milliseconds since 1970": (
        text(ROWS * [1e3, 1, 1, 1] + [1763850000123.0, 0, 0, 0]), "times in ms since 1970, of which the first becomes 0"
    ),
    "named and since 1970": (
        text(ROWS * [1e3, 1, 1, 1] + [1763850000123.0, 0, 0, 0], "time [ms],x,y,z"),
        "time in ms, times in ms since 1970, of which the first becomes 0",
    ),
    "dates": (dated(ROWS), "dates as times, of which the first becomes 0"),
    "dates without a zone": (dated(ROWS, ""), "dates as times, of which the first becomes 0"),
    "dates with a space and quotes": (
        re.sub("^(.*)T([^Z]*Z)", r'"\1 \2"', dated(ROWS), flags=re.MULTILINE),
        "dates as times, of which the first becomes 0",
    ),
    "dates and decimal commas": (
        dated(ROWS, "+01:00", header="time;x;y;z", delimiter=";", point=","),
        "semicolons between cells, dates as times, of which the first becomes 0, decimal commas",
    ),
    "a line for spreadsheets above": ("sep=;\r\n" + text(ROWS, "time;x;y;z", ";"), "semicolons between cells"),
    "the Greek letter for micro": (text(ROWS * [1e6, 1, 1, 1], "time [\u03bcs],x,y,z"), "time in µs"),
    "a time called t": (text(ROWS, "t,x,y,z"), "t,x,y,z as time,x,y,z"),
    "capitals": (text(ROWS, "Time,X,Y,Z"), "Time,X,Y,Z as time,x,y,z"),
    "tabs and no more cells": (
        text(ROWS).replace(",", "\t").rstrip() + "\n\t\t\t\n", "tabs between cells"
    ),
}  # fmt: skip


@pytest.mark.parametrize(("content", "note"), CLEAR.values(), ids=CLEAR)
def test_what_is_clear_is_read_and_told_in_one_line(content: str | bytes, note: str, tmp_path: Path) -> None:
    path, told = read(tmp_path, content)
    assert as_line(path)
    assert told == [note]


@pytest.mark.parametrize(
    "content",
    [
        text(ROWS, "time [s],x [m],y [m],z (m)"),
        "\ufeff" + text(ROWS, "time, x, y, z"),
        text(ROWS).replace("\n", "\r\n"),
        text(ROWS).replace("\n5.0,", '\n"5.0",'),
    ],
)
def test_what_needs_no_conversion_is_not_told(content: str | bytes, tmp_path: Path) -> None:
    path, told = read(tmp_path, content)
    assert as_line(path)
    assert told == []


def test_times_are_read_in_every_unit(tmp_path: Path) -> None:
    for unit, factor in {"ms": 1e3, "us": 1e6, "µs": 1e6, "ns": 1e9, "min": 1 / 60, "h": 1 / 3600}.items():
        path, told = read(tmp_path, text(ROWS * [factor, 1, 1, 1], f"time [{unit}],x,y,z"))
        assert as_line(path)
        assert told[0].startswith("time in ")


def test_units_of_derivatives_are_converted_too(tmp_path: Path) -> None:
    jets = LINE.jet(T, 4).reshape(len(T), -1) * 1e3
    names = [f"{prefix}{axis} [mm{per}]" for prefix, per in zip(["", "v", "a", "j", "s"],
             ["", "/s", "/s²", "/s^3", "/s4"], strict=True) for axis in "xyz"]  # fmt: skip
    path, told = read(tmp_path, text(np.column_stack([T, jets]), ",".join(["time", *names])))
    assert as_line(path)
    assert "x, y, z in mm" in told[0]
    assert "sx, sy, sz in mm/s4" in told[0]


UNCLEAR = {
    "milliseconds and millimetres": (  # whose mean speed is plausible
        text(np.round(ROWS * [1e3, 1e3, 1e3, 1e3], 6)),
        "milliseconds and its positions look like millimetres, for 20000 s and up to 5000 m .* time .ms. and x .mm.",
    ),
    "parts of milliseconds": (text(ROWS * [1e3, 1, 1, 1] + [0.1, 0, 0, 0]), "its times look like milliseconds"),
    "nanoseconds": (text(ROWS * [1e9, 1, 1, 1]), "line 42, column time: 20000000000 s is more than 1e.09 s from zero"),
    "seconds since long ago": (text(np.add(ROWS, [5e9, 0, 0, 0])), "5000000020 s is more than 1e.09 s from zero: let"),
    "millimetres beside named ones": (
        text(ROWS * [1, 1e3, 1e3, 1e3], "time,x [mm],y,z"),
        "its positions look like millimetres, .* write y .mm.",
    ),
    "an underscore in a number": (text(ROWS).replace("5.0,0", "5_0,0"), "column x: '5_0' is not a finite number"),
    "an archive": (b"PK\x03\x04" + bytes(5000), r"was expected, but '.{,400}\.\.\.' was found$"),
    "a step back": (
        text(ROWS[[0, 1, 3, 2, 4]] * [0.2, 1, 1, 1]),
        "time: 0.2 s does not come after 0.30000000000000004",
    ),
    "commas between cells and digits": (text(ROWS, point=","), "line 2: 8 cells .* decimal commas need semicolons"),
    "grouped digits": ("time;x;y;z\n0;1.234,5;0;1\n", "column x: '1.234,5' is not a finite number; digits are not"),
    "a clock": ("time,x,y,z\n12:00:00,1,0,1\n", "column time: '12:00:00' .*; times are numbers of seconds, or dates"),
    "a date as some write it": (
        "time,x,y,z\n01.02.2026 12:00,1,0,1\n",
        "'01.02.2026 12:00' .*, or dates such as 2026-",
    ),
    "no such day": (dated(ROWS).replace("03-01", "02-29"), "line 22, .* is no date and time that there is"),
    "one date only": (dated(ROWS[:1]) + "1.0,1,0,1\n", "line 3, column time: '1.0' is no date and time such as 2026-"),
    "zones here and there": (dated(ROWS[:1]) + "2026-03-01T00:00:00,1,0,1\n", "line 3, .* without a time zone where"),
    "dates in ms": (dated(ROWS, header="time [ms],x,y,z"), "line 1: its times are dates, which have no unit"),
    "unknown unit": (text(ROWS, "time,x [ft],y,z"), "line 1, column x: its unit must be one of m, mm, cm, km, not 'f"),
    "unit of another order": (text(ROWS, "time,x [m/s],y,z"), "column x: its unit must be .* m, mm, cm, km, not 'm/s'"),
    "angles of a load": (text(ROWS, "time,x [deg],y,z"), "column x: its unit must be one of m, mm, cm, km, not 'deg'"),
    "no text": (b"\xff\xfe\x00", "cannot be read as a table: .*; save it as CSV in UTF-8"),
    "latin letters": ("time,x,y,z\n0,1,2,3\xb2\n".encode("latin-1"), "cannot be read as a table"),
}


@pytest.mark.parametrize(("content", "sentence"), UNCLEAR.values(), ids=UNCLEAR)
def test_what_is_unclear_is_refused_with_the_remedy(content: str | bytes, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidReference, match=r"path\.csv.*" + sentence):
        read(tmp_path, content)


@pytest.mark.parametrize("divider", [",", ";", "\t"])
def test_empty_cells_at_the_end_of_waypoints_are_empty_cells(divider: str, tmp_path: Path) -> None:
    rows = [
        "time,x,y,z,vx,vy,vz,stop",
        "0,6,0,-6,,,,",
        "8,6,0.2,-4.4,0,0.1,0.2,",
        "16,5.4,2,-2.6,,,,1",
        "25,2.8,4.2,-2,,,,",
    ]
    file = tmp_path / "way.csv"
    file.write_text("\n".join(rows).replace(",", divider) + "\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sc.ServocoreWarning)
        path = sc.waypoints_from_csv(file)
    np.testing.assert_allclose(path.jet(25.0, 1), [[2.8, 4.2, -2.0], [0.0, 0.0, 0.0]], atol=1e-14)
    np.testing.assert_allclose(path.jet(8.0, 1), [[6.0, 0.2, -4.4], [0.0, 0.1, 0.2]], atol=1e-14)


def test_a_space_between_tabs_makes_no_second_cell(tmp_path: Path) -> None:
    with pytest.raises(sc.InvalidReference, match=r"line 2, column x: '5\.0 0\.0' is not a finite number"):
        read(tmp_path, text(ROWS).replace(",", "\t").replace("5.0\t0.0\t", "5.0 0.0\t\t", 1))


def test_dates_of_several_zones_are_one_time(tmp_path: Path) -> None:
    lines = dated(ROWS).splitlines()
    lines[21:] = [line.replace("2026-03-01T00", "2026-03-01T05").replace("Z", "+0500") for line in lines[21:]]
    lines[1:21] = [line.replace("2026-02-28T23", "2026-02-28T21").replace("Z", "-02") for line in lines[1:21]]
    assert lines[21].startswith("2026-03-01T05:00:00.000+0500")
    assert as_line(read(tmp_path, "\n".join(lines))[0])


def test_capitals_that_tell_columns_apart_are_heeded(tmp_path: Path) -> None:
    file = tmp_path / "path.csv"
    file.write_text("time,X,x\n0,0,0\n1,1,2\n", encoding="utf-8")
    with pytest.raises(InvalidReference, match=r"the header time,x,X, .* was expected, but 'time,X,x' was found"):
        sc.waypoints_from_csv(file, ["x", "X"])
    assert sc.waypoints_from_csv(file, ["X", "x"]).jet(1.0, 0)[0].tolist() == [1.0, 2.0]


def test_plain_numbers_and_cells_one_by_one_give_the_same_table(tmp_path: Path) -> None:
    plain, _ = read(tmp_path, text(ROWS))
    quoted, _ = read(tmp_path, text(ROWS).replace("5.0,", '"5.0",', 1))
    assert (plain.coefficients == quoted.coefficients).all()


def test_units_are_of_the_kind_that_the_outputs_have(tmp_path: Path) -> None:
    file = tmp_path / "turn.csv"
    file.write_text("time,y [deg]\n0,0\n5,30\n")
    with pytest.warns(ServocoreWarning, match="y in deg"):
        turned = sc.waypoints_from_csv(file, ["y"], units=["rad"])
    assert turned.jet(5.0, 0)[0, 0] == pytest.approx(np.radians(30.0), rel=1e-15)
    with pytest.raises(InvalidReference, match="column y: its unit must be one of m, mm, cm, km, not 'deg'"):
        sc.waypoints_from_csv(file, ["y"], units=["m"])


def test_seconds_since_1970_are_as_exact_as_others(tmp_path: Path) -> None:
    plain, _ = read(tmp_path, text(ROWS))
    since, _ = read(tmp_path, "time,x,y,z\n" + "".join(
        f"{1_700_000_000 + int(row[0])}.{round(row[0] % 1 * 1e6):06d},{row[1]!r},{row[2]!r},{row[3]!r}\n"
        for row in ROWS.tolist()
    ))  # fmt: skip
    np.testing.assert_allclose(since.jet(T, 2), plain.jet(T, 2), rtol=0.0, atol=1e-12)


# --- waypoints with speeds and stops ----------------------------------------------------------------------

PLACES = np.array([[5.0, 0.0, -5.0], [4.0, 2.0, -3.0], [2.0, 3.0, -3.0], [-1.0, 3.0, -4.0]])
TIMES = np.array([0.0, 8.0, 14.0, 25.0])


def waypoints(tmp_path: Path, header: str, *ends: list[str]) -> Path:
    rows = [",".join([*map(repr, [float(t), *map(float, place)]), *more])
            for t, place, more in zip(TIMES, PLACES, ends, strict=True)]  # fmt: skip
    file = tmp_path / "way.csv"
    file.write_text("\n".join([header, *rows]) + "\n")
    return file


def test_a_path_stops_where_it_is_told_to_and_legs_of_two_points_are_lines(tmp_path: Path) -> None:
    path = sc.waypoints_from_csv(waypoints(tmp_path, "time,x,y,z,stop", [""], ["1"], ["yes"], [""]))
    t = np.linspace(8.0, 14.0, 101)
    line = sc.rest_to_rest(PLACES[1], PLACES[2], 6.0, start_time=8.0)
    np.testing.assert_allclose(path.jet(t, 4), line.jet(t, 4), rtol=0, atol=1e-10)
    np.testing.assert_allclose(path.jet([8.0, 14.0], 4)[:, 1:], 0.0, atol=1e-9)
    assert (path.rests_before, path.rests_after, path.smoothness) == (True, True, 4)


def test_a_velocity_that_the_path_has_anyway_changes_nothing(tmp_path: Path) -> None:
    free = sc.through(PLACES, TIMES)
    own = [repr(float(each)) for each in free.jet(8.0, 1)[1]]
    path = sc.waypoints_from_csv(waypoints(tmp_path, "time,x,y,z,vx,vy,vz", [""] * 3, own, [""] * 3, ["0"] * 3))
    t = np.linspace(0.0, 25.0, 301)
    np.testing.assert_allclose(path.jet(t, 4), free.jet(t, 4), rtol=0, atol=1e-9)


def test_a_velocity_is_met_with_all_but_one_of_the_derivatives_of_a_spline(tmp_path: Path) -> None:
    wanted = [0.1, 0.4, 0.05]
    path = sc.waypoints_from_csv(
        waypoints(tmp_path, "time,x,y,z,vx,vy,vz,stop", [""] * 4, [*map(repr, wanted), "0"], [""] * 3 + ["1"], [""] * 4)
    )
    np.testing.assert_allclose(path.jet(TIMES, 0)[:, 0], PLACES, rtol=0, atol=1e-12)
    np.testing.assert_allclose(path.jet(8.0, 1)[1], wanted, rtol=0, atol=1e-12)
    before, after = path.jet([8.0 - 1e-9, 8.0 + 1e-9], 7)
    np.testing.assert_allclose(before, after, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("header", "ends", "sentence"),
    [
        ("time,x,y,z,stop", [["0"], ["maybe"], [""], [""]], "line 3, column stop: 'maybe' is neither 1 nor 0"),
        ("time,x,y,z,vx,vy,vz", [["1", "0", "0"], *[[""] * 3] * 3], "line 2 has a velocity, but the path rests"),
        ("time,x,y,z,vx,vy,vz", [[""] * 3, ["1", "", "0"], *[[""] * 3] * 2], "line 3 has a velocity in some dir"),
        ("time,x,y,z,vx,vy,vz,stop", [[""] * 4, ["1", "0", "0", "1"], *[[""] * 4] * 2], "line 3 has a velocity, b"),
    ],
)
def test_waypoints_that_contradict_themselves_are_refused(
    header: str, ends: list[list[str]], sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(InvalidReference, match=r"way\.csv.*" + sentence):
        sc.waypoints_from_csv(waypoints(tmp_path, header, *ends))


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"stops": [1, 0, 0, 0]}, "the stops of 4 waypoints are 4 times True or False"),
        ({"velocities": np.zeros((3, 3))}, "need as many finite velocities"),
    ],
)
def test_speeds_and_stops_of_another_shape_are_refused(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InvalidReference, match=sentence):
        sc.through(PLACES, TIMES, **given)


@pytest.mark.parametrize("noise", ["rounded", "normal"])
def test_a_tolerance_that_would_do_is_proposed_for_noisy_samples(noise: str, tmp_path: Path) -> None:
    t = np.linspace(0.0, 25.0, 501)
    curve = sc.through(PLACES, TIMES)
    truth = curve.jet(t, 0)[:, 0]
    shaken = truth + 1e-4 * np.random.default_rng(5).standard_normal(truth.shape)
    rows = np.round(truth, 4) if noise == "rounded" else shaken
    file = tmp_path / "noisy.csv"
    file.write_text(text(np.column_stack([t, rows])))
    with pytest.raises(InvalidReference, match=r"need a tolerance; \S+ m would do$") as refusal:
        sc.from_csv(file)
    tolerance = float(str(refusal.value).split("; ")[-1].split()[0])
    assert 3e-5 < tolerance < 1e-3
    path = sc.from_csv(file, tolerance)
    assert np.abs(path.jet(t, 0)[:, 0] - truth).max() < 2e-4
    with pytest.raises(InvalidReference):
        sc.from_csv(file, 0.3 * tolerance)


def test_no_tolerance_is_proposed_where_it_would_hide_the_path() -> None:
    t = np.linspace(0.0, 10.0, 201)
    with pytest.raises(InvalidReference, match=r"need a tolerance$"):
        sc.sampled(t, np.where(t < 5.0, 0.0, 1.0)[:, None])


# --- very many rows ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("few", "tolerance"), [(5_000, None), (5_000, 2e-4), (500, None)])
def test_very_many_samples_are_fitted_as_if_they_were_few(
    few: int, tolerance: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bspline, "_MANY", 4 * few)
    monkeypatch.setattr(splines, "_FEW", few)
    curve = sc.through(PLACES, TIMES)
    t = np.linspace(0.0, 25.0, 5 * few + 1)
    rows = curve.jet(t, 0)[:, 0]
    if tolerance is not None:
        rows = rows + 3e-5 * np.random.default_rng(1).standard_normal(rows.shape)
    sizes: list[int] = []
    fit = bspline.fit

    def counted(times: np.ndarray, *more: Any) -> Any:
        sizes.append(len(times))
        return fit(times, *more)

    monkeypatch.setattr(splines, "fit", counted)
    found = sc.sampled(t, rows, tolerance)
    assert min(sizes) == few
    assert sum(size == len(t) for size in sizes) <= 4
    with monkeypatch.context() as patched:
        patched.setattr(bspline, "_MANY", len(t))
        patched.setattr(splines, "_FEW", len(t))
        expected = sc.sampled(t, rows, tolerance)
    assert found.knots.shape == expected.knots.shape
    peaks = np.abs(expected.jet(t, 4)).max(axis=(0, 2))
    off = np.abs(found.jet(t, 4) - expected.jet(t, 4)).max(axis=(0, 2)) / peaks
    assert (off < [1e-14, 1e-13, 1e-11, 1e-9, 1e-7]).all()


def test_a_table_in_pieces_is_the_table_at_once(tmp_path: Path) -> None:
    values = np.random.default_rng(2).standard_normal((10_000, 3)) ** 7
    columns = [values[:, 0], values[:, 1:]]
    pieces = list(csv_pieces(["a", "b", "c"], columns))
    assert len(pieces) == 4
    rows = [",".join(map(repr, row)) for row in values.tolist()]
    assert "".join(pieces) == "\n".join(["a,b,c", *rows, ""]) == csv_text(["a", "b", "c"], columns)
    write_together({tmp_path / "a.csv": csv_pieces(["a", "b", "c"], columns)})
    assert (tmp_path / "a.csv").read_text() == "".join(pieces)
