"""Solutions as people meet them: in a shell, in a notebook, as figures and as tables of other packages."""

from __future__ import annotations

import pickle
import re
import sys
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.animation import FuncAnimation
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3D
from present import of_kind

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


def figure_of(animation: FuncAnimation) -> Figure:
    return of_kind(Figure, vars(animation)["_fig"])


def test_a_figure_has_a_panel_for_every_trajectory_and_angles_in_degrees(solution: sc.Solution) -> None:
    figure = solution.plot(["M_b", "s", "phi"])
    panels = {panel.get_title(loc="left"): panel.lines[0] for panel in figure.axes}
    assert list(panels) == ["M_b (N m)", "s (m)", "phi (deg)"]
    np.testing.assert_allclose(np.asarray(panels["phi (deg)"].get_ydata()), np.degrees(solution["phi"]))
    plt.close(figure)


@pytest.mark.parametrize("name", ["rotary_crane", "passive_joint_arm", "cars"])
def test_frames_of_an_animation_show_the_points_of_the_solution(name: str) -> None:
    scene = sc.scenes.REGISTRY[name]()
    solution = sc.solve(scene, step=scene.reference.duration / 20, checks=False)
    animation = solution.animate(frames=3)
    figure = figure_of(animation)
    instants = [of_kind(int, frame) for frame in animation.new_frame_seq()]
    assert instants == [0, 10, 20]
    for k in instants:
        animation._draw_next_frame(k, blit=False)  # type: ignore[attr-defined]  # private: matplotlib has no types for it
        axes = figure.axes[0]
        drawn = {line.get_label(): line for line in axes.lines}
        if name == "rotary_crane":
            load, trolley = (np.ravel(of_kind(Line3D, drawn[name]).get_data_3d()) for name in ("load", "trolley"))
            np.testing.assert_allclose(load, [solution[each][k] for each in "xyz"], atol=1e-12)
            s, phi = solution["s"][k], solution["phi"][k]
            np.testing.assert_allclose(trolley, [s * np.cos(phi), s * np.sin(phi), 0.0], atol=1e-12)
        elif name == "cars":
            for number in "12":
                np.testing.assert_allclose(
                    np.asarray(drawn[number].get_xdata()), solution[f"x_{number}"][k], atol=1e-12
                )
        else:
            place = np.ravel(drawn["tracked point"].get_xydata())
            np.testing.assert_allclose(place, [solution[each][k] for each in ("point_x", "point_y")], atol=1e-12)
        assert f"t = {solution.t[k]:.2f} s" in figure.get_suptitle()
    plt.close(figure)


def test_an_animation_is_written_as_gif_and_shown_by_a_notebook(tmp_path: Path) -> None:
    animation = sc.solve(sc.scenes.cars(), step=0.5, checks=False).animate(speed=2.0, frames=2)
    animation.save(str(tmp_path / "cars.gif"), writer="pillow")
    assert (tmp_path / "cars.gif").read_bytes().startswith(b"GIF8")
    assert "data:image/png;base64" in animation._repr_html_()
    plt.close(figure_of(animation))


def test_an_animation_that_cannot_be_is_refused_with_a_sentence(solution: sc.Solution) -> None:
    with pytest.raises(sc.InvalidSetting, match="an animation needs a positive speed, not 0"):
        solution.animate(speed=0)
    with pytest.raises(sc.InvalidSetting, match="this solution lacks its problem"):
        pickle.loads(pickle.dumps(solution)).animate()


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
    with pytest.raises(sc.InvalidSetting, match=rf"the package {package} is missing: .* '\.\[{extra}\]'"):
        getattr(solution, call)()
