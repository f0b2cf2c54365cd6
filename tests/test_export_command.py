"""The command ``servocore export``, and C source that any compiler takes."""

from __future__ import annotations

import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path
from unittest.mock import Mock

import casadi as ca
import numpy as np
import pytest
from command_lines import servocore as run
from command_lines import write
from fmpy import read_csv, read_model_description, simulate_fmu
from native_fmu import exported, inputs_along_path, scene_called

import servocore as sc
from servocore.export import targets
from servocore.export.c_source import export_c
from servocore.export.native_model import identifier_of
from servocore.export.parameter_sets import base_units
from servocore.export.variables import per_time

OWN = """
from dataclasses import replace

import servocore as sc
from test_export_command import one_mass

def hoist():
    return one_mass("bare hoist")

def demanding(what):
    return what


def wrong():
    raise ValueError("no load\\nat all")


def broken():
    return replace(sc.scenes.cars(), models={"points": lambda: 1 / 0})


def unnamed():
    return replace(sc.scenes.cars(), name=" ")
"""


pytestmark = pytest.mark.usefixtures("empty_folder")


@pytest.mark.usefixtures("compiler")
def test_a_function_of_ones_own_becomes_an_fmu_that_is_called_as_its_scene() -> None:
    write("hoists_of_mine.py", OWN)
    write("heavy.toml", "m = 5.0\n")
    result = run(
        "export", "hoists_of_mine:hoist", "-o", "any name.fmu", "--parameters", "heavy.toml", "--targets", "host"
    )
    assert result.exit_code == 0, result.output
    assert result.stdout == "any name.fmu: bare hoist, FMI 3\n"
    packed = zipfile.ZipFile("any name.fmu")
    description = packed.read("modelDescription.xml").decode()
    assert 'modelIdentifier="bare_hoist"' in description
    assert 'start="5.0"' in description
    assert packed.namelist()[0] == "modelDescription.xml"
    assert f"binaries/{targets.host()}/bare_hoist.so" in packed.namelist()


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(
    ("scene", "fmi", "line"),
    [("cars", 2, ""), ("cars", 2, "--from 1 --to 3 --duration 4"), ("rotary_crane", 2, ""), ("rotary_crane", 3, "")],
)
def test_a_run_with_the_cross_check_files_gives_their_results(scene: str, fmi: int, line: str) -> None:
    arguments = ("--fmi", fmi, "--targets", "host", "--cross-check", *line.split())
    result = run("export", scene, "-o", "own.fmu", *arguments)
    assert result.exit_code == 0, result.output
    assert result.stderr.startswith("  certificate: proved: one regular motion at all times from 0 s to")
    signals, wanted = (read_csv(f"own_{kind}.csv") for kind in ("in", "ref"))
    described = read_model_description("own.fmu").modelVariables
    assert set(signals.dtype.names) == {"time", *(each.name for each in described if each.causality == "input")}
    options = dict(line.split(",") for line in Path("own_ref.opt").read_text(encoding="utf-8").splitlines())
    stop, step = float(options["StopTime"]), float(options["StepSize"])
    found = simulate_fmu("own.fmu", stop_time=stop, output_interval=step, input=signals)
    assert len(found) == len(wanted) == 1001
    if line:
        assert list(signals[-1])[:2] == [4.0, pytest.approx(3.0)]
    # The highest derivative is held over a step: a thousandth of the duration, in which inputs change by about as much.
    for name in wanted.dtype.names:
        assert np.abs(found[name] - wanted[name]).max() <= 2e-3 * np.abs(wanted[name]).max()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("cars", "-o", "x.fmu", "--model", "big"), ("cars has no model big", "points")),
        (("cars", "-o", "x.fmu", "--fmi", "2", "--targets", "aarch64-linux"), ("FMI 2 has no platform",)),
        (("cars", "--plant", "-o", "cars"), ("cannot write cars: the name of an FMU ends with .fmu",)),
        ((":scene", "-o", "x.fmu"), (":scene: there is no module ''",)),
        (("mine_too:demanding", "-o", "x.fmu"), ("cannot be called without arguments",)),
        (("mine_too:wrong", "-o", "x.fmu"), ("returns no scene: ValueError: no load at all (mine_too.py, line",)),
        (("mine_too:broken", "-o", "x.fmu"), ("returns no scene: ZeroDivisionError", "(mine_too.py, line")),
        (("mine_too:unnamed", "-o", "x.fmu"), ("a scene needs a name",)),
        (("not_python:scene", "-o", "x.fmu"), ("the module cannot be imported: SyntaxError",)),
        (("cars", "--c", "no/source"), ("there is no folder no",)),
        (("cars", "--c", "source", "--fmi", "4"), ("no export for FMI 4",)),
        (("cars", "--wasm", "x.wasm", "-o", "x.wasm"), ("--output and --wasm both name x.wasm",)),
        (("cars", "--wasm", "x.wasm", "-o", "x.mjs"), ("cannot write x.mjs: the name of an FMU ends with .fmu",)),
        (("cars", "--plant", "--reference", "p.csv", "-o", "x.fmu"), ("--reference belongs to --trajectory",)),
        (("cars", "--plant", "--c", "x"), ("--c is for inverse models: not with --plant",)),
        (("cars", "--plant", "--wasm", "x.wasm"), ("--wasm is for inverse models: not with --plant",)),
        (("cars", "--plant", "-o", "x.fmu", "--tolerance", "1"), ("--tolerance belongs to --reference",)),
        (("cars", "--trajectory"), ("name the file to write with -o",)),
    ],
)
def test_what_cannot_be_exported_is_refused_with_one_sentence_and_no_file(
    arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    for name, text in {"mine_too": OWN, "not_python": "def f(:\n"}.items():
        write(f"{name}.py", text)
    before = set(Path().iterdir())
    run.assert_refused(run("export", *arguments), *words)
    assert {each for each in Path().iterdir() if each.name != "__pycache__"} == before


def test_no_result_is_in_its_place_before_all_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise sc.InvalidSetting("ziglang does not compile cars")

    monkeypatch.setattr("servocore.cli.export.require_module", lambda _: None)
    monkeypatch.setattr("servocore.cli.export.export_wasm", fails)
    before = set(Path().iterdir())
    arguments = ("-o", "cars.fmu", "--targets", "host", "--cross-check", "--c", "source", "--wasm", "cars.wasm")
    run.assert_refused(run("export", "cars", *arguments), "ziglang does not compile cars")
    assert set(Path().iterdir()) == before


def test_unstable_internal_dynamics_are_refused_with_their_rate() -> None:
    arm = scene_called("passive_joint_arm").with_parameters(tracked_distance=1.0)
    with pytest.raises(
        sc.InvalidModel, match=r"internal dynamics grow at .* 1/s \(non-minimum phase\).*solve computes them"
    ):
        sc.export_fmu(arm, "arm.fmu")
    assert not Path("arm.fmu").exists()


def one_mass(name: str = "hoist", **names: str) -> sc.Scene:
    """Return a mass lifted by a force, with names of one's own."""
    called = {"mass": "m", "weight": "G", "force": "F", "height": "y", **names}
    x = sc.Coordinates(sc.Quantity("w", "m"))
    p = sc.Parameters(sc.Parameter(called["mass"], 2.0, "kg", 0.1), sc.Parameter(called["weight"], 20.0, "N"))

    def model() -> sc.MechanicalSystem:
        return sc.MechanicalSystem(
            name="hoist", coordinates=x, parameters=p, inputs=(sc.Quantity(called["force"], "N", "*/ \n upwards"),),
            outputs=(sc.Quantity(called["height"], "m"),), mass=ca.SX(p[called["mass"]]), output=x.q,
            input_matrix=ca.SX(-1), potential=p[called["weight"]] * x.q,
        )  # fmt: skip

    return sc.Scene(name=name, models={"only": model}, reference=sc.rest_to_rest((1.0,), (2.0,), 1.0))


@pytest.mark.parametrize(
    ("name", "identifier"),
    [
        ("rotary_crane", "rotary_crane"),
        ('Kran "Größe" <1> & 100% */ \n x', "Kran_Gr_e_1_100_x"),
        ("_a__b_", "a_b"),
        ("../etc", "etc"),
        ("3 cars", "model_3_cars"),
        ("main", "model_main"),
        ("Test", "model_Test"),
        ("", "model"),
        ("ö", "model"),
        ("x" * 100, "x" * 40),
    ],
)
def test_any_name_of_a_scene_has_an_identifier(name: str, identifier: str) -> None:
    assert identifier_of(name) == identifier


def test_names_that_only_c_would_confuse_are_told_apart(compiler: list[str]) -> None:
    export_c(one_mass('Kran */ "1"\n', mass="M", weight="m", force="path", height="outputs"), "source")
    options = ["-std=c99", "-Wall", "-Werror", "-Wno-unused-function"]
    build = [*compiler, *options, "Kran_1.c", "main.c", "-o", "example", "-lm"]
    subprocess.run(build, cwd="source", check=True)
    alone = subprocess.run(["source/example"], input="", capture_output=True, text=True, check=True)
    assert alone.stdout == "0,20\n"


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: one_mass(force="φ"), "FMI has no variable called 'φ'; names are the letters a to z"),
        (lambda: one_mass(mass="internal_step"), "variables named twice: internal_step"),
        (lambda: sc.scenes.rotary_crane().with_limits(phi=1.0), "its limit of phi: .* an angle that counts full turns"),
        (lambda: one_mass().with_limits(**{"F.rate": 1.0}), "its limit of F.rate: .* the rate of a force"),
    ],
)
def test_what_an_fmu_cannot_say_or_keep_is_refused(make: Callable[[], sc.Scene], sentence: str) -> None:
    scene = make()
    with pytest.raises(sc.InvalidModel, match=f"{scene.name} cannot be exported.*{sentence}"):
        sc.export_fmu(scene, "x.fmu", targets="host")
    assert not Path("x.fmu").exists()


@pytest.mark.usefixtures("compiler")
def test_a_rate_that_is_none_at_rest_breaks_no_limit() -> None:
    swinging = sc.scenes.gantry_crane().with_limits(**{"swing.rate": 0.5})  # of the length of a vector, which is zero
    sc.export_fmu(swinging, "crane.fmu", targets="host")
    assert len(simulate_fmu("crane.fmu", stop_time=0.3, output_interval=0.1)) == 4


def test_the_command_names_what_it_has_written_and_nothing_else() -> None:
    told = run("export", "cars", "--c", "source", "--no-certify")
    assert (told.exit_code, told.stdout) == (0, "source: C source of cars\n")


def test_c_source_does_not_write_over_files_of_others() -> None:
    write("CMakeLists.txt", "project(mine)")
    run.assert_refused(run("export", "cars", "--c", "."), "cannot write to .", "its CMakeLists.txt would be lost")
    assert Path("CMakeLists.txt").read_text(encoding="utf-8") == "project(mine)"
    export_c(scene_called("cars"), "source")
    export_c(scene_called("cars"), "source")  # its own


def test_c_source_that_cannot_be_written_leaves_nothing_half_written(monkeypatch: pytest.MonkeyPatch) -> None:
    cars = scene_called("cars")
    with pytest.raises(sc.InvalidSetting, match="cannot write no/source: there is no folder no; make it first"):
        export_c(cars, "no/source")
    rename = Path.replace

    def interrupted(part: Path, place: Path) -> Path:
        if place.name == "main.c":
            raise KeyboardInterrupt
        return rename(part, place)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", interrupted)
        with pytest.raises(KeyboardInterrupt):
            export_c(cars, "source")
    assert list(Path().iterdir()) == []
    Path("source/main.c").mkdir(parents=True)
    write("source/cars.h", "old")
    with pytest.raises(sc.InvalidSetting, match=r"cannot write source/main.c: Is a directory; name another place"):
        export_c(cars, "source")
    assert sorted(each.name for each in Path("source").iterdir()) == ["cars.h", "main.c"]
    assert Path("source/cars.h").read_text(encoding="utf-8") == "old"


@pytest.mark.parametrize("command", ["export cars --c x", "ssp cars -o x.ssp"])
def test_a_proof_that_is_stopped_leaves_no_file(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("servocore.certificate.certify.certify", Mock(side_effect=KeyboardInterrupt))
    assert run(*command.split()).exit_code == 130
    assert list(Path().iterdir()) == []


def test_without_a_compiler_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(targets, "zig", lambda: None)
    run.assert_refused(run("export", "cars", "-o", "x.fmu"), "needs a C compiler")
    run.assert_refused(
        run("export", "cars", "-o", "x.fmu", "--targets", "all"),
        "needs the package ziglang",
        "run pip install '.[native]' in a clone",
    )
    assert list(Path().iterdir()) == []


def test_a_compiler_that_fails_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "false")
    monkeypatch.setattr(targets, "zig", lambda: None)
    run.assert_refused(run("export", "cars", "-o", "x.fmu"), "false does not compile the FMU for")
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize("name", ["overhead_crane", "mass_on_car", "wind"])
def test_c_source_computes_the_same(name: str, compiler: list[str]) -> None:
    steps = 40
    scene, orders = scene_called(name), exported(name).own["orders"]
    export_c(scene, "source")
    command = [*compiler, "-std=c99", "-O1", "-Wall", "-Werror", "-Wno-unused-function", "-ffp-contract=off"]
    subprocess.run([*command, f"{name}.c", "main.c", "-o", "example", "-lm"], cwd="source", check=True)
    t = np.linspace(0.0, scene.reference.duration, steps + 1)
    rows = np.column_stack([t, scene.reference.jet(t, orders - 1).reshape(steps + 1, -1)])
    text = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    printed = subprocess.run(["source/example"], input=text, capture_output=True, text=True, check=True).stdout
    found = np.array([line.split(",") for line in printed.splitlines()], dtype=float)
    expected = inputs_along_path(name, steps)
    assert (found[:, 0] == t).all()
    assert np.abs(found[:, 1 : 1 + expected.shape[1]] - expected).max() <= 1e-12 * np.abs(expected).max()
    Path("source/size.c").write_text(
        f'#include <stdio.h>\n#include "{name}.h"\nint main(void) {{ printf("%zu", sizeof({name}_memory)); }}'
    )
    subprocess.run([*compiler, "size.c", "-o", "size"], cwd="source", check=True)
    size = subprocess.run(["source/size"], capture_output=True, text=True, check=True).stdout
    page = Path("source/README.md").read_text(encoding="utf-8")
    assert f"({size} bytes where pointers have eight)" in page
    assert "at most 30 for each block" in page
    assert "| stack | at most " in page


@pytest.mark.parametrize(
    ("unit", "order", "expected", "exponents"),
    [
        ("m", 0, "m", {"m": 1}),
        ("m", 2, "m/s2", {"m": 1, "s": -2}),
        ("m/s", 1, "m/s2", {"m": 1, "s": -2}),
        ("rad", 1, "rad/s", {"rad": 1, "s": -1}),
        ("N/m", 1, "N/m.s", {"kg": 1, "s": -3}),
        ("N.m", 3, "N.m/s3", {"kg": 1, "m": 2, "s": -5}),
        ("furlong", 1, "furlong/s", None),
    ],
)
def test_units_of_derivatives(unit: str, order: int, expected: str, exponents: dict[str, int] | None) -> None:
    assert per_time(unit, order) == expected
    assert base_units(expected) == exponents


def test_derived_units_are_their_products_and_quotients() -> None:
    assert all(base_units(each) == {each: 1} for each in ("m", "s", "kg", "rad", "A", "K", "mol", "cd"))
    derived = {"N": "kg.m/s2", "J": "N.m", "W": "J/s", "Pa": "N/m2", "V": "W/A", "Hz": "1/s"}
    assert {each: base_units(each) for each in derived} == {each: base_units(of) for each, of in derived.items()}


def test_a_universal_library_holds_each_slice_on_a_page_of_its_own() -> None:
    header = b"\xcf\xfa\xed\xfe" + (0x01000007).to_bytes(4, "little") + (3).to_bytes(4, "little")
    slices = [header + bytes(100), header.replace(b"\x07", b"\x0c") + b"x" * 20000]
    whole = targets.universal([targets.Library(each, None) for each in slices]).content
    assert whole[:8] == b"\xca\xfe\xba\xbe\0\0\0\x02"
    for k, each in enumerate(slices):
        processor, kind, offset, size, alignment = (
            int.from_bytes(whole[8 + 20 * k + 4 * i : 12 + 20 * k + 4 * i], "big") for i in range(5)
        )
        assert (processor, kind) == ((0x01000007, 0x0100000C)[k], 3)
        assert alignment == 14
        assert offset % (1 << 14) == 0
        assert whole[offset : offset + size] == each
