"""The command line does what its help says, and refuses with one sentence."""

import os
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_lines import columns, table, write
from command_lines import crane_fmu as run
from present import present
from test_reference_files import table as rows_of
from test_reference_files import write as write_rows

import servocore as sc
from crane_fmu.catalogue import METHODS, MODELS
from servocore.cli import feedforward

pytestmark = pytest.mark.usefixtures("empty_folder")

HEADER = ["time", "M_b", "F", "M_w", "phi", "s", "l", "x", "y", "z", "tension"]
INPUTS = ((1, "M_b"), (2, "F"), (3, "M_w"))
LINE = ["--from", "5", "0", "-5", "--to", "-2", "2", "-2", "--duration", "20"]
PAPER = ["--formulation", "projected", "--method", "backward-euler"]
ROOT = Path(__file__).resolve().parents[1]
assert_refused = run.assert_refused


def reference_csv(groups: int = 5) -> str:
    """Write the default manoeuvre with so many groups of columns."""
    write_rows(Path("path.csv"), rows_of(sc.scenes.rotary_crane().reference, 0.1, groups), groups)
    return "path.csv"


class TestFeedforward:
    def test_the_table_goes_to_the_standard_output_stream_without_an_output_file(self) -> None:
        result = run("feedforward", *LINE)
        header, values = table(result.stdout)
        assert result.exit_code == 0
        assert header == HEADER
        assert values.shape == (201, 11)  # duration/200 by default
        assert values[0, 0] == 0.0
        assert values[-1, 0] == 20.0
        assert os.listdir() == []

    @pytest.mark.parametrize("model", MODELS)
    def test_a_file_holds_what_solve_returns_to_the_last_bit(self, model: str) -> None:
        options = ("--model", model, "--step", 0.1, "--output", "inputs.csv")
        assert run("feedforward", *LINE, *PAPER, *options).exit_code == 0
        header, values = table(Path("inputs.csv").read_text())
        solution = sc.solve(sc.scenes.rotary_crane(), sc.Projected(), sc.BackwardEuler(), step=0.1, model=model)
        assert header == HEADER
        np.testing.assert_array_equal(values[:, 0], solution.t)
        for k, name in enumerate(HEADER[1:], start=1):
            np.testing.assert_array_equal(values[:, k], solution[name], err_msg=name)
        assert os.listdir() == ["inputs.csv"]

    @pytest.mark.parametrize("method", METHODS)
    def test_every_method_can_be_asked_for(self, method: str) -> None:
        result = run("feedforward", *LINE, "--formulation", "projected", "--method", method)
        header, values = table(result.stdout)
        assert header == HEADER
        exact = sc.scenes.rotary_crane().exact(values[:, 0])
        off = [np.abs(values[:, k] - exact[name]).max() / np.abs(exact[name]).max() for k, name in INPUTS]
        assert result.exit_code == (1 if max(off) >= 0.5 else 0)  # Gauss with two stages loses M_b
        if not method.startswith("gauss"):  # between its nodes a collocation polynomial that damps nothing may stray
            np.testing.assert_allclose(values[:, 5], sc.scenes.rotary_crane().exact(values[:, 0])["s"], atol=1e-6)

    def test_without_a_path_the_load_goes_the_way_of_the_scene(self) -> None:
        assert run("feedforward").stdout == run("feedforward", *LINE).stdout

    @pytest.mark.parametrize("options", [["--rtol", 1e-3], ["--atol", 0.5], ["--rtol", 1e-3, "--atol", 0.1]])
    def test_a_tolerance_takes_the_place_of_a_step(self, options: Sequence[str]) -> None:
        result = run("feedforward", *LINE, "--formulation", "projected", "--method", "radau3", *options)
        _, values = table(result.stdout)
        assert values.shape == (201, 11)
        exact = sc.scenes.rotary_crane().exact(values[:, 0])
        for k, name in ((1, "M_b"), (2, "F"), (3, "M_w")):
            assert np.abs(values[:, k] - exact[name]).max() < 2e-3 * np.abs(exact[name]).max() + 0.5, name

    def test_rows_under_a_tolerance_are_where_they_are_wanted(self) -> None:
        result = run("feedforward", *LINE, "--rtol", 1e-3, "--output-step", 0.5)
        assert table(result.stdout)[1][:, 0].tolist() == [0.5 * k for k in range(41)]

    def test_a_warning_of_the_library_is_a_note_and_the_table_comes_all_the_same(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def warn(*arguments: Any, **options: Any) -> sc.Solution:
            warnings.warn("mind the gap", sc.ServocoreWarning, stacklevel=1)
            return solve(*arguments, **options)

        solve = sc.solve
        monkeypatch.setattr(feedforward, "solve", warn)
        result = run("feedforward", *LINE)
        assert result.exit_code == 0
        assert "crane-fmu: note: mind the gap" in result.stderr.splitlines()
        assert len(result.stdout.splitlines()) == 202

    @pytest.mark.parametrize(
        "options",
        [
            ["--formulation", "projected", "--step", 0.5],
            ["--formulation", "original", "--method", "gauss1", "--step", 0.1],
            ["--formulation", "original", "--method", "trapezoidal", "--step", 0.05],
        ],
    )
    def test_inputs_off_by_half_their_peak_end_with_code_1_and_one_true_sentence(self, options: Sequence[str]) -> None:
        result = run("feedforward", *LINE, *options, "--output", "inputs.csv")
        assert result.exit_code == 1
        assert result.stdout == ""
        said = re.fullmatch(
            r"crane-fmu: rotary crane, points, .*: these inputs are of no use: (\w+) is off by (\S+) % of its peak; at"
            r" t = (\S+) s it is (\S+) (?:N|N\.m) instead of (\S+) (?:N|N\.m); --formulation reduced is exact\n",
            result.stderr,
        )
        assert said is not None, result.stderr
        name, (share, time, found, right) = said[1], map(float, said.groups()[1:])
        values = columns("inputs.csv")
        exact = sc.scenes.rotary_crane().exact(values["time"])[name]
        k = int(np.abs(values["time"] - time).argmin())
        assert (found, right) == pytest.approx((values[name][k], exact[k]), rel=1e-3, abs=1e-9)
        assert share == pytest.approx(100.0 * np.abs(values[name] - exact).max() / np.abs(exact).max(), rel=0.01)
        assert share >= 50.0

    def test_the_shortest_duration_that_a_refusal_names_keeps_the_limits(self) -> None:
        limits, way = ["--limit", "M_b=1000", "--limit", "F=60"], ["--from", 5, 0, -5, "--to", -2, 2, -2]
        refused = run("feedforward", *way, "--duration", 2, *limits)
        assert refused.exit_code == 2
        shortest = float(refused.stderr.split("keeps all limits is ")[1].split(" s")[0])
        assert run("feedforward", *way, "--duration", shortest, *limits).exit_code == 0
        assert run("feedforward", *way, "--duration", 0.999 * shortest, *limits).exit_code == 2

    def test_limits_from_a_file_count_options_replace_them_and_kept_ones_change_nothing(self) -> None:
        Path("limits.toml").write_text('F = 17\nM_w = [-104, -92]\nswing = "5 deg"\ns.rate = 1.2\n')
        assert_refused(run("feedforward", *LINE, "--limits", "limits.toml"), "F goes beyond its lower limit of -17 N")
        kept = run("feedforward", *LINE, "--limits", "limits.toml", "--limit", "F=60")
        assert (kept.exit_code, kept.stdout) == (0, run("feedforward", *LINE).stdout)

    def test_what_code_1_advises_helps(self) -> None:
        advised = run("feedforward", *LINE, "--formulation", "reduced", "--method", "gauss1", "--step", 0.1)
        assert advised.exit_code == 0
        assert "note" not in advised.stderr

    def test_peaks_with_their_times_and_errors_are_told_on_the_error_stream(self) -> None:
        told = run("feedforward", *LINE).stderr.splitlines()
        exact = sc.scenes.rotary_crane().exact(np.linspace(0.0, 20.0, 201))
        for name, said in zip(("M_b", "F", "M_w"), told[1:4], strict=True):
            found = re.fullmatch(rf"  {name}: peak (\S+) N(?:\.m)? at t = (\S+) s", said)
            assert found, said
            k = int(np.abs(exact[name]).argmax())
            assert float(found[1]) == pytest.approx(exact[name][k], rel=1e-5)
            assert float(found[2]) == pytest.approx(0.1 * k)
        assert told[0].endswith("201 rows, 20 s")
        assert told[4].startswith("  swing: peak 1.00")
        assert told[5] == "  ends: at rest at start and end"
        assert re.fullmatch(
            r"  inputs: numerical error at most \d\.\de-1[4-6] of their peaks, .* \(data, path fitting and unmodelled"
            r" effects not included\)",
            told[6],
        )
        proved = (
            r"  certificate: proved: one regular motion at all times from 0 s to 20 s, inputs within \d\.\de-\d\d .*"
        )
        assert re.fullmatch(proved, told[7])
        assert len(told) == 8  # the path of a line is exact

    def test_what_rounded_samples_do_to_the_inputs_is_told_apart_from_numerics(self) -> None:
        t = np.linspace(0.0, 20.0, 201)
        rows = np.column_stack([1e5 + t, np.round(sc.scenes.rotary_crane().reference.jet(t, 0)[:, 0], 3)])
        lines = [",".join(map(repr, row)) for row in rows.tolist()]
        Path("rounded.csv").write_text("\n".join(["time,x,y,z", *lines, ""]))
        told = run("feedforward", "--reference", "rounded.csv", "--tolerance", "1mm").stderr
        assert re.search(r"M_b: peak \S+ N.m at t = 100012.2 s\n", told)
        assert re.search(r"inputs: numerical error at most \d\.\de-1[4-6] of their peaks", told)
        found = re.search(r"inputs: from path fitting about (\S+) of their peaks, by fits to every second sample", told)
        assert found, told
        assert 3e-5 < float(found[1]) < 3e-4  # the true error of M_b is 7e-5

    def test_a_path_that_does_not_rest_is_told_with_what_moves(self) -> None:
        moving = reference_csv(groups=1)
        rows = Path(moving).read_text().splitlines()
        Path(moving).write_text("\n".join([rows[0], *rows[20:]]) + "\n")
        path = sc.scenes.rotary_crane().reference
        speed = float(np.linalg.norm(path.jet(1.9, 1)[1]))
        told = run("feedforward", "--reference", moving).stderr
        assert f"not at rest: at the start its speed is {speed:.3g} m/s, so that the inputs jump there" in told

    def test_columns_are_chosen_and_more_is_told_when_asked(self) -> None:
        result = run("feedforward", *LINE, "--columns", "swing,M_w", "-v")
        assert result.stdout.startswith("time,swing,M_w\n")
        for word in ("steps", "Newton iterations", "versions: servocore", "s of processor time"):
            assert word in result.stderr

    def test_waypoints_may_stop_on_the_way(self) -> None:
        write("way.csv", "time,x,y,z,stop\n0,5,0,-5,\n10,3,1,-4,1\n20,-2,2,-2,\n")
        result = run("feedforward", "--waypoints", "way.csv", "--columns", "M_b,F,M_w,tension")
        values = table(result.stdout)[1]
        assert values[100, 1:4] == pytest.approx([0.0, 0.0, -98.1], abs=1e-7)

    def test_an_input_that_is_zero_but_for_round_off_has_no_peak_to_be_off_from(self) -> None:
        radial = ["--from", 5, 2.83, -5, "--to", 3, 1.698, -5, "--duration", 10]
        assert run("feedforward", *radial, "--formulation", "original", "--step", 0.01).exit_code == 0

    @pytest.mark.parametrize("profile", [*sc.TIME_LAWS, "three-phase --ramp 8"])
    def test_every_profile_can_be_asked_for(self, profile: str) -> None:
        _, values = table(run("feedforward", *LINE, "--profile", *profile.split()).stdout)
        path = sc.rest_to_rest((5, 0, -5), (-2, 2, -2), 20.0, sc.TIME_LAWS.get(profile, sc.three_phase(8.0)))
        np.testing.assert_allclose(values[:, 7:10], path.jet(values[:, 0], 0)[:, 0], atol=1e-12)

    def test_parameters_from_a_file_change_the_crane(self) -> None:
        write("crane.toml", "load_mass = 50\n")
        _, values = table(run("feedforward", *LINE, "--parameters", "crane.toml").stdout)
        assert values[0, 10] == pytest.approx(50 * 9.81)
        assert values[0, 3] == pytest.approx(-50 * 9.81 * 0.1)

    @pytest.mark.parametrize(("name", "start"), [("p.png", b"\x89PNG"), ("p.svg", b"<?xml"), ("p.pdf", b"%PDF")])
    def test_a_plot_is_drawn_beside_the_table(self, name: str, start: bytes) -> None:
        assert run("feedforward", *LINE, "--plot", name, "--output", "inputs.csv").exit_code == 0
        assert Path(name).read_bytes().startswith(start)
        assert sorted(os.listdir()) == ["inputs.csv", name]


TOML = {
    "unknown key": ("load_mas = 3", "no parameter is called 'load_mas'; there are bridge_inertia, "),
    "negative mass": ("load_mass = -1", "load_mass = -1 kg is outside its range"),
    "beyond the bounds": ("load_mass = 1e12", "load_mass = 1e+12 kg is outside its range"),
    "text": ('load_mass = "heavy"', "load_mass must be a number, not a text"),
    "boolean": ("load_mass = true", "load_mass must be a number, not a boolean"),
    "table": ("[load_mass]\nvalue = 3", "load_mass must be a number, not a table"),
    "not a number": ("load_mass = nan", "load_mass = nan kg is outside its range"),
    "infinite": ("gravity = inf", "gravity = inf m/s2 is outside its range"),
    "huge integer": (f"gravity = {'9' * 400}", "gravity"),
    "no TOML": ("load_mass 3", "is not a TOML file"),
    "no text": ("load_mass = 3\xff", "not UTF-8 text"),
}


@pytest.mark.parametrize(("text", "words"), TOML.values(), ids=TOML)
def test_a_bad_parameter_file_is_refused_with_file_and_key(text: str, words: str) -> None:
    Path("crane.toml").write_bytes(text.encode("latin-1"))
    result = run("feedforward", *LINE, "--parameters", "crane.toml", "--output", "o.csv")
    assert_refused(result, "crane.toml", words)
    assert os.listdir() == ["crane.toml"]


PAGE = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
EXAMPLES = [
    line.removeprefix("$ crane-fmu ").split()
    for block in re.findall(r"^```console\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    for line in block.splitlines()
    if line.startswith("$ crane-fmu feedforward --")
]


@pytest.mark.parametrize("arguments", EXAMPLES, ids=" ".join)
def test_the_examples_of_the_page_run(arguments: Sequence[str]) -> None:
    reference_csv()
    write("way.csv", re.findall(r"^```text\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)[1])
    write("crane.toml", present(re.search(r"^```toml\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE))[1])
    result = run(*arguments)
    assert result.exit_code == 0, result.stderr
    for option in ("--output", "--plot"):
        if option in arguments:
            assert Path(arguments[arguments.index(option) + 1]).is_file()


def test_the_page_shows_the_header_of_the_table() -> None:
    assert f"`{','.join(HEADER)}`" in PAGE
