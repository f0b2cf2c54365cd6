"""Live pages: what they are told is right, and in a real browser they compute what the library computes.

The browser is Chromium, driven over a pipe. Without one its tests are skipped; with SERVOCORE_REQUIRE_BROWSER set, as
in .ci/run, they fail.
"""

import json
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from browser import Page, require_browser
from command_lines import servocore as run
from outside.writing import lagrange
from present import present
from test_machine_code import OPERATIONS, x, y

import servocore as sc
from servocore.model.drawing import picture_of
from servocore.problem import Problem
from servocore.stepping.observation import observed
from servocore.view.javascript import javascript
from servocore.view.live_model import LiveModel, live_model

SCENES = sorted(sc.scenes.REGISTRY)
LIVE = [name for name in SCENES if name not in ("mass_on_car", "passive_joint_arm", "loop_manipulator")]
LARGEST_PAGE = 6_000_000


@pytest.fixture(scope="module")
def page_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return what writes the page of a scene, once."""
    folder, made = tmp_path_factory.mktemp("pages"), {}

    def write(name: str, scene: sc.Scene | None = None) -> Path:
        if name not in made:
            scene = scene or sc.scenes.REGISTRY[name]()
            made[name] = sc.view(sc.solve(scene, step=scene.reference.duration / 200), folder / f"{name}.html")
        return made[name]

    return write


@pytest.fixture(scope="module")
def opened(page_of: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """Return the page of the rotary crane in a browser."""
    require_browser()
    with Page(page_of("rotary_crane"), tmp_path_factory.mktemp("profile")) as page:
        yield page


def own_crane() -> sc.Scene:
    """Return an overhead crane as a user would write it, without a drawing, on a path through waypoints."""
    names = ("trolley.x", "load.x", "load.z", "rope")
    coordinates = sc.Coordinates(*(sc.Quantity(name, "m", positive=name == "rope") for name in names))
    parameters = sc.Parameters(sc.Parameter("trolley", 10.0, "kg", 1.0), sc.Parameter("load", 50.0, "kg", 1.0))
    (trolley, x, z, rope), lam = ca.vertsplit(coordinates.q), ca.SX.sym("lam")
    masses = ca.vertcat(parameters["trolley"], parameters["load"], parameters["load"], 5)
    system = lagrange(
        "own crane",
        coordinates,
        ca.dot(masses, coordinates.v**2) / 2,
        {"x": x, "z": z},
        {"F": trolley, "R": rope},
        parameters=parameters,
        potential=9.81 * parameters["load"] * z,
        constraints=(x - trolley) ** 2 + z**2 - rope**2,
        multipliers=lam,
        guess=lambda at: (at[0], at[0], at[1], -at[1]),
        home=(0.0, -3.0),
        observables={sc.Quantity("tension", "N"): 2 * lam * rope},
    )
    (x, z), pull = ca.vertsplit(system.gamma[:, 0]), system.gamma[:, 2] + ca.vertcat(0, 9.81)
    system = replace(system, guess=ca.vertcat(x - z * pull[0] / pull[1], x, z, -z * ca.norm_2(pull) / pull[1]))
    path = sc.through([(0.0, -4.0), (3.0, -2.0), (5.0, -3.0)], [0.0, 2.0, 4.0])
    return sc.Scene("own", {"only": lambda: system}, path)


OWN_QUANTITIES = [sc.Quantity(name, "m") for name in ("trolley.x", "load.x", "load.z", "rope")]


def told(file: Path) -> dict[str, Any]:
    data = present(re.search(r'id="live-data">(.*?)</script>', file.read_text(encoding="utf-8"), re.DOTALL))
    values: dict[str, Any] = json.loads(data[1])
    return values


# What is written ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_becomes_one_file_that_needs_nothing_else(page_of: Callable[..., Path], name: str) -> None:
    html = page_of(name).read_text(encoding="utf-8")
    assert "http" not in html
    assert not re.search(r'<link|@import|\bsrc=|\bimport\(|fetch\(|"use module"', html)
    assert len(html.encode()) < LARGEST_PAGE
    assert told(page_of(name))["live"] == (name in LIVE)
    assert ('id="live-check"' in html) == (name in LIVE)


@pytest.mark.parametrize("name", LIVE)
def test_what_a_page_computes_is_what_the_library_computes(name: str) -> None:
    scene = sc.scenes.REGISTRY[name]()
    solution = sc.solve(scene, step=scene.reference.duration / 50)
    problem = Problem.of(scene)
    found = live_model(problem).values(problem, solution.t)
    np.testing.assert_allclose(found, solution.values, rtol=0.0, atol=1e-12 * np.abs(solution.values).max())


def test_scenes_with_internal_dynamics_are_shown_with_the_reason_why_they_are_not_computed(
    page_of: Callable[..., Path],
) -> None:
    html = " ".join(page_of("mass_on_car").read_text(encoding="utf-8").split())
    assert "mass on car is not computed again here, for its inputs depend on internal dynamics" in html


def test_every_operation_is_that_of_casadi() -> None:
    if shutil.which("node") is None:
        pytest.skip("needs Node")
    results = [*OPERATIONS, ca.asinh(x), ca.acosh(x + 1), ca.atanh(x / 9), ca.log1p(x), ca.expm1(x)]
    results += [ca.copysign(x, -y), x**y, ca.SX(np.inf), ca.SX(-0.1)]
    function = ca.Function("f", [ca.vertcat(x, y)], [ca.vertcat(*results)])
    points = [(0.7, 1.9), (2.5, 0.4), (1.0, 1.0)]
    code = (
        f"const f = {javascript(function)}; const all = {json.dumps(points)}.map((p) => {{"
        f" const r = new Float64Array({len(results)}); f(p, r); return [...r].map(String); }});"
        " console.log(JSON.stringify(all));"
    )
    done = subprocess.run(["node", "-e", code], capture_output=True, text=True, timeout=600, check=True)
    for point, found in zip(points, json.loads(done.stdout), strict=True):
        expected = np.array(function(point)).ravel()
        np.testing.assert_allclose([float(each.replace("Infinity", "inf")) for each in found], expected, rtol=1e-14)


def test_a_function_that_calls_others_is_refused_with_a_sentence() -> None:
    x = ca.MX.sym("x")
    with pytest.raises(sc.InvalidModel, match="cannot be written as JavaScript"):
        javascript(ca.Function("f", [x], [x]))


def test_a_solution_that_does_not_know_what_was_solved_has_to_be_told(tmp_path: Path) -> None:
    scene = sc.scenes.cars()
    solution = sc.solve(scene)
    lost = sc.Solution(solution.t, solution.channels, solution.values, solution.route)
    with pytest.raises(sc.InvalidSetting, match=r"has no origin: give its scene, view\(solution, path, scene=scene\)"):
        sc.view(lost, tmp_path / "cars.html")
    assert told(sc.view(lost, tmp_path / "cars.html", scene=scene))["live"]


def test_what_is_no_number_is_refused_and_no_page_is_written(tmp_path: Path) -> None:
    scene = sc.scenes.overhead_crane()
    solution = sc.solve(scene, step=scene.reference.duration / 10)
    values = solution.values.copy()
    values[4, [each.name for each in solution.channels].index("swing")] = np.nan
    with pytest.raises(sc.InvalidModel, match=r"^overhead_crane has no swing at t = 1\.2 s, and a page shows finite"):
        sc.view(replace(solution, values=values), tmp_path / "crane.html")
    assert not any(tmp_path.iterdir())


def test_formulas_that_give_no_number_are_not_put_into_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    solution = sc.solve(sc.scenes.cars())
    monkeypatch.setattr(LiveModel, "values", lambda live, _, t: np.full((len(t), len(live.outputs)), np.nan))
    page = told(sc.view(solution, tmp_path / "cars.html"))
    assert not page["live"]
    assert sc.live_part(solution).why.startswith("its formulas give no ")


def test_coordinates_of_one_name_are_a_body_and_what_holds_two_together_is_drawn() -> None:
    found = picture_of(own_crane().model(), OWN_QUANTITIES, None)
    assert [(part["kind"], part["name"]) for part in found.parts] == [
        ("bar", ""),
        ("body", "trolley"),
        ("body", "load"),
    ]
    assert found.flat
    assert found.parts[-1]["places"] == [found.tracked]


@pytest.mark.parametrize("name", [name for name in SCENES if name != "passive_joint_arm"])  # tracks a sum of angles
def test_what_follows_the_path_is_drawn_on_it(name: str) -> None:
    scene = sc.scenes.REGISTRY[name]()
    system, solution = scene.model(), sc.solve(scene, step=scene.reference.duration / 200)
    found = picture_of(system, [each for each, _ in observed(system)], scene.drawing)
    place = ca.Function("place", [found.reported, system.p], [found.coordinates])
    values = [solution[each.name] for each, _ in observed(system)]
    points = np.asarray(place(np.array(values), system.parameters.values()))
    axes = {1: [0], 2: [0, 2], 3: [0, 1, 2]}[len(system.outputs)]  # of outputs: along, upwards, across if there is more
    for axis, output in zip(axes, system.outputs, strict=True):
        np.testing.assert_allclose(points[3 * present(found.tracked) + axis], solution[output.name], atol=1e-9)
    assert found.about()["grounded"] == (name not in {"cars", "elastic_bar"})  # which have springs and boxes only
    places = points.reshape(found.points, 3, -1)
    joints = [part for part in found.parts if part["kind"] in {"bar", "bridge", "post", "rope", "spring"}]
    for part in joints:  # each touches another part
        rest = [k for each in found.parts if each is not part for k in each["places"]]
        assert np.abs(places[part["places"], None] - places[rest]).max(axis=(2, 3)).min() < 1e-9


@pytest.mark.parametrize(
    ("name", "effect"),
    [("rotary_crane", "flexible bridge"), ("overhead_crane", "hook"), ("gantry_crane", "flexible bridge")],
)
def test_cranes_with_more_physics_are_drawn_as_well(name: str, effect: str) -> None:
    scene = sc.scenes.REGISTRY[name]().with_effects(effect)
    found = picture_of(scene.model(), [each for each, _ in observed(scene.model())], scene.drawing)
    assert {"trolley", "load"} <= {part["name"] for part in found.parts}


@pytest.mark.parametrize(
    ("drawing", "sentence"),
    [
        (
            lambda v: [sc.Part("body", ((v["nothing"], 0, 0),))],
            "its drawing uses 'nothing', which is not reported; there are",
        ),
        (lambda v: [sc.Part("body", ((v["rope"], 0, 0),), colour="heat")], "coloured by heat, which is not reported"),
        (lambda _: ["body"], "must be a sequence of Part"),
    ],
)
def test_a_drawing_that_cannot_be_drawn_is_refused_with_a_sentence(
    drawing: Callable[[dict[str, ca.SX]], object], sentence: str
) -> None:
    with pytest.raises(sc.InvalidModel, match=re.escape(sentence)):
        picture_of(own_crane().model(), OWN_QUANTITIES, drawing)  # type: ignore[arg-type]  # wrong on purpose


def test_a_part_that_is_none_is_refused_with_a_sentence() -> None:
    with pytest.raises(sc.InvalidSetting, match="no part of kind wheel"):
        sc.Part("wheel", ((0, 0, 0),))
    with pytest.raises(sc.InvalidSetting, match="a rope is drawn at 2 points"):
        sc.Part("rope", ((0, 0, 0),))


@pytest.mark.usefixtures("empty_folder")
def test_the_command_writes_a_page_of_any_scene_with_limits_that_may_be_exceeded(tmp_path: Path) -> None:
    assert run("view", "cars", "--limit", "u=0.5").stdout == "cars.html: cars, live\n"
    assert told(tmp_path / "cars.html")["limits"] == [{"output": 0, "low": -0.5, "high": 0.5, "rate": False}]
    assert "mine.html: mass_on_car, as solved: its inputs" in run("view", "mass_on_car", "-o", "mine.html").stdout
    run.assert_refused(run("view", "cars", "--limit", "v=1"), "reports nothing called v")


# In a browser ---------------------------------------------------------------------------------------------------------


def settled(page: Page, script: str) -> object:
    """Run a script, and wait until what it changed is shown."""
    shown = "await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
    return page.run(f"(async () => {{ {script}; {shown}; }})()")


SET = """const row = [...document.querySelectorAll(".control")].find((each) => each.textContent.startsWith("%s"));
const field = row.querySelector("input[type=number]"); field.value = %r; field.dispatchEvent(new Event("input"))"""


STATUS = 'document.querySelector(".status").textContent'
LABELLED = '[...document.querySelectorAll("input")].find((each) => each.ariaLabel === "%s in N m")'


def bound(page: Page, label: str, value: float | str) -> None:
    """Fill the field of a limit of M_b or M_w."""
    change = 'field.dispatchEvent(new Event("input"))'
    settled(page, f"const field = {LABELLED % label}; field.value = {json.dumps(value)}; {change}")


def outline(page: Page, number: int) -> str:
    return str(page.run(f'document.querySelectorAll(".plot .curve.exact")[{number}].getAttribute("d")'))


def test_the_pages_own_numbers_are_those_of_python(opened: Page) -> None:
    assert 0.0 <= float(opened.run('document.getElementById("live-check").textContent')) < 1e-12
    assert opened.errors == []


def test_it_moves_and_stops(opened: Page) -> None:
    picture = 'document.querySelector("canvas").toDataURL()'
    before = opened.run(picture)
    settled(opened, 'document.querySelector(".primary").click()')
    while not opened.run("servocore.now") > 2.0:  # it sets out so gently that the first pictures are alike
        settled(opened, "")
    settled(opened, 'document.querySelector(".primary").click()')
    stopped = opened.run(picture)
    assert stopped != before
    settled(opened, "")
    assert opened.run(picture) == stopped


@pytest.mark.parametrize("width", [1280, 375])
def test_fields_show_every_digit_of_what_was_given(width: int, tmp_path: Path) -> None:
    require_browser()
    path = sc.rest_to_rest((5.1234, 0.0, -5.0), (-2.0, 2.0456, -2.0), 20.25)
    crane = sc.scenes.rotary_crane().with_parameters(load_mass=12345.6, bridge_inertia=1234567.0).with_reference(path)
    file = sc.view(sc.solve(crane.with_limits(F=123456.7, swing="5.25 deg")), tmp_path / "crane.html")
    fields = '[...document.querySelectorAll("input[type=number]")]'
    with Page(file, tmp_path / "profile", width=width) as page:
        shown = page.run(f"{fields}.map((field) => field.value)")
        assert {"20.25", "12345.6", "1234567", "5.1234", "2.0456", "123456.7", "5.25"} <= {*shown}
        cut = "(field) => field.scrollWidth > field.clientWidth + 1"
        assert page.run(f"{fields}.filter({cut}).map((field) => field.value)") == []
        assert page.run("document.documentElement.scrollWidth <= window.innerWidth")
        assert page.errors == []


def test_a_slider_changes_the_curves_to_what_the_library_gives(opened: Page) -> None:
    before = outline(opened, 2)
    settled(opened, SET % ("load mass", 137.0))
    assert outline(opened, 2) != before
    settled(opened, SET % ("duration", 16.0))
    settled(opened, SET % ("paper's step", 0.08))
    path = sc.rest_to_rest((5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), 16.0)
    crane = sc.scenes.rotary_crane().with_parameters(load_mass=137.0).with_reference(path)
    exact = sc.solve(crane, step=0.008)
    paper = sc.solve(crane, sc.Projected(), sc.BackwardEuler(), step=0.08, checks=False)
    for attribute, solution, tolerance in (("run", exact, 1e-12), ("paper", paper, 1e-9)):
        for k, name in enumerate(solution.names):
            found = opened.run(f"[...servocore.{attribute}.rows[{k}]]")
            scale = max(np.abs(solution[name]).max(), 1e-3)
            np.testing.assert_allclose(found, solution[name], rtol=0.0, atol=tolerance * scale, err_msg=name)
    settled(opened, "[...document.querySelectorAll('button')].find((b) => b.textContent === 'Reset').click()")
    assert opened.errors == []


def test_other_time_laws_and_ends_are_those_of_the_library(opened: Page) -> None:
    settled(opened, "servocore.law.value = 2; servocore.law.dispatchEvent(new Event('change'))")
    settled(opened, "servocore.settings.end[1] = 3; servocore.change()")
    path = sc.rest_to_rest((5.0, 0.0, -5.0), (-2.0, 3.0, -2.0), 20.0, sc.three_phase())
    exact = sc.solve(sc.scenes.rotary_crane().with_reference(path), step=0.01)
    found = opened.run("[...servocore.run.rows[0]]")
    np.testing.assert_allclose(found, exact["M_b"], rtol=0.0, atol=1e-12 * np.abs(exact["M_b"]).max())
    settled(opened, "servocore.reset()")


def test_a_limit_lights_up_where_it_is_exceeded(opened: Page) -> None:
    label = "limit of the magnitude of M_b"
    bound(opened, label, 180)
    assert opened.run(STATUS) == "All limits are kept."
    settled(opened, SET % ("duration", 12.0))
    assert re.match(r"Limit exceeded: M_b reaches −\d+ N m at \d[^;]*$", opened.run(STATUS))
    assert opened.run('document.querySelectorAll(".plot.exceeded").length') == 1
    settled(opened, "servocore.settings.end[2] = 1; servocore.change()")
    assert "the load is not below the girder" in opened.run(STATUS)
    settled(opened, "servocore.reset()")
    assert opened.run(STATUS) == "All limits are kept."
    bound(opened, label, "")
    assert opened.run(STATUS) == ""


def test_no_limit_is_judged_that_nobody_set(opened: Page) -> None:
    assert opened.run(STATUS) == ""
    assert opened.run('document.querySelector(".status").offsetHeight') == 0
    assert opened.run('[...document.querySelectorAll(".plot .bound-field input")].every(({ value }) => value === "")')
    settled(opened, SET % ("duration", 6.0))  # large inputs
    assert opened.run(STATUS) == ""
    assert opened.run('document.querySelectorAll(".plot.exceeded").length') == 0
    settled(opened, "servocore.settings.end[2] = 1; servocore.change()")
    assert "the load is not below the girder" in opened.run(STATUS)  # the model is not valid there
    settled(opened, "servocore.reset()")
    assert opened.errors == []


def test_keys_move_the_time_zoom_and_orbit(opened: Page) -> None:
    settled(opened, 'document.querySelector(".plot svg").focus(); servocore.go(5)')
    opened.press("ArrowRight")
    assert opened.run("servocore.now") == pytest.approx(5.2)
    opened.press("+")
    assert opened.run("servocore.view.to - servocore.view.from") == pytest.approx(20.0 / 1.5)
    opened.press("Escape")
    assert opened.run("servocore.view.to - servocore.view.from") == pytest.approx(20.0)
    azimuth = opened.run('document.querySelector("canvas").focus(), servocore.stage.look.azimuth')
    opened.press("ArrowLeft")
    assert opened.run("servocore.stage.look.azimuth") != azimuth


def middle_of(page: Page, selector: str) -> tuple[float, float, float]:
    """Return where the middle of an element is in the window, and a quarter of its width."""
    box = page.run(
        f"(() => {{ const e = document.querySelector('{selector}'); e.scrollIntoView({{ block: 'center' }});"
        " const b = e.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2, b.width / 4]; })()"
    )
    return tuple(box)


def test_the_mouse_reads_values_zooms_and_orbits(opened: Page) -> None:
    settled(opened, "servocore.go(0)")
    x, y, quarter = middle_of(opened, ".plot svg")
    opened.drag((x, y))
    time = opened.run("servocore.plots[0].plot.now")
    assert 8.0 < time < 12.0
    exact = sc.ExactInversion(sc.scenes.rotary_crane())(time)[0]
    shown = opened.run('document.querySelector(".plot .value.exact").textContent')
    assert float(shown.replace("−", "-")) == pytest.approx(exact, rel=1e-3)
    opened.drag((x - quarter, y), (x, y), (x + quarter, y))
    assert 8.0 < opened.run("servocore.view.to - servocore.view.from") < 14.0
    settled(opened, "servocore.zoom()")
    before = opened.run("servocore.stage.look.azimuth")
    x, y, quarter = middle_of(opened, "canvas")
    opened.drag((x, y), (x + quarter, y))
    assert opened.run("servocore.stage.look.azimuth") < before
    settled(opened, f"servocore.stage.look.azimuth = {before}; scrollTo(0, 0)")


def test_it_follows_the_dark_mode_and_prints_on_white(opened: Page) -> None:
    ground = "getComputedStyle(document.documentElement).backgroundColor"
    opened.media(dark=True)
    assert opened.run(ground) == "rgb(21, 24, 28)"
    opened.media(dark=True, kind="print")
    assert opened.run(ground) == "rgb(255, 255, 255)"
    assert opened.run('getComputedStyle(document.querySelector(".controls")).display') == "none"
    opened.media()


@pytest.mark.parametrize("name", [name for name in SCENES if name != "rotary_crane"])
def test_the_page_of_every_scene_runs(opened: Page, page_of: Callable[..., Path], name: str) -> None:
    opened.errors.clear()
    opened.open(page_of(name))
    settled(opened, "servocore.go(servocore.timeOf(0.5))")
    assert opened.errors == []
    assert opened.run('document.querySelectorAll(".plot .curve").length') >= 3
    if name in LIVE:
        assert float(opened.run('document.getElementById("live-check").textContent')) < 1e-12


def test_the_page_of_a_users_own_system_computes_on_a_path_through_waypoints(
    opened: Page, page_of: Callable[..., Path]
) -> None:
    opened.errors.clear()
    opened.open(page_of("own", own_crane()))
    assert float(opened.run('document.getElementById("live-check").textContent')) < 1e-12
    settled(opened, SET % ("duration", 5.0))
    slower = sc.through([(0.0, -4.0), (3.0, -2.0), (5.0, -3.0)], [0.0, 2.5, 5.0])
    exact = sc.solve(own_crane().with_reference(slower), step=0.0025)
    paper = sc.solve(own_crane().with_reference(slower), sc.Projected(), sc.BackwardEuler(), step=0.02, checks=False)
    for attribute, solution, tolerance in (("run", exact, 1e-11), ("paper", paper, 1e-8)):
        found = opened.run(f"[...servocore.{attribute}.rows[0]]")
        np.testing.assert_allclose(found, solution["F"], rtol=0.0, atol=tolerance * np.abs(solution["F"]).max())
    assert opened.errors == []


def test_limits_that_differ_by_more_than_the_sign_have_a_field_each(opened: Page, tmp_path: Path) -> None:
    crane = sc.scenes.rotary_crane().with_limits(M_w=(-104.0, -92.0))
    opened.errors.clear()
    opened.open(sc.view(sc.solve(crane), tmp_path / "crane.html"))
    labels = ("lower limit of M_w", "upper limit of M_w")
    assert [opened.run(f"{LABELLED % each}.value") for each in labels] == ["-104", "-92"]
    assert opened.run(STATUS) == "All limits are kept."
    bound(opened, labels[1], -99)
    assert re.match("Limit exceeded: M_w reaches −9", str(opened.run(STATUS)))
    bound(opened, labels[1], "")
    assert opened.run(STATUS) == "All limits are kept."  # the lower one is left
    assert opened.errors == []


def test_without_scripts_it_says_what_is_missing(opened: Page, page_of: Callable[..., Path]) -> None:
    opened.open(page_of("rotary_crane"), javascript=False)
    opened.ask("DOM.enable")
    html = opened.ask("DOM.getOuterHTML", nodeId=opened.ask("DOM.getDocument")["root"]["nodeId"])["outerHTML"]
    assert "With JavaScript this page would show the motion" in html
