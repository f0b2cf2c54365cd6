"""The library without what its extras bring: solving works, and whatever does not names the extra."""

from __future__ import annotations

import ast
import importlib
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path
from subprocess import CompletedProcess

import pytest
from processes import python

import servocore
from servocore.errors import missing_package

ROOT = Path(__file__).parents[1]
PACKAGES = ("control", "distributed", "fmpy", "jinja2", "markdown_it", "matplotlib", "pythonfmu", "xarray", "zarr")
CRANE, LIBRARY = "from crane_fmu.cli import main", "from servocore.cli import main"


def without_extras(code: str, *arguments: str, folder: Path) -> CompletedProcess[str]:
    """Run Python with none of the packages to be found."""
    blocked = f"import sys\nsys.modules.update(dict.fromkeys({PACKAGES}))\n"
    return python("-c", f"{blocked}{code}", *arguments, folder=folder)


def test_solving_needs_no_extra(tmp_path: Path) -> None:
    code = "import servocore as sc; sc.solve(sc.scenes.rotary_crane()); sc.analyse(sc.scenes.cars())"
    run = without_extras(code, folder=tmp_path)
    assert run.returncode == 0, run.stderr
    assert "package" not in run.stderr


def test_a_public_name_is_imported_from_where_types_say_it_is() -> None:
    tree = ast.parse((ROOT / "servocore" / "__init__.py").read_text(encoding="utf-8"))
    branch = next(each for each in tree.body if isinstance(each, ast.If))
    typed = {
        alias.name: node.module for node in branch.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert set(typed) == set(servocore.__all__)
    for name, home in typed.items():
        value = getattr(servocore, name)
        assert getattr(value, "__module__", home) in {home, "typing"} or home == "servocore", name
    assert set(servocore.__all__) <= set(dir(servocore))


def test_the_library_imports_nothing_before_its_first_use(tmp_path: Path) -> None:
    code = (
        "import sys, servocore as sc; assert 'casadi' not in sys.modules; sc.dae.Dae; sc.solve; sc.effects;"
        " assert 'casadi' in sys.modules; assert not hasattr(sc, 'nothing')"
    )
    run = without_extras(code, folder=tmp_path)
    assert run.returncode == 0, run.stderr


def test_the_script_that_builds_names_its_extra(tmp_path: Path) -> None:
    run = without_extras(
        f"import runpy; runpy.run_path({str(ROOT / 'build_fmu.py')!r}, run_name='__main__')", folder=tmp_path
    )
    assert run.returncode == 2
    assert "pip install '.[fmu]'" in run.stderr
    assert "Traceback" not in run.stderr


def test_nothing_native_imports_pythonfmu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [each for each in sys.modules if each.split(".")[0] in ("crane_fmu", "pythonfmu")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pythonfmu", None)
    build = importlib.import_module("crane_fmu.build")
    build.build_ssp(tmp_path, options=build.SystemOptions(native=True, targets="none"))


@pytest.mark.parametrize("package", PACKAGES)
def test_the_extra_that_is_named_brings_the_package(package: str) -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    said = str(missing_package(ImportError(name=package)))
    named = said.partition("pip install '.[")[2].partition("]")[0]
    brought = " ".join(extras[named]).lower()
    assert any(name.lower() in brought for name in packages_distributions()[package])
    assert named in extras["all"][0]


def test_other_imports_that_fail_are_no_refusals() -> None:
    assert missing_package(ImportError(name="numpy")) is None


@pytest.mark.parametrize("module", [CRANE, LIBRARY])
@pytest.mark.parametrize("option", ["--version", "-V"])
def test_command_lines_tell_their_version(module: str, option: str, tmp_path: Path) -> None:
    run = without_extras(f"{module}; main()", option, folder=tmp_path)
    assert (run.returncode, run.stdout) == (0, f"servocore {servocore.__version__}\n")
