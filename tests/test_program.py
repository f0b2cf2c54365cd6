"""`Program`: a value that can be written down, read back and run where only NumPy and CasADi are."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from problems import METHODS, scene

import servocore as sc
from servocore.stepping.program import LimitText, Program, require_margins

CRANE = scene("rotary_crane")


@pytest.fixture(scope="module")
def stepper() -> sc.Stepper:
    return sc.Stepper(CRANE, sc.Projected(), sc.BackwardEuler(), 0.1)


def test_a_saved_program_runs_where_only_numpy_and_casadi_can_be_imported(stepper: sc.Stepper, tmp_path: Path) -> None:
    """As in an FMU: its few modules alone in a folder, everything else of the world refused."""
    package = tmp_path / "servocore"
    for module in (
        "stepping/program",
        "numerics/compiled_calls",
        "numerics/memoization",
        "numerics/serialization",
        "model/quantity",
        "errors",
    ):
        target = package / f"{module}.py"
        target.parent.mkdir(parents=True, exist_ok=True)
        (target.parent / "__init__.py").write_text("")
        target.write_text((Path(sc.__file__).parent / f"{module}.py").read_text())
    (tmp_path / "program.json").write_text(stepper.program.to_json())
    jets = CRANE.reference.jet(np.arange(4) * 0.1 + 5.0, stepper.start_order)
    np.save(tmp_path / "jets.npy", jets)
    np.save(tmp_path / "p.npy", stepper.parameters)
    script = """
        import sys
        import importlib.abc

        class Refuse(importlib.abc.MetaPathFinder):
            def find_spec(self, name, path=None, target=None):
                if name.split(".")[0] in ("scipy", "matplotlib", "crane_fmu", "fmpy", "jinja2", "rich", "click"):
                    raise ImportError(f"{name} is not for an FMU")

        sys.meta_path.insert(0, Refuse())
        from pathlib import Path
        import numpy as np
        from servocore.stepping.program import Program
        program = Program.from_json(Path("program.json").read_text())
        jets, p = np.load("jets.npy"), np.load("p.npy")
        state, _ = program.begin(jets[0], p, 0.1)
        for jet in jets[1:]:
            state, report = program.advance(state, jet[None], 0.1, p)
            assert report.converged
        np.save("state.npy", state)
        assert not [name for name in sys.modules if name.startswith("scipy")]
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)], cwd=tmp_path, capture_output=True, text=True, check=False,
        env={"PYTHONPATH": str(tmp_path), "PATH": "", "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    state, _ = stepper.start(jets[0])
    for jet in jets[1:]:
        state, _ = stepper.advance(state, jet)
    np.testing.assert_array_equal(np.load(tmp_path / "state.npy"), state)


def test_serializing_twice_gives_the_same_text(stepper: sc.Stepper) -> None:
    text = stepper.program.to_json()
    assert text == stepper.program.to_json()
    assert json.loads(text)["format"] == "servocore program 3"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "no json",
        "[]",
        "{}",
        '{"format": "servocore program 3"}',
        '{"format": "servocore program 3", "casadi": "3"}',
    ],
)
def test_what_is_no_program_is_refused(text: str) -> None:
    with pytest.raises(sc.ServocoreError, match="the saved program"):
        Program.from_json(text)


def test_another_format_is_refused_by_name(stepper: sc.Stepper) -> None:
    document = json.loads(stepper.program.to_json()) | {"format": "servocore program 99"}
    with pytest.raises(sc.ServocoreError, match="the saved program has another format"):
        Program.from_json(json.dumps(document))


def test_a_damaged_function_is_refused(stepper: sc.Stepper) -> None:
    document = json.loads(stepper.program.to_json())
    document["functions"] = document["functions"][: len(document["functions"]) // 2]
    with pytest.raises(sc.ServocoreError, match="the saved program cannot be read"):
        Program.from_json(json.dumps(document))


def test_a_program_with_missing_or_surplus_fields_is_refused(stepper: sc.Stepper) -> None:
    document = json.loads(stepper.program.to_json())
    with pytest.raises(sc.ServocoreError, match="the saved program cannot be read"):
        Program.from_json(json.dumps({k: v for k, v in document.items() if k != "channels"}))
    with pytest.raises(sc.ServocoreError, match="the saved program cannot be read"):
        Program.from_json(json.dumps(document | {"colour": "red"}))


def test_limits_are_checked_at_single_instants_with_the_time(stepper: sc.Stepper) -> None:
    jet = CRANE.reference.jet(3.0, stepper.start_order)
    stepper.program.require_within_limits(jet, stepper.parameters, 3.0)
    jet[2, 2] = -10.0
    with pytest.raises(sc.InvalidReference, match=r"at t = 3 s the rope goes slack: g \+ z'' is -0.19 m/s2"):
        stepper.program.require_within_limits(jet, stepper.parameters, 3.0)


@pytest.mark.parametrize("margin", [0.0, -1.0, float("nan")])
def test_a_margin_that_is_not_positive_breaks_its_limit(margin: float) -> None:
    limit = LimitText("the gap", "m", "they touch", 0.5)
    require_margins([limit, limit], np.array([1e-9, 2.0]), 1.0)
    with pytest.raises(sc.InvalidReference, match=r"at t = 1 s they touch: the gap is .* m, it must stay above 0.5 m"):
        require_margins([limit, limit], np.array([1.0, margin]), 1.0)


@pytest.mark.parametrize("method", [each.method for each in METHODS], ids=lambda method: method.name)
def test_the_worst_equation_of_a_step_is_one_of_its_equations(method: sc.Method) -> None:
    """Also where a step has several stages, each with all equations."""
    several = sc.Stepper(CRANE, sc.Projected(), method, 0.1)
    program, state = several.program, np.full(several.program.state_size, 0.3)
    for k in range(6):
        jets = np.random.default_rng(k).normal(size=(len(program.nodes), program.start_order + 1, 3))
        assert program.worst_equation(state, jets, 0.1, several.parameters) in program.equations
    jets[0] = np.nan
    assert program.worst_equation(state, jets, 0.1, several.parameters) in program.equations
