"""What the standards ask of exported FMUs beyond their schemas: sources, descriptions, systems."""

from __future__ import annotations

import ctypes
import io
import re
import shutil
import subprocess
import zipfile
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from command_lines import servocore as run
from fmpy import read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.ssp.ssd import read_ssd
from fmu_host import ERROR, Host, extracted, members
from native_fmu import FULL, VENDOR, Native, exported, native_file, path_of, put_vendor
from present import present
from test_moving_starts import rows

import servocore as sc
from crane_fmu.build.estimates import estimates_of
from crane_fmu.build.native import feedback_of
from crane_fmu.files import put
from crane_fmu.run import run_ssp
from servocore.export import targets
from servocore.export.c_source import c_files
from servocore.export.native_model import HostRules
from servocore.export.sources import compiled_files, fmu_sources
from servocore.export.system import Element, packed_system, wires_by_name

pytestmark = pytest.mark.usefixtures("compiler")

STRICT = ("-Wall", "-Wextra", "-pedantic", "-Werror")

# Sources -------------------------------------------------------------------------------------------------------------

PROBE = """
#include "model.h"
#define FMI2_FUNCTION_PREFIX FUNCTION_PREFIX
#define FMI3_FUNCTION_PREFIX FUNCTION_PREFIX
#if FMI == 2
#include "fmi2Functions.h"
static void logger(fmi2ComponentEnvironment e, fmi2String i, fmi2Status s, fmi2String c, fmi2String m, ...) {}
double PROBE(void)
{
    const fmi2CallbackFunctions host = {logger, 0, 0, 0, 0};
    const fmi2ValueReference output = N_INPUTS;
    double found = NAN;
    fmi2Component c = fmi2Instantiate("probe", fmi2CoSimulation, INSTANTIATION_TOKEN, "", &host, 0, 0);
    if (c == NULL || fmi2EnterInitializationMode(c) || fmi2ExitInitializationMode(c) || fmi2DoStep(c, 0.0, 0.1, 1)
        || fmi2GetReal(c, &output, 1, &found)) return NAN;
    fmi2FreeInstance(c);
    return found;
}
#else
#include "fmi3Functions.h"
double PROBE(void)
{
    double found[16] = {NAN}, last;
    fmi3Boolean event, end, early;
    fmi3ValueReference output = 0;
    fmi3Instance c = fmi3InstantiateCoSimulation("probe", INSTANTIATION_TOKEN, "", 0, 0, 0, 0, 0, 0, 0, 0, 0);
    while (ARRAYS[output].first < N_INPUTS) output++;
    if (c == NULL || fmi3EnterInitializationMode(c, 0, 0.0, 0.0, 0, 0.0) || fmi3ExitInitializationMode(c)
        || fmi3DoStep(c, 0.0, 0.1, 1, &event, &end, &early, &last)
        || fmi3GetFloat64(c, &output, 1, found, ARRAYS[output].size)) return NAN;
    fmi3FreeInstance(c);
    return found[0];
}
#endif
"""
TEN = ("cars", "mass_on_car", "overhead_crane", "elastic_hoist", "rotary_crane trajectory", "cars plant",
       *(f"{name} trajectory" for name in ("cars", "mass_on_car", "overhead_crane", "gantry_crane")))  # fmt: skip


@pytest.mark.parametrize(("names", "fmi"), [(TEN[:2], 2), (TEN[:2], 3), (TEN, 2)])
def test_models_are_linked_into_one_program(
    names: tuple[str, ...], fmi: int, compiler: list[str], tmp_path: Path
) -> None:
    """FMI 2.0.5, 2.1.1: functions of sources begin with the model identifier, by the official headers."""
    if len(names) > 2 and not FULL:
        names = names[:2] + names[-4:]
    objects, probes = [], [f"probe_{k}" for k in range(len(names))]
    for name, probe in zip(names, probes, strict=True):
        folder = tmp_path / probe
        put(folder, fmu_sources(exported(name), fmi) | {"probe.c": PROBE})
        for file in (*compiled_files(exported(name), fmi), "probe.c"):
            objects.append(folder / Path(file).with_suffix(".o"))
            made = [f"-DFMI={fmi}", f"-DPROBE={probe}", "-c", file, "-o", objects[-1].name]
            subprocess.run([*compiler, "-std=c99", "-O0", "-w", *made], cwd=folder, check=True)
    calls = "".join(f'printf("%.17g\\n", {each}());' for each in probes)
    declared = "".join(f"double {each}(void);" for each in probes)
    (tmp_path / "main.c").write_text(f"#include <stdio.h>\n{declared}\nint main(void) {{ {calls} return 0; }}\n")
    subprocess.run([*compiler, tmp_path / "main.c", *objects, "-o", tmp_path / "all", "-lm"], check=True)
    printed = subprocess.run([tmp_path / "all"], capture_output=True, text=True, check=True).stdout.split()
    for name, found in zip(names, printed, strict=True):
        with Native(name, fmi) as host:
            assert host.start().step(0.0, 0.1)
            assert float(found) == pytest.approx(host.values()[0], rel=1e-12, abs=1e-12)
        assert np.isfinite(float(found))


# Start values --------------------------------------------------------------------------------------------------------

CRANE = sc.scenes.rotary_crane()


@pytest.mark.parametrize(
    ("start", "sentence"),
    [
        ({"load_mass": -5.0}, r"load_mass = -5 kg is outside its range \[0.001, 1e\+09\] kg"),
        ({"load.position[2]": np.nan}, r"load.position\[2\] = nan m is not a finite number"),
        ({"gravity": "earth"}, "gravity = 'earth' m/s2 is not a finite number"),
        ({"load_mas": 5.0}, "rotary_crane has no input or parameter 'load_mas' to start with; there are load.position"),
        ({"M_b": 5.0}, "no input or parameter 'M_b'"),
        ({"input_time": "middle"}, "input_time = 'middle' is unknown; it may be start, end"),
    ],
)
def test_start_values_that_an_fmu_would_refuse_are_refused_by_the_export(
    start: dict[str, float | str], sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(sc.InvalidSetting, match=sentence):
        sc.export_fmu(CRANE, tmp_path / "crane.fmu", start=start, targets="none")
    assert not list(tmp_path.iterdir())


def test_an_export_has_the_feedback_the_estimates_and_the_routes_that_it_is_given(tmp_path: Path) -> None:
    forms: dict[str, sc.Formulation] = {"reduced": sc.Reduced(), "projected": sc.Projected()}
    given: dict[str, Any] = {
        "feedback": feedback_of(CRANE),
        "estimates": estimates_of(CRANE),
        "routes": sc.SteppedRoutes(("points",), forms, sc.BackwardEuler()),
    }
    file = sc.export_fmu(CRANE, tmp_path / "crane.fmu", fmi=2, targets="none", **given)
    names = {each.name for each in read_model_description(file).modelVariables}
    assert names >= {"feedback", "measured.l", "connected", "model", "formulation"}
    with pytest.raises(sc.InvalidModel, match=r"its inputs are stepped, or limited$"):
        sc.export_fmu(CRANE.with_limits(F=1e6), tmp_path / "limited.fmu", targets="none", routes=given["routes"])


def test_start_values_of_numbers_and_choices_are_those_of_the_fmu(tmp_path: Path) -> None:
    """Also where a host cannot set enumerations."""
    options = sc.PlantOptions(start={"wind[2]": 3.0, "hold": "zero_order"})
    made = [
        sc.export_fmu(CRANE, tmp_path / "a.fmu", start={"load_mass": 140.0, "input_time": "end"}, targets="none"),
        sc.export_plant(CRANE, tmp_path / "b.fmu", options, targets="none"),
        sc.export_trajectory(
            CRANE, tmp_path / "c.fmu", sc.TrajectoryOptions(start={"duration": 9.0}, profile="degree13"), targets="none"
        ),
    ]
    found = [{each.name: each.start for each in read_model_description(str(file)).modelVariables} for file in made]
    assert (found[0]["load_mass"], found[0]["input_time"]) == ("140.0", "2")
    assert (found[1]["wind"], found[1]["hold"]) == ("0.0 3.0 0.0", "2")
    assert (found[2]["duration"], found[2]["profile"]) == ("9.0", "2")
    with pytest.raises(sc.InvalidSetting, match="duration = -1 s is outside its range"):
        sc.export_trajectory(CRANE, tmp_path / "c.fmu", sc.TrajectoryOptions(start={"duration": -1.0}), targets="none")
    with pytest.raises(sc.InvalidSetting, match="no input or parameter 'winds'"):
        sc.export_plant(CRANE, tmp_path / "b.fmu", sc.PlantOptions(start={"winds": 1.0}), targets="none")
    with pytest.raises(sc.InvalidModel, match="rotary_crane has no coordinate sway"):
        sc.export_plant(CRANE, tmp_path / "b.fmu", sc.PlantOptions(offsets={"start.sway": ("sway",)}), targets="none")


# Systems -------------------------------------------------------------------------------------------------------------


def crane_elements() -> list[Element]:
    kinds = ("trajectory", "loop", "plant")
    return [Element(kind, kind, native_file(f"rotary_crane {kind}", 2).read_bytes()) for kind in kinds]


def test_a_system_is_valid_and_declares_its_units(tmp_path: Path) -> None:
    """SSP 1.0, 5.1.3: the name of a unit must match a Unit entry of the top element; schemas do not see it."""
    elements = crane_elements()
    (tmp_path / "system.ssp").write_bytes(packed_system("system", elements, wires_by_name(elements), 20.0))
    read_ssd(str(tmp_path / "system.ssp"))  # against the schema
    root = ET.fromstring(members(tmp_path / "system.ssp")["SystemStructure.ssd"])
    names = [unit.attrib["name"] for unit in root.iter("{http://ssp-standard.org/SSP1/SystemStructureCommon}Unit")]
    used = {real.attrib["unit"] for real in root.iter("{http://ssp-standard.org/SSP1/SystemStructureCommon}Real")}
    assert used <= set(names)
    assert len(names) == len(set(names))


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", ["rotary_crane loop", "rotary_crane", "mass_on_car", "cars plant"])
def test_outputs_list_the_inputs_of_their_derivatives_and_no_others(name: str, fmi: int) -> None:
    """No declared feedthrough where setting an input changes no output; those with derivatives list their inputs."""
    description = read_model_description(str(native_file(name, fmi)))
    offers = b"providesDirectionalDerivative" in members(native_file(name, fmi))["modelDescription.xml"]
    assert offers == (name != "rotary_crane loop")  # feedback has no derivatives
    assert any(each.dependencies for each in description.outputs) == offers
    with Native(name, fmi) as host:
        assert host.start().step(0.0, 0.01)
        before, told = host.values(), host.get(*host.inputs) + 1e-3
        host.tell(told)
        assert (host.values() == before).all()


def test_the_system_with_feedback_declares_no_algebraic_loop() -> None:
    elements = crane_elements()
    wires = [*wires_by_name(elements), (("plant", "phi"), ("loop", "measured.phi"))]
    edges: dict[tuple[str, str], set[tuple[str, str]]] = {}
    for source, sink in wires:
        edges.setdefault(source, set()).add(sink)
    for element in elements:
        for output in read_model_description(io.BytesIO(element.fmu)).outputs:
            for each in output.dependencies or ():
                edges.setdefault((element.name, each.name), set()).add((element.name, output.variable.name))
    reached = {node: set(after) for node, after in edges.items()}
    for _ in reached:
        for after in reached.values():
            after |= {end for node in list(after) for end in edges.get(node, ())}
    assert not [node for node, after in reached.items() if node in after]


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.usefixtures("empty_folder")
def test_related_files_are_in_the_fmu_with_their_roles(fmi: int) -> None:
    """FMI-LS-REF: a parameter set as SSV, a run as smoke test, and its results."""
    line = ("export", "overhead_crane", "-o", "x.fmu", "--fmi", fmi, "--targets", "none", "--cross-check")
    assert run(*line).exit_code == 0
    folder = "extra/org.fmi-standard.fmi-ls-ref/"
    found = {name.removeprefix(folder): each for name, each in members("x.fmu").items() if folder in name}
    root = ET.fromstring(found.pop("fmi-ls-manifest.xml"))
    assert {"org.fmi-standard.fmi-ls-ref", "1.0.0-alpha.1"} <= set(root.attrib.values())
    roles = {each.attrib["source"]: each.attrib["role"] for each in root}
    assert roles == {"parameters.ssv": "parameter", "x_in.csv": "experiment/smoke-test", "x_ref.csv": "result",
                     "x_ref.opt": "configuration"}  # fmt: skip
    assert set(found) == set(roles)
    for name in set(roles) - {"parameters.ssv"}:
        assert found[name] == Path(name).read_bytes()
    parameters = ET.fromstring(found["parameters.ssv"])
    assert parameters.get("version") == {2: "1.0", 3: "2.0"}[fmi]
    values = {each.attrib["name"]: each[0].attrib for each in parameters.iter() if each.tag.endswith("}Parameter")}
    assert {
        name: float(each["value"]) for name, each in values.items()
    } == sc.scenes.overhead_crane().parameter_values()
    declared = {each.get("name") for each in parameters.iter() if each.tag.endswith("}Unit")}
    assert {each["unit"] for each in values.values()} == declared


def test_a_system_of_fmi_3_has_arrays_and_moves_as_that_of_fmi_2(tmp_path: Path) -> None:
    """SSP 2.0, in a master of twenty lines; parameters of the scene are one set for inverse model and plant."""
    scene, files = sc.scenes.overhead_crane(), {}
    for fmi in (2, 3):
        files[fmi] = sc.export_ssp(scene, tmp_path / f"{fmi}.ssp", fmi=fmi, targets="host")
        with zipfile.ZipFile(files[fmi]) as archive:
            archive.extractall(tmp_path / str(fmi))
            root = ET.fromstring(archive.read("SystemStructure.ssd"))
        assert root.get("version") == {2: "1.0", 3: "2.0"}[fmi]
        bindings = {part.get("name"): [each.get("source") for each in part.iter() if each.get("source")][1:]
                    for part in root.iter() if part.tag.endswith("}Component")}  # fmt: skip
        assert bindings == {"trajectory": [], **{name: ["resources/parameters.ssv", f"resources/{name}.ssm"]
                                                 for name in ("inverse", "plant")}}  # fmt: skip
        for name in ("inverse", "plant"):
            mapping = ET.parse(tmp_path / str(fmi) / f"resources/{name}.ssm").getroot()
            assert {each.get("target") for each in mapping} == set(scene.parameter_values())
    assert {each[1].get("size") for each in root.iter() if each.tag.endswith("}Connector") and len(each) > 1} == {"2"}
    wires = [each.attrib for each in root.iter() if each.tag.endswith("}Connection")]
    h, names = 0.01, ("trajectory", "inverse", "plant")
    sources = ("overhead_crane_trajectory", "overhead_crane", "overhead_crane_plant")
    expected = run_ssp(files[2], 2.0, h)
    with ExitStack() as running:
        hosts = {name: running.enter_context(Host(tmp_path / "3" / "resources" / f"{file}.fmu"))
                 for name, file in zip(names, sources, strict=True)}  # fmt: skip
        for host in hosts.values():
            host.start()
        for k in range(200):  # all exchange values, then all step, as in FMPy
            signals = [(each, hosts[each["startElement"]].get(each["startConnector"])) for each in wires]
            for each, values in signals:
                hosts[each["endElement"]].numbers_set([each["endConnector"]], values)
            assert all(host.step(k * h, h) for host in hosts.values())
        found = hosts["plant"].get("load.position")
    last = [expected[f"plant.load.position[{k}]"][199] for k in (1, 2)]  # rows show the ends of steps
    np.testing.assert_allclose(found, last, atol=1e-12 * np.abs(last).max())


# About ---------------------------------------------------------------------------------------------------------------


@pytest.fixture
def vendor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run the test in a folder with a vendor's files, and return it."""
    monkeypatch.chdir(tmp_path)
    put_vendor(tmp_path)
    return tmp_path


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("kind", "default"), [((), "input_time"), (("--plant",), "hold"), (("--trajectory",), "profile")]
)
def test_a_vendor_s_words_stand_in_description_sources_and_documentation(
    kind: tuple[str, ...], default: str, fmi: int, vendor: Path
) -> None:
    (vendor / "vendor.toml").write_text(VENDOR + f'{default} = "{LAST[default]}"\n')
    line = ("export", "mass_on_car", *kind, "-o", "x.fmu", "--fmi", fmi, "--targets", "none", "--about", "vendor.toml")
    assert run(*line).exit_code == 0
    found = members("x.fmu")
    root = ET.fromstring(found["modelDescription.xml"])
    wanted = {"version": "4.2", "author": "Jane Doe, ACME & Sons", "license": "proprietary",
              "copyright": "Copyright 2026 ACME */", "description": "A <component>"}  # fmt: skip
    assert {name: root.get(name) for name in wanted} == wanted
    assert str(root.get("generationTool")).startswith("servocore ")
    assert root.get("generationDateAndTime")
    assert [(each.get("name"), each.get("value")) for each in root.iter("Entry")] == [("order", "17"), ("line", "3")]
    described = read_model_description("x.fmu", validate=True)  # against the schemas of FMI
    assert [each.start for each in described.modelVariables if each.name == default] != ["1"]
    ours = [text for name, text in found.items() if name.startswith("sources/") and "fmi/" not in name
            and name.endswith((".c", ".h")) and not re.search(r"fmi[23][A-Z]", name)]  # fmt: skip
    assert all(text.startswith(b"/* Copyright 2026 ACME * /. Licence: proprietary.") for text in ours)
    assert len(ours) > 4
    assert found["documentation/index.html"] == b"<html>ACME</html>"
    assert b"mass_on_car" in found["documentation/model.html"]
    assert found["documentation/licenses/license.txt"] == b"All rights reserved."
    assert found["model.png" if fmi == 2 else "terminalsAndIcons/icon.png"] == b"\x89PNG and so on"


LAST = {"input_time": "end", "hold": "zero_order", "profile": "degree13"}


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("licence = 'MIT'", "there is no key 'licence'; there are version, author, company, license"),
        ("version = 3", "version must be a text, not 3"),
        ('description = "crane\\u000b7"', "XML files cannot hold the character '\\x0b', which stands in"),
        ("icon = 'none.png'", "icon none.png cannot be read: No such file or directory"),
        ("icon = 'terms.txt'", "icon = 'terms.txt' must end with .png or .svg"),
        ("icon = 'page.png'", "page.png is no PNG picture"),
        ("icon = 'icon.svg'", "FMI 2 has PNG icons only"),
        ("annotations = 3", "annotations are a table for each tool"),
        ("[defaults]\ninput_time = 'middle'", "input_time = 'middle' is unknown; it may be start, end"),
        ("[defaults]\nthe_time = 'end'", "no input or parameter 'the_time'"),
    ],
)
def test_what_a_vendor_cannot_say_is_refused(text: str, sentence: str, vendor: Path) -> None:
    for name in ("page.png", "icon.svg"):
        (vendor / name).write_text("<svg/>")
    (vendor / "vendor.toml").write_text(text)
    line = ("export", "cars", "-o", "x.fmu", "--fmi", "2", "--targets", "none", "--about", "vendor.toml")
    run.assert_refused(run(*line), sentence)
    assert not (vendor / "x.fmu").exists()


@pytest.mark.parametrize(("name", "fmi"), [("rotary_crane", 2), ("rotary_crane plant", 3)])
def test_without_a_vendor_the_project_s_own_words_stand(name: str, fmi: int) -> None:
    found = members(native_file(name, fmi))
    root = ET.fromstring(found["modelDescription.xml"])
    assert found["sources/instance.h"].startswith(b"/* Copyright (c) 2026 the servocore authors. Licence: MIT.")
    assert (root.get("author"), root.get("license")) == ("The authors of servocore", "MIT")
    assert str(root.get("version")) in str(root.get("generationTool"))


# Warnings of compilers -----------------------------------------------------------------------------------------------

MODELS = [
    "mass_on_car",
    "rotary_crane plant",
    "rotary_crane trajectory",
    *(["rotary_crane loop", "limited"] if FULL else []),
]
LANGUAGES = {"C99": ("-std=c99",), "C11": ("-std=c11",), "C++17": ("-x", "c++", "-std=c++17")}


def command_of(tool: str) -> list[str]:
    """Return the command of gcc, or of clang, which is zig's. To clang, numbers as conditions, which CasADi writes, are
    conversions of floats to integers: the one exception."""
    if tool == "gcc":
        return ["g++", "-Wconversion"] if shutil.which("g++") else pytest.skip("needs g++")
    options = ("-Wconversion", "-Wno-float-conversion", "-Wno-deprecated")
    return [*zig, "c++", *options] if (zig := targets.zig()) else pytest.skip("needs ziglang")


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize(
    ("name", "tool"),
    [*((name, "gcc") for name in MODELS), *((name, "clang") for name in MODELS[: None if FULL else 1])],
)
def test_compilers_have_nothing_to_say_about_sources(name: str, tool: str, language: str, tmp_path: Path) -> None:
    words = [*command_of(tool), *(("-x", "c") if language != "C++17" else ()), *LANGUAGES[language], *STRICT]
    for what in (2, 3, "c"):
        if what == "c" and " " in name:
            continue
        model, folder = exported(name), tmp_path / str(what)
        sources = c_files(model) if what == "c" else fmu_sources(model, int(what))
        put(folder, sources)
        for file in (file for file in sources if file.endswith(".c")):
            # some warnings come with optimizations only, and zig's clang always writes an object
            optimized = "mathematics" not in file and (FULL or (tool, language) == ("gcc", "C99"))
            made = ("-O2" if optimized else "-O0", "-c", "-o", "object.o")
            amount = made if optimized or tool == "clang" else ("-fsyntax-only",)
            done = subprocess.run([*words, *amount, file], cwd=folder, capture_output=True, text=True, check=False)
            assert not done.returncode, done.stderr
            assert not done.stderr


def test_a_state_with_a_count_of_steps_that_would_overflow_is_refused() -> None:
    with Native("cars", 2) as host:
        assert host.start().step(0.0, 0.1)
        state, after = host.saved(), []
        for value in (1, 2**63 - 1, -1):
            (place,) = [k for k in range(0, 80, 8) if state[k : k + 8] == (1).to_bytes(8, "little") and k > 8 * 3]
            after.append(state[:place] + value.to_bytes(8, "little", signed=True) + state[place + 8 :])
        host.restore(after[0])
        for wrong in after[1:]:
            with pytest.raises(FMICallException):
                host.restore(wrong)


# Descriptions and pages ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", ["rotary_crane trajectory", "mass_on_car"])
def test_outputs_depend_on_choices_at_the_start(name: str, fmi: int) -> None:
    description = read_model_description(str(native_file(name, fmi)))
    choices = {each.name for each in description.modelVariables if each.type == "Enumeration"}
    for unknown in description.initialUnknowns:
        assert choices <= {each.name for each in unknown.dependencies}


@pytest.mark.parametrize("name", ["rotary_crane plant", "mass_on_car"])
def test_the_page_tells_ranges_and_what_may_change(name: str) -> None:
    page = members(native_file(name, 2))["documentation/index.html"].decode()
    rows = {row.split("</td>")[0].removeprefix("<td>"): row for row in page.split("<tr>") if row.startswith("<td>")}
    for each in exported(name).of("parameter"):
        row = rows[each.name + (f"[{each.size}]" if each.size else "")]
        assert f"<td>{'fixed' if each.fixed else 'tunable'} parameter</td>" in row
        assert f"{each.low:g} to {each.high:g}" in row or not np.isfinite([each.low, each.high]).all()
    assert "Parameters may be changed at any time" not in page


def rows_of_libraries(file: Path) -> dict[str, list[str]]:
    """Return stack and size by the library, as the page of an FMU tells them."""
    packed = members(file)
    page = packed["documentation/index.html"].decode()
    rows = dict(re.findall(r"<tr><td>(binaries/[^<]+)</td>(.*?)</tr>", page, re.DOTALL))
    assert set(rows) == {name for name in packed if name.startswith("binaries/")}
    found = {name: re.findall("<td>(.*?)</td>", row) for name, row in rows.items()}
    assert all(each[1] == f"{len(packed[name])} bytes" for name, each in found.items())
    return found


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", ["rotary_crane trajectory", "mass_on_car", "mass_on_car plant"])
def test_the_page_tells_the_stack_and_the_size_of_the_libraries(name: str, fmi: int) -> None:
    ((stack, _),) = rows_of_libraries(native_file(name, fmi)).values()
    told = re.fullmatch("at most ([0-9]+) bytes", stack)
    assert told
    assert int(told[1]) > 512  # the message of a refusal alone


def test_the_page_says_where_a_compiler_reports_no_stack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SERVOCORE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("servocore.export.targets._FRAMES", ())
    for _ in "compiled", "from the cache":
        file = sc.export_trajectory(sc.scenes.cars(), tmp_path / "x.fmu", targets="host")
        assert [each[0] for each in rows_of_libraries(file).values()] == ["not reported by the compiler"]


def test_rates_of_internal_states_are_described_as_rates() -> None:
    texts = {each.name: each.description for each in exported("mass_on_car").variables}
    assert texts["internal.s.velocity"].startswith("velocity of s")
    assert texts["start.s.velocity"].startswith("added to the velocity of s")


@pytest.mark.parametrize("fmi", [2, 3])
def test_outputs_read_before_the_initialization_are_those_of_its_time(fmi: int) -> None:
    """Read before the start, and in the initialization, of a run that does not begin at zero."""
    name = "rotary_crane trajectory"
    path = present(path_of("rotary_crane"))
    with Native(name, fmi) as host:
        host.values()
        host.start(time=7.0)
        np.testing.assert_allclose(host.values(), path.jet(7.0, 4).ravel(), atol=1e-9)


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_trajectory_begins_new_motions_where_it_rests(fmi: int) -> None:
    """Three lines without a reset, each that of the library; while the path moves, a new one is refused."""
    h, moves = 0.01, [  # target, start time, duration, profile: set at 0, 3 and 6 s
        (1.0, 0.5, 2.0, "degree9"), (-0.5, 1.0, 1.5, "three-phase"), (0.25, 7.0, 2.0, "degree13")
    ]  # fmt: skip
    found, wanted, place = [], [], 0.0
    with Native("cars trajectory", fmi) as host:
        for k, (end, begin, duration, law) in enumerate(moves):
            host.set(profile=law, duration=duration, start_time=begin, trigger=-k, **{"end.y": end})
            if k == 0:
                host.set(**{"start.y": place}).start()
            times = h * np.arange(300 * k, 300 * (k + 1))
            at = max(begin, times[0])  # at once where the time has passed
            line = sc.rest_to_rest((place,), (end,), duration, sc.TIME_LAWS[law], start_time=at)
            for time in times:
                if time == times[120]:
                    saved = host.saved()
                    assert not host.set(trigger=7.0).step(time, h)
                    sentence = (
                        f"at t = {time:g} s a new motion cannot begin: the present one ends at t = {line.end_time:g} s"
                    )
                    assert host.messages[-1] == sentence
                    host.restore(saved)
                assert host.step(time, h), host.messages
                found.append(host.values())
            wanted.append(line.jet(times + h, 4)[:, :, 0])
            place = end
    np.testing.assert_allclose(found, np.concatenate(wanted), atol=1e-9 * np.abs(wanted).max())


# Hosts without an operating system ------------------------------------------------------------------------------------

MATHEMATICS = "fabs fmax fmin floor ceil fmod sqrt sin cos tan asin acos atan atan2 exp log pow sinh cosh tanh hypot"
MEMORY = "memcpy memset memmove strlen strcmp strcpy strcat strchr strspn calloc free"
PLAIN = {*MATHEMATICS.split(), *MEMORY.split(), "copysign", "_GLOBAL_OFFSET_TABLE_"}


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    "name", ["mass_on_car", "cars plant", "cars trajectory", *(["rotary_crane loop"] if FULL else [])]
)
def test_sources_without_stdio_call_the_mathematics_of_c_and_the_host_only(
    name: str, fmi: int, compiler: list[str], tmp_path: Path
) -> None:
    """As controllers need it that compile sources (TwinCAT's TE1420): no call of an operating system, nothing else."""
    model = replace(exported(name), host=HostRules(stdio=False, internal_steps=7))
    put(tmp_path, fmu_sources(model, fmi))
    objects = [Path(file).with_suffix(".o").name for file in compiled_files(model, fmi)]
    for file, made in zip(compiled_files(model, fmi), objects, strict=True):
        optimized = "-O2" if file.startswith("fmi") else "-O0"
        command = [*compiler, "-std=c99", optimized, "-ffreestanding", "-fno-builtin", *STRICT, "-c", file, "-o", made]
        subprocess.run(command, cwd=tmp_path, check=True)
    subprocess.run([*compiler, "-r", "-nostdlib", *objects, "-o", "all.o"], cwd=tmp_path, check=True)
    listed = subprocess.run(["nm", "-u", "all.o"], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    wanted = {line.split()[-1] for line in listed.splitlines()}
    assert wanted <= PLAIN


def test_without_stdio_sentences_have_question_marks_for_numbers_and_the_bound_of_steps_holds(tmp_path: Path) -> None:
    rules = HostRules(stdio=False, internal_steps=7)
    plant = sc.export_plant(sc.scenes.cars(), tmp_path / "plant.fmu", fmi=2, targets="host", host=rules)
    with Native("cars plant", 2, plant) as host:
        host.start(internal_step=0.01)
        assert host.step(0.0, 0.07)
        assert host.status(0.07, 0.08) == ERROR
        assert host.messages[-1] == (
            "an internal_step of ? s divides the communication step of ? s into more than ? steps"
        )
        with pytest.raises(FMICallException):
            host.set(internal_step=-1.0)
        assert host.messages[-1] == "internal_step = ? s is outside its range [?, ?] s"
    with pytest.raises(sc.InvalidSetting, match="at least 1 internal step, not 0"):
        HostRules(internal_steps=0)


def test_memory_is_the_host_s() -> None:
    """Of instances and saved states, in FMI 2; all of it is given back, and steps take none."""
    taken: dict[int, Any] = {}

    def allocate(count: int, size: int) -> int:
        block = ctypes.create_string_buffer(max(count * size, 1))
        taken[ctypes.addressof(block)] = block
        return ctypes.addressof(block)

    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(lambda *_: None)
    callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(allocate)
    callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(taken.__delitem__)
    file = native_file("cars", 2)
    fmu = FMU2Slave(guid=read_model_description(str(file)).guid, unzipDirectory=extracted(file), modelIdentifier="cars",
                    instanceName="cars")  # fmt: skip
    fmu.instantiate(callbacks=callbacks)
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    assert len(taken) == 2
    state = fmu.getFMUstate()
    for k in range(10):
        fmu.doStep(0.1 * k, 0.1)
    assert len(taken) == 3
    fmu.freeFMUstate(state)
    fmu.freeInstance()
    assert not taken


# The worst case ------------------------------------------------------------------------------------------------------

LOOP = """
#include <stdlib.h>
#include "{name}.h"
int main(int count, char **words)
{{
    static {name}_memory memory;
    double outputs[64];
    int failed = {name}_start(&memory, {name}_rest, {name}_defaults, outputs);
    for (int k = atoi(words[1]); k > 0; k--)
        failed |= {name}_step(&memory, {name}_rest, 0.01, {name}_defaults, outputs);
    return failed;
}}
"""


@pytest.mark.skipif(shutil.which("valgrind") is None, reason="needs valgrind, which counts instructions")
@pytest.mark.parametrize("name", ["cars", "mass_on_car", "passive_joint_arm", "rotary_crane"])
def test_the_operations_that_a_readme_tells_are_those_that_run(name: str, compiler: list[str], tmp_path: Path) -> None:
    """An operation is an instruction or two, and copies and indices come on top."""
    files = c_files(exported(name))
    put(tmp_path, files | {"main.c": LOOP.format(name=name)})
    subprocess.run([*compiler, "-O2", f"{name}.c", "main.c", "-o", "run", "-lm"], cwd=tmp_path, check=True)
    counts = []
    for steps in (10, 110):
        command = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", "./run", str(steps)]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        counts.append(int(done.stderr.split("Collected : ")[1].split()[0]))
    ran = (counts[1] - counts[0]) / 100
    cells = [line.strip("| ").split(" | ", 1) for line in files["README.md"].splitlines()]
    rows = {each[0]: each[1] for each in cells if len(each) == 2}
    told, most = (int(rows[key].split(",")[0]) for key in ("floating-point operations of a call", "at most"))
    print(name, told, most, ran)
    assert 0.5 * told < ran < 12 * told
    assert told <= most
    assert ran < 4 * most
    assert "bytes" in rows["code"]
    assert "bytes" in rows["stack"]


UNSTABLE = {"boom_crane", "quadrotor_with_load"}
"""Without feedback a boom under a constant torque falls, and the load of a quadrotor drifts: errors of a step grow."""


@pytest.mark.parametrize("name", sorted({*sc.scenes.REGISTRY} - UNSTABLE) if FULL else ["cars", "overhead_crane"])
@pytest.mark.usefixtures("empty_folder")
def test_the_system_of_a_scene_follows_its_path(name: str) -> None:
    scene = sc.scenes.REGISTRY[name]()
    result = run("ssp", name, "-o", "x.ssp", "--targets", "host")
    assert result.exit_code == 0
    assert "  certificate: " in result.stderr
    duration = scene.reference.duration
    found = run_ssp(Path("x.ssp"), duration, duration / 2000)
    columns = [each for each in found if each.startswith("trajectory.") and f"plant{each[10:]}" in found]
    assert columns
    for each in columns:
        wanted, moved = found[each], found[f"plant{each[10:]}"]
        assert np.abs(moved - wanted).max() <= 0.01 * max(np.abs(wanted).max(), 1e-3), each


def test_a_system_whose_path_starts_in_motion_starts_its_plant_in_motion(tmp_path: Path) -> None:
    scene = CRANE.with_reference(sc.from_csv(rows(tmp_path / "part.csv", CRANE.reference, (8.0, 20.0), 8.0)))
    found = run_ssp(sc.export_ssp(scene, tmp_path / "x.ssp", targets="host"), 2.0, 0.01)
    for k in (1, 2, 3):
        assert np.abs(found[f"trajectory.load.position[{k}]"] - found[f"plant.load.position[{k}]"]).max() < 1e-3
    with pytest.raises(sc.InvalidSetting, match=r"the name of a system ends with \.ssp"):
        sc.export_ssp(scene, tmp_path / "x.zip")
