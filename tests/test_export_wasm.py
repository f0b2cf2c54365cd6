"""WebAssembly modules behind their loader in a browser: the library's numbers, nothing imported, refusals."""

from __future__ import annotations

import base64
import importlib.util
import json
import shutil
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from browser import Page, require_browser
from command_lines import servocore as run
from fmu_host import built_once
from native_fmu import FULL, scene_called

import servocore as sc
from servocore.export import targets, wasm
from servocore.numerics.compiled_calls import Array

INSTANTS, STEPS = 1000, 200
SCENES = sorted(sc.scenes.REGISTRY) if FULL else ["elastic_bar", "mass_on_car", "rotary_crane"]
needs_zig = pytest.mark.skipif(targets.zig() is None, reason="needs ziglang")
Found = tuple[dict[str, Array], npt.NDArray[np.int32]]


@cache
def module_file(name: str) -> Path:
    return built_once(f"{name}.wasm", lambda file: sc.export_wasm(scene_called(name), file))


class Engine:
    """A browser that calls modules by their loader."""

    def __init__(self, page: Page) -> None:
        self.page, self.loaded = page, dict[str, Any]()

    def about(self, name: str) -> Any:
        """Load a module, and return its description."""
        if name not in self.loaded:
            loader, content = (
                base64.b64encode(file.read_bytes()).decode()
                for file in (module_file(name).with_suffix(wasm.LOADER), module_file(name))
            )
            self.loaded[name] = self.page.run(
                f'import("data:text/javascript;base64,{loader}").then(async ({{ load }}) => {{'
                f' const bytes = Uint8Array.from(atob("{content}"), (each) => each.charCodeAt(0));'
                f" globalThis.load = load; globalThis.{name} = await load(bytes); return {name}.about; }})"
            )
        return self.loaded[name]

    def call(self, name: str, call: str, jets: np.ndarray, *more: float, **options: Any) -> Found:
        """Return outputs by name and verdicts for jets (N, orders, m); what is not finite arrives as null."""
        self.about(name)
        path = json.dumps(np.ascontiguousarray(jets.reshape(len(jets), -1).T).ravel().tolist())
        words = ", ".join([f"Float64Array.from({path})", *map(repr, more), json.dumps(options)])
        found = json.loads(
            self.page.run(
                f"(() => {{ const {{ outputs, verdicts, solved }} = {name}.{call}({words}); return JSON.stringify("
                "[Object.entries(outputs).map(([name, row]) => [name, [...row]]), [...verdicts], solved]); })()"
            )
        )
        verdicts = np.array(found[1], dtype=np.int32)
        assert found[2] == (verdicts == 0).sum()
        return {key: np.array(row, dtype=float) for key, row in found[0]}, verdicts

    def refused(self, script: str) -> str:
        """Return the message of what a script throws."""
        return str(
            self.page.run(f"(async () => {{ try {{ {script}; }} catch (error) {{ return error.message; }} }})()")
        )

    def jets(self, name: str, t: Array, path: sc.Reference | None = None) -> np.ndarray:
        scene = scene_called(name)
        orders = len(self.about(name)["path"]) // len(scene.model().outputs)
        return (path or scene.reference).jet(np.asarray(t, dtype=float), orders - 1)

    def march(self, name: str, t: np.ndarray, path: sc.Reference | None = None, **parameters: float) -> Found:
        """March over even instants, from a start at the first."""
        h = float(t[1] - t[0])
        times = np.concatenate([t[0] + h * np.array(self.about(name)["instants"]), t[1:]])
        return self.call(name, "march", self.jets(name, times, path), h, start=float(t[0]), parameters=parameters)


@pytest.fixture(scope="module")
def engine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Engine]:
    require_browser()
    folder = tmp_path_factory.mktemp("browser")
    (folder / "empty.html").write_text("<!doctype html>", encoding="utf-8")
    with Page(folder / "empty.html", folder / "profile") as page:
        yield Engine(page)


def instants(name: str, count: int) -> np.ndarray:
    path = scene_called(name).reference
    return np.linspace(path.start_time, path.end_time, count + 1)


def assert_equal(found: Found, solution: sc.Solution, within: float) -> None:
    """Compare all outputs, relative to their peaks; every instant is solved."""
    assert len(found[1]) == len(solution.t)
    assert not found[1].any()
    for name, values in found[0].items():
        assert np.abs(values - solution[name]).max() <= within * max(np.abs(solution[name]).max(), 1e-300), name


@needs_zig
@pytest.mark.parametrize(
    ("name", "parameters"),
    [*((name, {}) for name in SCENES if name not in ("mass_on_car", "passive_joint_arm", "loop_manipulator")),
     ("rotary_crane", {"load_mass": 80.0})],
    ids=str,
)  # fmt: skip
def test_inputs_at_a_thousand_instants_are_those_of_the_library(
    name: str, parameters: dict[str, float], engine: Engine
) -> None:
    t, scene = instants(name, INSTANTS), scene_called(name).with_parameters(**parameters)
    found = engine.call(name, "invert", engine.jets(name, t), parameters=parameters)
    assert_equal(found, sc.solve(scene, step=t[1] - t[0]), 1e-12)


EIGHT = sc.figure_of_eight((8.0, 0.0, -5.0), (2.0, 0.0, 0.0), (0.0, 1.0, 0.5), 12.0)


@needs_zig
@pytest.mark.parametrize(
    ("name", "parameters", "path"),
    [*((name, {}, None) for name in (*SCENES, "wind")), ("rotary_crane", {"load_mass": 80.0}, None),
     ("rotary_crane", {}, EIGHT)],
    ids=lambda each: str(each)[:20],
)  # fmt: skip
def test_steps_of_the_projected_form_are_those_of_the_library(
    name: str, parameters: dict[str, float], path: sc.Reference | None, engine: Engine
) -> None:
    """Also where the equations contain the time, with other parameters, and from a start in motion."""
    scene = scene_called(name).with_parameters(**parameters)
    scene = scene if path is None else scene.with_reference(path)
    t = np.linspace(scene.reference.start_time, scene.reference.end_time, STEPS + 1)
    found = engine.march(name, t, path, **parameters)
    assert_equal(found, sc.solve(scene, sc.Projected(), sc.BackwardEuler(), step=t[1] - t[0], checks=False), 1e-9)


@needs_zig
def test_an_instant_that_is_none_has_a_verdict_and_leaves_the_others_alone(engine: Engine) -> None:
    told = engine.jets("rotary_crane", instants("rotary_crane", 20))
    usual, _ = engine.call("rotary_crane", "invert", told)
    told[3, 1, 0] = np.nan
    told[5, 2, 2] = -20.0  # falls faster than freely: a slack rope
    found, verdicts = engine.call("rotary_crane", "invert", told)
    assert np.flatnonzero(verdicts).tolist() == [3, 5]
    sentences = [engine.about("rotary_crane")["verdicts"][verdicts[k]] for k in (3, 5)]
    assert sentences[0] == "the path is not finite"
    assert "slack" in sentences[1]
    for name, values in found.items():
        assert np.isnan(values[[3, 5]]).all()
        np.testing.assert_array_equal(values[verdicts == 0], usual[name][verdicts == 0])


@needs_zig
def test_marching_ends_where_a_step_is_not_solved(engine: Engine) -> None:
    t = instants("rotary_crane", 20)
    told = np.concatenate([engine.jets("rotary_crane", t[:1]), engine.jets("rotary_crane", t)])
    told[8] = np.nan
    found, verdicts = engine.call("rotary_crane", "march", told, float(t[1]))
    assert np.flatnonzero(verdicts).tolist() == list(range(7, 21))
    assert np.isnan(found["F"][7:]).all()


@needs_zig
def test_marching_ends_with_a_step_onto_another_branch(engine: Engine) -> None:
    beside_axis = sc.rest_to_rest((5.0, 0.02, -5.0), (-5.0, 0.02, -5.0), 10.0)
    found, verdicts = engine.march("rotary_crane", 0.2 * np.arange(51), beside_axis)
    sentences = engine.about("rotary_crane")["verdicts"]
    beyond = int(np.argmax(verdicts != 0))
    assert 20 < beyond < 30  # where the bridge would have to turn within a step
    assert sentences[verdicts[beyond]] == "the solution is on another branch than the intended one"
    assert {sentences[k] for k in verdicts[beyond + 1 :]} == {"the equations are not solved"}
    assert np.isnan(found["F"][beyond:]).all()


ONE, TWO = "new Float64Array(15)", "new Float64Array(30)"


@needs_zig
@pytest.mark.parametrize(
    ("script", "sentence"),
    [
        (f"{{}}.invert({ONE}.slice(1))", "a path has 15 values at each instant, at least at 1: 14 do not fit"),
        (f"{{}}.invert({ONE}, {{ parameters: {{ mass: 1 }} }})", "rotary_crane has no parameter mass"),
        (f"{{}}.invert({ONE}, {{ parameters: {{ load_mass: -80 }} }})",
         "load_mass = -80 kg is outside its range [0.001, 1000000000] kg"),
        (f"{{}}.march({TWO}, 0.1, {{ parameters: {{ gravity: NaN }} }})",
         "gravity = NaN m/s2 is outside its range [0.001, 1000] m/s2"),
        ("{}.invert()", "a path has 15 values at each instant, at least at 1: undefined do not fit"),
        (f"{{}}.invert({ONE}, {{ times: [0, 1] }})", "a path of 1 instants needs as many times, not 2"),
        (f"{{}}.march({ONE}, 0.1)", "a path has 15 values at each instant, at least at 2: 15 do not fit"),
        (f"{{}}.march({TWO})", "steps are above 0 s, not undefined s from 0 s on"),
        (f"{{}}.march({TWO}, -0.1)", "steps are above 0 s, not -0.1 s from 0 s on"),
        (f"{{}}.march({TWO}, 0.1, {{ start: NaN }})", "steps are above 0 s, not 0.1 s from NaN s on"),
        ('await load(new Response("", { status: 404, statusText: "Not Found" }))', ": 404 Not Found"),
        ("await load(new Uint8Array([0, 97, 115, 109, 1, 0, 0, 0]))",
         "this module is none of `servocore export --wasm`"),
    ],
)  # fmt: skip
def test_wrong_calls_of_the_loader_are_refused_with_a_sentence(script: str, sentence: str, engine: Engine) -> None:
    engine.about("rotary_crane")
    told = script.replace("{}.", "rotary_crane.").replace("{{", "{").replace("}}", "}")
    assert engine.refused(told) == sentence


@needs_zig
def test_the_loader_asks_for_times_where_equations_hold_the_time(engine: Engine) -> None:
    engine.about("waves")
    assert engine.refused(f"waves.invert({ONE})") == "the equations of waves contain the time: times are needed"
    found, _ = engine.call("waves", "invert", np.zeros((2, 3, 1)), times=[1.0, 2.0])
    np.testing.assert_allclose(found["F"], -np.sin([1.0, 2.0]), rtol=1e-15)


@needs_zig
def test_modules_and_paths_of_all_lengths_keep_to_themselves(engine: Engine) -> None:
    rest = np.zeros((20_000, 5, 3))
    rest[:, 0] = (5.0, 5.0, -5.0)
    short, _ = engine.call("rotary_crane", "invert", rest[:1])
    long, _ = engine.call("rotary_crane", "invert", rest)
    bar = len(engine.about("elastic_bar")["path"])
    engine.call("elastic_bar", "invert", np.zeros((1, bar, 1)))
    again, _ = engine.call("rotary_crane", "invert", rest[:1])
    assert {*short["M_w"], *long["M_w"], *again["M_w"]} == {short["M_w"][0]}


@needs_zig
@pytest.mark.parametrize("name", sorted(sc.scenes.REGISTRY) if FULL else ["passive_joint_arm", "rotary_crane"])
def test_a_module_imports_nothing_and_is_small(name: str) -> None:
    """An engine that is no browser makes an instance of it without any import."""
    content = module_file(name).read_bytes()
    assert len(content) <= (95_000 if name == "loop_manipulator" else 50_000)  # a closed loop, with internal dynamics
    if importlib.util.find_spec("wasmtime") is not None:
        import wasmtime

        store = wasmtime.Store()
        assert wasmtime.Instance(store, wasmtime.Module(store.engine, content), []).exports(store)["memory"]


@needs_zig
@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node")
def test_the_script_of_the_page_runs(tmp_path: Path) -> None:
    page = Path(__file__).resolve().parents[1] / "docs" / "howto" / "web-page.md"
    script = page.read_text(encoding="utf-8").split('<script type="module">\n')[1].split("</script>")[0]
    shutil.copy(module_file("rotary_crane"), tmp_path / "crane.wasm")
    shutil.copy(module_file("rotary_crane").with_suffix(wasm.LOADER), tmp_path / "crane.mjs")
    (tmp_path / "main.mjs").write_text(
        'import fs from "node:fs";\nglobalThis.fetch = async (name) => new Response(fs.readFileSync(name));\n' + script,
        encoding="utf-8",
    )
    done = subprocess.run(["node", "main.mjs"], cwd=tmp_path, capture_output=True, text=True, timeout=600, check=True)
    torque, solved = done.stdout.split()
    crane = scene_called("rotary_crane").parameter_values()
    assert float(torque) == pytest.approx(-80.0 * crane["gravity"] * crane["winch_radius"], rel=1e-15)
    assert solved == "true"


@needs_zig
def test_the_command_writes_module_and_loader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "cars.wasm, cars.mjs: WebAssembly of cars" in run("export", "cars", "--wasm", "cars.wasm").output
    assert sorted(each.name for each in tmp_path.iterdir()) == ["cars.mjs", "cars.wasm"]


def test_what_cannot_be_a_module_is_refused_with_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(wasm, "zig", lambda: None)
    run.assert_refused(
        run("export", "cars", "--wasm", "cars.wasm"), "run pip install '.[native]' in a clone of the project"
    )
    assert not any(tmp_path.iterdir())
