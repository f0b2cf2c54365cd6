"""WebAssembly modules: the library's numbers, nothing imported, in a JavaScript engine, a browser and wasmtime."""

from __future__ import annotations

import gc
import http.server
import importlib.util
import json
import shutil
import subprocess
import threading
from collections.abc import Iterator, Mapping
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from command_lines import CommandLine
from native_fmu import FULL, scene_called
from wasm_module import Module, Verdicts, module_file, sections

import servocore as sc
from servocore.cli.commands import app
from servocore.export import targets, wasm
from servocore.numerics.compiled_calls import Array

run = CommandLine(app, "servocore")
INSTANTS, STEPS = 1000, 200
SCENES = sorted(sc.scenes.REGISTRY) if FULL else ["elastic_bar", "mass_on_car", "rotary_crane"]

HEAVY = ("rotary_crane", {"load_mass": 80.0})

needs_zig = pytest.mark.skipif(targets.zig() is None, reason="needs ziglang")
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="needs Node")
needs_wasmtime = pytest.mark.skipif(
    targets.zig() is None or importlib.util.find_spec("wasmtime") is None, reason="needs ziglang and wasmtime"
)


@cache
def module(name: str) -> Module:
    return Module(name)


@pytest.fixture(scope="module", autouse=True)
def _freed() -> Iterator[None]:
    """Free modules before the interpreter ends, which wasmtime's destructors do not outlive."""
    yield
    module.cache_clear()
    gc.collect()


def jets(name: str, t: Array) -> np.ndarray:
    scene = scene_called(name)
    orders = len(module(name).about["path"]) // len(scene.model().outputs)
    return scene.reference.jet(np.asarray(t, dtype=float), orders - 1)


def instants(name: str, count: int) -> np.ndarray:
    path = scene_called(name).reference
    return np.linspace(path.start_time, path.end_time, count + 1)


def largest_difference(found: dict[str, Array], solution: sc.Solution) -> float:
    """Return the largest difference of all outputs relative to their peaks."""
    peaks = {name: max(np.abs(solution[name]).max(), 1e-300) for name in found}
    return float(max(np.abs(values - solution[name]).max() / peaks[name] for name, values in found.items()))


def marched(name: str, **parameters: float) -> tuple[tuple[dict[str, Array], Verdicts], float, sc.Scene]:
    scene, t = scene_called(name), instants(name, STEPS)
    h = (t[-1] - t[0]) / STEPS
    times = np.concatenate([t[0] + h * np.array(module(name).about["instants"]), t[1:]])
    return module(name).march(jets(name, times), h, t[0], **parameters), h, scene


@needs_wasmtime
@pytest.mark.parametrize("name", [name for name in SCENES if name not in ("mass_on_car", "passive_joint_arm")])
def test_inputs_at_a_thousand_instants_are_those_of_the_library(name: str) -> None:
    t = instants(name, INSTANTS)
    found, verdicts = module(name).invert(jets(name, t))
    assert not verdicts.any()
    assert largest_difference(found, sc.solve(scene_called(name), step=t[1] - t[0])) < 1e-12


@needs_wasmtime
@pytest.mark.parametrize(
    ("name", "parameters"),
    [*((name, {}) for name in (*SCENES, "wind")), ("rotary_crane", {"load_mass": 80.0})],
    ids=str,
)
def test_steps_of_the_projected_form_are_those_of_the_library(name: str, parameters: dict[str, float]) -> None:
    """Also where the equations contain the time, and with other parameters."""
    (found, verdicts), h, scene = marched(name, **parameters)
    assert len(verdicts) == STEPS + 1
    assert not verdicts.any()
    scene = scene.with_parameters(**parameters)
    solution = sc.solve(scene, sc.Projected(), sc.BackwardEuler(), step=h, checks=False)
    assert largest_difference(found, solution) < 1e-9


@needs_wasmtime
def test_a_start_in_motion_takes_the_path_before_it() -> None:
    path = sc.figure_of_eight((8.0, 0.0, -5.0), (2.0, 0.0, 0.0), (0.0, 1.0, 0.5), 12.0)
    scene, h = scene_called("rotary_crane").with_reference(path), 12.0 / STEPS
    times = h * np.concatenate([module("rotary_crane").about["instants"], np.arange(1, STEPS + 1)])
    found, verdicts = module("rotary_crane").march(path.jet(times, 4), h)
    assert not verdicts.any()
    solution = sc.solve(scene, sc.Projected(), sc.BackwardEuler(), step=h, checks=False)
    assert largest_difference(found, solution) < 1e-9


@needs_wasmtime
def test_parameters_are_taken_with_each_call() -> None:
    t = instants("rotary_crane", 100)
    found, _ = module("rotary_crane").invert(jets("rotary_crane", t), load_mass=80.0)
    heavy = sc.solve(scene_called("rotary_crane").with_parameters(load_mass=80.0), step=t[1] - t[0])
    assert largest_difference(found, heavy) < 1e-12


@needs_wasmtime
def test_an_instant_that_is_none_has_a_verdict_and_leaves_the_others_alone() -> None:
    crane, t = module("rotary_crane"), instants("rotary_crane", 20)
    told = jets("rotary_crane", t)
    usual, _ = crane.invert(told)
    told[3, 1, 0] = np.nan
    told[5, 2, 2] = -20.0  # falls faster than freely: a slack rope
    found, verdicts = crane.invert(told)
    assert np.flatnonzero(verdicts).tolist() == [3, 5]
    assert crane.about["verdicts"][verdicts[3]] == "the path is not finite"
    assert "slack" in crane.about["verdicts"][verdicts[5]]
    for name, values in found.items():
        assert np.isnan(values[[3, 5]]).all()
        others = verdicts == 0
        np.testing.assert_array_equal(values[others], usual[name][others])


@needs_wasmtime
def test_marching_ends_where_a_step_is_not_solved() -> None:
    t = instants("rotary_crane", 20)
    told = np.concatenate([jets("rotary_crane", t[:1]), jets("rotary_crane", t)])
    told[8] = np.nan
    found, verdicts = module("rotary_crane").march(told, t[1])
    assert np.flatnonzero(verdicts).tolist() == list(range(7, 21))
    assert np.isnan(found["F"][7:]).all()


@needs_wasmtime
def test_marching_ends_with_a_step_onto_another_branch() -> None:
    beside_axis, h = sc.rest_to_rest((5.0, 0.02, -5.0), (-5.0, 0.02, -5.0), 10.0), 0.2
    crane = module("rotary_crane")
    times = h * np.concatenate([crane.about["instants"], np.arange(1, 51)])
    found, verdicts = crane.march(beside_axis.jet(times, 4), h)
    beyond = int(np.argmax(verdicts != 0))
    assert 20 < beyond < 30  # where the bridge would have to turn within a step
    assert crane.about["verdicts"][verdicts[beyond]] == "the solution is on another branch than the intended one"
    assert {crane.about["verdicts"][k] for k in verdicts[beyond + 1 :]} == {"the equations are not solved"}
    assert np.isnan(found["F"][beyond:]).all()


@needs_zig
@pytest.mark.parametrize("name", sorted(sc.scenes.REGISTRY) if FULL else ["passive_joint_arm", "rotary_crane"])
def test_a_module_imports_nothing_and_is_small(name: str) -> None:
    content = module_file(name).read_bytes()
    assert 2 not in [number for number, _ in sections(content)]  # the section of imports
    assert len(content) <= 50_000


SCRIPT = """
import { load } from "./rotary_crane.mjs";
export async function asked(bytes, path, past) {
  const crane = await load(bytes), refused = [], one = path.slice(0, 15);
  for (const call of [
    () => crane.invert(path.slice(1)),
    () => crane.invert(path, { parameters: { mass: 1 } }),
    () => crane.invert(one, { parameters: { load_mass: -80 } }),
    () => crane.march(past, 0.1, { parameters: { gravity: NaN } }),
    () => crane.invert(),
    () => crane.invert(one, { times: [0, 1] }),
    () => crane.march(one, 0.1),
    () => crane.march(past),
    () => crane.march(past, -0.1),
    () => crane.march(past, 0.1, { start: NaN }),
    () => load(new Response("", { status: 404, statusText: "Not Found" })),
    () => load(new Uint8Array([0, 97, 115, 109, 1, 0, 0, 0])),
  ])
    try { await call(); } catch (error) { refused.push(error.message); }
  const heavy = crane.invert(path, { parameters: { load_mass: 80 } });
  const { outputs, verdicts, solved } = crane.invert(path);
  const stepped = crane.march(past, 0.1);
  return { refused, solved, verdicts: [...verdicts], M_b: [...outputs.M_b], heavy: [...heavy.outputs.M_b],
           stepped: [...stepped.outputs.F] };
}
"""


def javascript(folder: Path) -> tuple[str, str]:
    """Write module, loader and a path beside each other; return two arrays as texts."""
    file = module_file("rotary_crane")
    for each in (file, wasm.loader_beside(file)):
        shutil.copy(each, folder)
    (folder / "asked.mjs").write_text(SCRIPT, encoding="utf-8")
    path = scene_called("rotary_crane").reference
    laid_out = [path.jet(t, 4).reshape(len(t), -1).T.ravel().tolist() for t in times_of_javascript()]
    return json.dumps(laid_out[0]), json.dumps(laid_out[1])


def times_of_javascript() -> tuple[np.ndarray, np.ndarray]:
    return np.linspace(0.0, 20.0, 5001), np.arange(-1, 201)[[1, 0, *range(2, 202)]] * 0.1


def assert_as_in_the_library(found: Mapping[str, Array]) -> None:
    scene = scene_called("rotary_crane")
    exact, heavy = (sc.solve(each, step=0.004)["M_b"] for each in (scene, scene.with_parameters(load_mass=80.0)))
    assert found["solved"] == len(exact)
    assert not any(found["verdicts"])
    np.testing.assert_allclose(found["M_b"], exact, rtol=0.0, atol=1e-12 * np.abs(exact).max())
    np.testing.assert_allclose(found["heavy"], heavy, rtol=0.0, atol=1e-12 * np.abs(heavy).max())
    stepped = sc.solve(scene, sc.Projected(), sc.BackwardEuler(), step=0.1, checks=False)["F"]
    np.testing.assert_allclose(found["stepped"], stepped, rtol=0.0, atol=1e-9 * np.abs(stepped).max())
    assert found["refused"] == [
        "a path has 15 values at each instant, at least at 1: 75014 do not fit",
        "rotary_crane has no parameter mass",
        "load_mass = -80 kg is outside its range [0.001, 1000000000] kg",
        "gravity = NaN m/s2 is outside its range [0.001, 1000] m/s2",
        "a path has 15 values at each instant, at least at 1: undefined do not fit",
        "a path of 1 instants needs as many times, not 2",
        "a path has 15 values at each instant, at least at 2: 15 do not fit",
        "steps are above 0 s, not undefined s from 0 s on",
        "steps are above 0 s, not -0.1 s from 0 s on",
        "steps are above 0 s, not 0.1 s from NaN s on",
        ": 404 Not Found",
        "this module is none of `servocore export --wasm`",
    ]


def in_node(folder: Path, script: str) -> str:
    """Run a module in Node, in a folder; return what it prints."""
    (folder / "main.mjs").write_text(script, encoding="utf-8")
    done = subprocess.run(["node", "main.mjs"], cwd=folder, capture_output=True, text=True, timeout=600, check=True)
    return done.stdout


@needs_zig
@needs_node
def test_a_javascript_engine_gives_the_numbers_of_the_library(tmp_path: Path) -> None:
    path, past = javascript(tmp_path)
    printed = in_node(
        tmp_path,
        'import fs from "node:fs"; import { asked } from "./asked.mjs";\n'
        f"const arrays = [{path}, {past}].map((each) => Float64Array.from(each));\n"
        'console.log(JSON.stringify(await asked(fs.readFileSync("rotary_crane.wasm"), ...arrays)));\n',
    )
    assert_as_in_the_library(json.loads(printed))


@needs_zig
@needs_node
def test_the_script_of_the_page_runs(tmp_path: Path) -> None:
    page = Path(__file__).resolve().parents[1] / "docs" / "howto" / "web-page.md"
    script = page.read_text(encoding="utf-8").split('<script type="module">\n')[1].split("</script>")[0]
    shutil.copy(module_file("rotary_crane"), tmp_path / "crane.wasm")
    shutil.copy(wasm.loader_beside(module_file("rotary_crane")), tmp_path / "crane.mjs")
    printed = in_node(
        tmp_path,
        'import fs from "node:fs";\nglobalThis.fetch = async (name) => new Response(fs.readFileSync(name));\n' + script,
    )
    torque, solved = printed.split()
    crane = scene_called("rotary_crane").parameter_values()
    assert float(torque) == pytest.approx(-80.0 * crane["gravity"] * crane["winch_radius"], rel=1e-15)
    assert solved == "true"


@needs_zig
@needs_node
def test_two_modules_and_paths_of_all_lengths_keep_to_themselves(tmp_path: Path) -> None:
    for name in ("rotary_crane", "elastic_bar"):
        for file in (module_file(name), wasm.loader_beside(module_file(name))):
            shutil.copy(file, tmp_path)
    printed = in_node(
        tmp_path,
        'import fs from "node:fs"; import { load } from "./rotary_crane.mjs";\n'
        'const [one, other] = [fs.readFileSync("rotary_crane.wasm"), fs.readFileSync("elastic_bar.wasm")];\n'
        "const crane = await load(one), again = await load(one), bar = await load(other);\n"
        "const rest = (n) => new Float64Array(15 * n).fill(5, 0, n).fill(-5, 2 * n, 3 * n);\n"
        "const short = crane.invert(rest(1)), kept = short.outputs.M_w[0];\n"
        "const long = crane.invert(rest(1e5)), heavy = again.invert(rest(1), { parameters: { load_mass: 80 } });\n"
        "bar.invert(new Float64Array(bar.about.path.length));\n"
        "console.log(JSON.stringify([kept, short.outputs.M_w[0], ...new Set(long.outputs.M_w), long.solved,\n"
        "  heavy.outputs.M_w[0] / kept, crane.invert(rest(1)).outputs.M_w[0]]));\n",
    )
    kept, *same, solved, ratio, last = json.loads(printed)
    assert {kept, *same, last} == {kept}
    assert len(same) == 2  # the first result, and the only value of the long one
    assert solved == 100_000
    assert ratio == pytest.approx(80.0 / scene_called("rotary_crane").parameter_values()["load_mass"], rel=1e-15)


@needs_zig
@needs_node
def test_the_loader_asks_for_times_where_equations_hold_the_time(tmp_path: Path) -> None:
    sc.export_wasm(scene_called("waves"), tmp_path / "waves.wasm")
    printed = in_node(
        tmp_path,
        'import fs from "node:fs"; import { load } from "./waves.mjs";\n'
        'const waves = await load(fs.readFileSync("waves.wasm")), path = new Float64Array(6);\n'
        "let refused = null; try { waves.invert(path); } catch (error) { refused = error.message; }\n"
        "console.log(JSON.stringify({ refused, F: [...waves.invert(path, { times: [1, 2] }).outputs.F] }));\n",
    )
    found = json.loads(printed)
    assert found["refused"] == "the equations of waves contain the time: times are needed"
    np.testing.assert_allclose(found["F"], -np.sin([1.0, 2.0]), rtol=1e-15)


@needs_zig
@pytest.mark.skipif(not FULL or shutil.which("chromium") is None, reason="make native, with chromium")
def test_a_browser_gives_the_numbers_of_the_library(tmp_path: Path) -> None:
    path, past = javascript(tmp_path)
    (tmp_path / "index.html").write_text(
        '<!doctype html><pre id="found"></pre><script type="module">\n'
        'import { asked } from "./asked.mjs";\n'
        f"const arrays = [{path}, {past}].map((each) => Float64Array.from(each));\n"
        'const found = await asked(fetch("rotary_crane.wasm"), ...arrays);\n'
        'document.getElementById("found").textContent = JSON.stringify(found);\n'
        "</script>",
        encoding="utf-8",
    )
    handler = type("Quiet", (http.server.SimpleHTTPRequestHandler,), {
        "log_message": lambda *_: None,
        "extensions_map": http.server.SimpleHTTPRequestHandler.extensions_map | {".mjs": "text/javascript"},
    })  # fmt: skip
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(handler, directory=tmp_path)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=10000",
                   f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom",
                   f"http://127.0.0.1:{server.server_port}/index.html"]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True)
        server.shutdown()
    assert_as_in_the_library(json.loads(done.stdout.split('id="found">')[1].split("</pre>")[0]))


@needs_zig
def test_the_command_writes_module_and_loader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "cars.wasm, cars.mjs: WebAssembly of cars" in run("export", "cars", "--wasm", "cars.wasm").output
    assert sorted(each.name for each in tmp_path.iterdir()) == ["cars.mjs", "cars.wasm"]


def test_what_cannot_be_a_module_is_refused_with_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run.assert_refused(run("export", "cars", "--wasm", "cars.js"), "the name of a WebAssembly module ends with .wasm")
    monkeypatch.setattr(wasm, "zig", lambda: None)
    run.assert_refused(
        run("export", "cars", "--wasm", "cars.wasm"), "run pip install '.[native]' in a clone of the project"
    )
    assert not any(tmp_path.iterdir())
