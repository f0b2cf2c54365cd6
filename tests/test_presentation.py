"""Solutions as people meet them: in a shell, in a notebook, as figures and as tables of other packages."""

from __future__ import annotations

import re
import sys

import matplotlib as mpl
import numpy as np
import pytest

import servocore as sc

mpl.use("Agg")


@pytest.fixture(scope="module")
def solution() -> sc.Solution:
    return sc.solve(sc.scenes.rotary_crane(), step=0.5)


def test_a_shell_shows_one_line_without_numbers_of_trajectories(solution: sc.Solution) -> None:
    assert repr(solution) == (
        "<Solution of rotary crane, points, reduced, 41 instants from 0 s to 20 s: M_b, F, M_w, phi, s, l, tension,"
        " swing, x, y, z, d_x, d_y, p_x, p_y>"
    )


def test_a_notebook_shows_ends_and_extremes_of_every_trajectory(solution: sc.Solution) -> None:
    rows = dict(re.findall(r"<tr><th>(\w+)</th><td>.*?</td>(.*?)</tr>", solution._repr_html_()))
    assert tuple(rows) == solution.names
    for name, row in rows.items():
        numbers = [float(each) for each in re.findall(r"<td>([^<]+)</td>", row)]
        values = solution[name]
        np.testing.assert_allclose(numbers, [values[0], values[-1], values.min(), values.max()], rtol=1e-5)


def test_a_figure_has_a_panel_for_every_trajectory_and_angles_in_degrees(solution: sc.Solution) -> None:
    figure = solution.plot(["M_b", "s", "phi"])
    panels = {panel.get_title(loc="left"): panel.lines[0] for panel in figure.axes}
    assert list(panels) == ["M_b (N m)", "s (m)", "phi (deg)"]
    np.testing.assert_allclose(panels["phi (deg)"].get_ydata(), np.degrees(solution["phi"]))
    mpl.pyplot.close(figure)


def test_pandas_has_every_trajectory_over_time_with_units(solution: sc.Solution) -> None:
    frame = solution.to_pandas()
    assert frame.index.name == "time"
    assert (frame.index == solution.t).all()
    assert all((frame[name] == solution[name]).all() for name in solution.names)
    assert frame.attrs["units"] == {"time": "s"} | {name: solution.unit(name) for name in solution.names}


def test_xarray_has_every_trajectory_over_time_with_units(solution: sc.Solution) -> None:
    data = solution.to_xarray(["M_b", "swing"])
    assert list(data) == ["M_b", "swing"]
    assert (data.M_b.values == solution["M_b"]).all()
    assert data.M_b.attrs["units"] == "N.m"
    assert data.time.attrs["units"] == "s"
    assert (data.time.values == solution.t).all()


@pytest.mark.parametrize("call", ["plot", "to_pandas", "to_xarray"])
def test_an_unknown_name_is_refused_with_those_that_there_are(solution: sc.Solution, call: str) -> None:
    with pytest.raises(KeyError, match="nothing; there are M_b, F, M_w"):
        getattr(solution, call)(["nothing"])


@pytest.mark.parametrize(
    ("call", "package", "extra"),
    [("plot", "matplotlib", "report"), ("to_pandas", "pandas", "sweep"), ("to_xarray", "xarray", "sweep")],
)
def test_a_missing_package_is_told_with_its_extra(
    solution: sc.Solution, monkeypatch: pytest.MonkeyPatch, call: str, package: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(sc.InvalidSetting, match=rf"the package {package} is needed .* 'servocore\[{extra}\]'"):
        getattr(solution, call)()
