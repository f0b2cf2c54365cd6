"""Figures say what they show, the page needs nothing but itself, and its numbers are those of the library."""

import re
from base64 import b64decode
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3D
from mpl_toolkits.mplot3d.axes3d import Axes3D
from present import of_kind

import servocore as sc
from crane_fmu.report import contents, figures
from crane_fmu.report.figures import LABELS, picture
from crane_fmu.report.page import Illustration, Table, formula, number, page, parameter_table
from crane_fmu.report.study import INPUTS, MOTION, Cycle, LoadRun, Study, apart, study, working_cycle
from servocore.references.rest_to_rest import RestToRest

STEPS = (0.2, 0.1)
Sections = dict[str, list[str | Table | Illustration]]


@pytest.fixture(scope="module")
def crane() -> sc.Scene:
    return sc.scenes.rotary_crane()


@pytest.fixture(scope="module")
def found(crane: sc.Scene) -> Study:
    return study(crane, lambda _: None, STEPS)


@pytest.fixture(scope="module")
def cycle(crane: sc.Scene) -> Cycle:
    waypoints = np.array([[0.0, 5.0, 0.0, -5.0], [6.0, 4.0, 3.0, -3.0], [12.0, 0.0, 5.0, -5.0]])
    through = sc.through(waypoints[:, 1:], waypoints[:, 0])
    t = np.linspace(0.0, 12.0, 121)
    return working_cycle(crane, through, sc.sampled(t, through.jet(t, 0)[:, 0]), waypoints)


@pytest.fixture(scope="module")
def written(crane: sc.Scene, found: Study, cycle: Cycle) -> Sections:
    outputs = {"time": found.base.t, **{name: found.base[name] for name in found.base.names}}
    return contents.sections(found, outputs, loop(crane), cycle)


def loop(crane: sc.Scene) -> list[LoadRun]:
    t = np.linspace(0.0, 20.0, 201)
    wanted = crane.reference.jet(t, 0)[:, 0]
    return [LoadRun(label, t, wanted, wanted + size * np.sin(t)[:, None]) for label, size in (("a", 1e-3), ("b", 1e-6))]


@pytest.fixture(scope="module")
def pictures(written: Sections) -> dict[str, bytes]:
    """Stand-ins for the figures of the page, which take seconds to draw."""
    shown = [part for parts in written.values() for part in parts if isinstance(part, Illustration)]
    return {f"{each.name}.svg": f"<svg>{each.title}</svg>".encode() for each in shown}


@pytest.fixture(scope="module")
def html(found: Study, written: Sections, pictures: dict[str, bytes]) -> str:
    return page(contents.TITLE, contents.facts(found), sc.live_part(found.base), written, pictures)


def labels(figure: Figure) -> list[str]:
    return [axes.get_ylabel() for axes in figure.axes]


def legend(figure: Figure) -> list[str]:
    of_axes = (axes.get_legend() for axes in figure.axes)
    holders = [*figure.legends, *(legend for legend in of_axes if legend is not None)]
    return [text.get_text() for each in holders for text in each.get_texts()]


class TestNumbers:
    def test_errors_of_the_scheme_of_the_paper_halve_with_the_step_in_every_model(self, found: Study) -> None:
        for model in found.models:
            for name in INPUTS:
                ratio = found.paper_errors[model, STEPS[0]][name] / found.paper_errors[model, STEPS[1]][name]
                assert ratio == pytest.approx(2.0, rel=0.15), (model, name)

    def test_the_motion_is_exact(self, found: Study) -> None:
        both = [*found.errors.values(), *found.paper_errors.values()]
        assert max(errors[name] for errors in both for name in MOTION) < 1e-9

    def test_by_default_there_is_no_error_in_any_model(self, found: Study) -> None:
        assert set(found.errors) == set(found.models)
        assert max(errors[name] for errors in found.errors.values() for name in INPUTS) < 1e-12

    def test_the_load_strays_less_with_better_inputs(self, found: Study) -> None:
        exact, rows, coarse, fine = (each.largest for each in found.tracking)
        assert exact < 1e-8
        assert exact < rows < 1e-3 * fine
        assert fine < coarse

    def test_an_error_is_relative_for_inputs_and_absolute_for_the_motion(self, crane: sc.Scene) -> None:
        solution = sc.solve(crane, sc.Reduced(), step=0.5)
        values = solution.values.copy()
        values[3, solution.names.index("M_b")] += 1.0
        values[3, solution.names.index("s")] += 0.25
        solution = replace(solution, values=values)
        errors = apart(solution, crane.exact(solution.t))
        assert errors["M_b"] == pytest.approx(1.0 / np.abs(crane.exact(solution.t)["M_b"]).max())
        assert errors["s"] == pytest.approx(0.25)


class TestFigures:
    def test_the_reference_function_rises_from_zero_to_one(self, crane: sc.Scene) -> None:
        figure = figures.reference_function(crane.reference)
        above, below = figure.axes
        s = np.asarray(above.lines[0].get_ydata())
        assert (s[0], s[-1]) == pytest.approx((0.0, 1.0))
        t, drawn = (np.asarray(values) for values in below.lines[0].get_data())
        profile = of_kind(RestToRest, crane.reference).profile
        np.testing.assert_allclose(drawn, profile.jet(t, 20 - t, 20.0, 2)[:, 2], atol=1e-12)
        assert labels(figure) == ["share of the line", "its second derivative (1/s²)"]
        assert below.get_xlabel() == "time (s)"

    def test_both_sets_of_coordinates_are_on_top_of_each_other_and_of_the_default(self, found: Study) -> None:
        redundant, generalized = found.paper["bodies", 0.2], found.paper["generalized", 0.2]
        figure = figures.inputs_compared(redundant, generalized, found.base)
        assert labels(figure) == [LABELS[name] for name in INPUTS]
        assert [len(axes.lines) for axes in figure.axes] == [3, 3, 3]
        assert len(legend(figure)) == 3
        looks = {(line.get_linestyle(), line.get_marker(), line.get_linewidth()) for line in figure.axes[0].lines}
        assert len(looks) == 3, "curves must differ without their colours"
        drawn = [line.get_ydata() for line in figure.axes[2].lines]
        for values, run in zip(drawn, (found.base, generalized, redundant), strict=True):
            np.testing.assert_array_equal(values, run["M_w"])

    @pytest.mark.parametrize("index", [0, -1])
    def test_a_posture_shows_the_crane_where_it_is(self, found: Study, index: int) -> None:
        figure = figures.posture(found.base, index)
        (axes,) = figure.axes
        drawn = {line.get_label(): np.array(of_kind(Line3D, line).get_data_3d()) for line in axes.lines}
        run = found.base
        trolley = run["s"][index] * np.array([np.cos(run["phi"][index]), np.sin(run["phi"][index])])
        load = [run[name][index] for name in "xyz"]
        np.testing.assert_allclose(drawn["trolley"].ravel(), [*trolley, 0.0], atol=1e-12)
        np.testing.assert_allclose(drawn["load"].ravel(), load, atol=1e-12)
        lengths = [np.linalg.norm(np.diff(each, axis=1)) for each in drawn.values() if each.shape[1] == 2]
        assert min(abs(length - run["l"][index]) for length in lengths) < 1e-9
        axes = of_kind(Axes3D, axes)
        assert [axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()] == ["x (m)", "y (m)", "z (m)"]
        assert set(legend(figure)) == {"path", "trolley", "load"}

    def test_the_sketch_names_what_it_measures(self, crane: sc.Scene, found: Study) -> None:
        (axes,) = figures.sketch(found.base).axes
        assert {"$\\varphi$", "$s$", "$l$"} <= {text.get_text() for text in axes.texts}
        path = np.array(of_kind(Line3D, axes.lines[0]).get_data_3d()).T
        manoeuvre = of_kind(RestToRest, crane.reference)
        np.testing.assert_allclose(path[[0, -1]], [manoeuvre.start, manoeuvre.end], atol=1e-12)

    def test_the_error_is_drawn_against_the_step_with_a_line_of_slope_one(self, found: Study) -> None:
        figure = figures.error_against_step(found.paper_errors)
        (axes,) = figure.axes
        assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
        assert axes.get_xlabel() == "step (s)"
        assert len(axes.lines) == len(found.models) * len(INPUTS) + 1
        guide = axes.lines[-1]
        slope = np.polyfit(np.log(guide.get_xdata()), np.log(guide.get_ydata()), 1)[0]
        assert slope == pytest.approx(1.0)

    def test_a_load_that_strays_is_shown_with_its_path_and_its_distance(self, found: Study) -> None:
        figure = figures.strayed(found.tracking, found.tracking)
        assert labels(figure) == ["position of the load (m)", "distance from the path (mm)"]
        assert figure.axes[1].get_yscale() == "log"
        assert len(legend(figure)) == 1 + len(found.tracking)
        gusty = replace(found.tracking[0], gust=(8.0, 10.0))
        assert "gust" in legend(figures.strayed([gusty], [gusty]))
        assert "gust" not in legend(figure)

    @pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
    def test_a_picture_is_the_same_every_time(self, suffix: str) -> None:
        drawn = [Figure(figsize=(2, 1), layout="constrained") for _ in range(2)]
        for figure in drawn:
            figure.add_subplot().plot([0.0, 1.0])
        one, other = (picture(figure, suffix, "by hand") for figure in drawn)
        assert one == other


class TestPage:
    def test_it_needs_nothing_else(self, html: str) -> None:
        assert "http" not in html
        assert "<link" not in html
        assert "@import" not in html
        sources = re.findall(r'src="([^"]*)"', html)
        assert sources
        assert all(source.startswith("data:image/svg+xml;base64,") for source in sources)

    def test_its_pictures_are_those_of_the_files(self, html: str, pictures: dict[str, bytes]) -> None:
        inside = [b64decode(data) for data in re.findall(r'src="data:image/svg\+xml;base64,([^"]*)"', html)]
        assert inside == list(pictures.values())

    def test_figures_and_tables_are_numbered_in_order_and_pictures_described(self, html: str) -> None:
        assert re.findall(r"<b>Figure (\d+)\.</b>", html) == [str(k) for k in range(1, 8)]
        assert re.findall(r"<b>Table (\d+)\.</b>", html) == [str(k) for k in range(1, 9)]
        assert all(re.findall(r'alt="([^"]*)"', html))

    def test_every_table_and_every_figure_says_its_form_and_method_or_that_it_has_none(
        self, written: Sections, html: str
    ) -> None:
        shown = [part for parts in written.values() for part in parts if not isinstance(part, str)]
        assert html.count('<span class="by">') == len(shown) == 15
        for each in shown:
            computed = "form reduced, exact inversion" in each.by or "form projected, method backward Euler" in each.by
            assert computed or "nothing is" in each.by or each.by == "input data", each.title

    def test_a_figure_carries_its_form_and_method_where_it_goes_without_its_caption(
        self, written: Sections, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (closed_loop,) = (part for part in written["The loop of FMUs"] if isinstance(part, Illustration))
        monkeypatch.setattr("crane_fmu.report.figures.figure_file", lambda *_: b"drawn")
        assert closed_loop.files() == {"closed_loop.png": b"drawn", "closed_loop.svg": b"drawn"}
        assert closed_loop.figure.get_supxlabel() == closed_loop.by
        assert closed_loop.by.endswith("form reduced, exact inversion at every communication step")

    def test_projected_backward_euler_is_called_the_scheme_of_the_paper_and_comes_last(self, written: Sections) -> None:
        headings = list(written)
        assert headings[-1] == "The scheme of the paper"
        for parts in written.values():
            for each in parts:
                if not isinstance(each, str) and "projected" in each.by:
                    assert "the scheme of the paper" in each.by

    def test_it_declares_its_data_an_assumption(self, html: str) -> None:
        assert "declared assumption" in " ".join(html.split())

    def test_it_names_no_machine_and_no_day(self, html: str) -> None:
        assert not re.search(r"/(home|root|tmp|usr|work)/|\b20[12]\d-\d\d", html)
        assert "@media print" in html

    def test_the_reference_of_the_paper_is_the_only_year(self, html: str) -> None:
        text = re.sub(r"<script.*?</script>|base64,[^\"]*", "", html, flags=re.DOTALL)
        assert set(re.findall(r"\b(?:19|20)\d\d\b", text)) == {"2009"}

    def test_texts_are_escaped_and_symbols_set(self) -> None:
        assert formula("a < b & M_b") == "a &lt; b &amp; <i>M</i><sub>b</sub>"
        assert formula("bridge_inertia") == "bridge_inertia"

    @pytest.mark.parametrize(
        ("text", "drawn"),
        [
            ("F by 0.277 % of its peak; the FMU", "<i>F</i> by 0.277 % of its peak; the FMU"),
            ("up to t = 20 s in steps of 0.1 s", "up to <i>t</i> = 20 s in steps of 0.1 s"),
            ("φ (rad)", "<i>φ</i> (rad)"),
            ("reference function s(t)", "reference function <i>s</i>(<i>t</i>)"),
            ("trolley position s, rope length l;", "trolley position <i>s</i>, rope length <i>l</i>;"),
            ("a path in m, a time in s", "a path in m, a time in s"),
        ],
    )
    def test_symbols_are_italic_and_units_upright(self, text: str, drawn: str) -> None:
        assert formula(text) == drawn

    def test_the_data_of_the_crane_are_all_there(self, crane: sc.Scene) -> None:
        table = parameter_table(crane.with_parameters(load_mass=80.0))
        assert {row[2]: row[1] for row in table.rows} == {
            "bridge_inertia": "480 kg m²", "trolley_mass": "10 kg", "load_mass": "80 kg",
            "winch_inertia": "0.1 kg m²", "winch_radius": "0.1 m", "gravity": "9.81 m/s²",
        }  # fmt: skip


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (23.398, "23.4"), (0.00298, "0.00298"), (7.45e-4, "7.5·10⁻⁴"), (1.94e-13, "2·10⁻¹³")],
)  # fmt: skip
def test_numbers_are_short(value: float, text: str) -> None:
    assert number(value) == text


def test_the_error_table_shows_the_factor_between_two_steps(found: Study) -> None:
    table = contents.paper_table(found)
    assert [row[0] for row in table.rows] == [m for m in found.models for _ in STEPS]
    first, second = table.rows[:2]
    assert "÷" not in "".join(first)
    assert re.search(r"÷(1\.9|2\.0)", second[2])
    assert "÷" not in "".join("".join(row) for row in contents.paper_table(found, factors=False).rows)


def test_the_headline_numbers_are_those_of_the_summary(found: Study) -> None:
    summary = " ".join(contents.summary(found))
    assert [fact.value for fact in contents.facts(found) if fact.value not in summary] == []
