"""Machine code comes by itself, is kept for the next process, and changes no bit of any result but of angles."""

import os
import stat
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from command_lines import servocore
from present import present
from processes import python

import servocore as sc
from servocore.numerics import code_cache
from servocore.numerics import vectorized as vectorized_module
from servocore.numerics.code_cache import CodeCache
from servocore.numerics.machine_code import BACKGROUND, Build, _Processes, built, library_of
from servocore.numerics.stepped_runs import Instants, Run, SteppedRuns
from servocore.numerics.vector_code import NoCounterpart, vector_source
from servocore.numerics.vectorized import Extremes, Vectorized, extremes_of
from servocore.problem import Problem
from servocore.solvers.exact_inversion import input_evaluation
from servocore.stepping.program import program_of
from servocore.structure.inversion import inversion

SOURCE = "int servocore_answer(void) { return 42; }\n"


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CodeCache:
    monkeypatch.setenv("SERVOCORE_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("SERVOCORE_MACHINE_CODE", raising=False)
    return CodeCache.of_user()


# What it computes ----------------------------------------------------------------------------------------------------

x, y = ca.SX.sym("x"), ca.SX.sym("y")
OPERATIONS = [
    x + y, x - y, x * y, x / y, 2 * x, x * x, -x, 1 / x, ca.sqrt(ca.fabs(x)), ca.sin(x), ca.cos(y), ca.tan(x),
    ca.atan(x), ca.asin(y / 9), ca.acos(y / 9), ca.sinh(x), ca.cosh(y), ca.tanh(x), ca.exp(x), ca.log(ca.fabs(y)),
    ca.fabs(x) ** y, x**3, x**0.3, ca.floor(x), ca.ceil(y), ca.fmin(x, y), ca.fmax(x, y), ca.sign(x), ca.fabs(y), x < y,
    x <= y, ca.eq(x, y), ca.ne(x, y), ca.logic_and(x < 0, y < 1), ca.logic_or(x < 0, y < 1), ca.if_else(x < y, x, y),
    ca.logic_not(x < y), ca.copysign(x, y), ca.fmod(x, y), ca.hypot(x, y),
]  # fmt: skip


@pytest.mark.parametrize("along", [(True, True), (True, False), (False, True)], ids=["both", "first", "second"])
@pytest.mark.usefixtures("compiler")
def test_every_operation_gives_the_bits_of_the_interpreter(along: tuple[bool, bool]) -> None:
    function = ca.Function("sc_all", [x, y], [ca.densify(ca.vertcat(*OPERATIONS))])
    special = [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 0.5, 2.0, -2.5]
    first, second = (each.ravel() for each in np.meshgrid(special, special))
    values = [first[None], second[None]]
    given = [each if goes else each[0, 34:35] for each, goes in zip(values, along, strict=True)]
    interpreted, compiled = (Vectorized(function, along, native, "all")(*given)[0] for native in (False, True))
    np.testing.assert_array_equal(compiled, interpreted)


@pytest.mark.usefixtures("compiler")
def test_an_angle_is_off_by_less_than_two_units_in_the_last_place_wherever_the_point_is() -> None:
    turn, random = np.linspace(-4.0, 4.0, 8000), np.random.default_rng(5)
    far = random.choice([-1.0, 1.0], (2, 8000)) * 10.0 ** random.uniform([[-320], [-20]], [[308], [20]], (2, 8000))
    special = np.meshgrid(*[[0.0, -0.0, np.inf, -np.inf, np.nan, 5e-324, -1e308, 1.0]] * 2)
    given = np.hstack([[np.sin(turn), np.cos(turn)], far, far[::-1], np.reshape(special, (2, -1))])
    angle = ca.Function("sc_angle", [x, y], [ca.atan2(x, y)])
    found = Vectorized(angle, (True, True), True, "angle")(given[:1], given[1:])[0][0]
    exact = np.arctan2(*given.astype(np.longdouble))
    off = (found - exact) / np.spacing(np.abs(exact).astype(np.float64))
    np.testing.assert_allclose(off, 0.0 * exact, atol=1.5)  # NaN for NaN
    np.testing.assert_array_equal(np.copysign(0.0 * found + 1.0, found), np.copysign(0.0 * exact + 1.0, exact))


@pytest.mark.parametrize("count", [1, 7, 8, 9, 63, 64, 65, 200])
@pytest.mark.usefixtures("compiler")
def test_any_number_of_instants_and_cases_will_do(count: int) -> None:
    function = ca.Function("sc_some", [x, y], [ca.vertcat(x * y, x + 2), x - y])
    compiled = Vectorized(function, (True, False), True, "some")
    t, p = np.linspace(0.0, 1.0, count)[None], np.array([[3.0], [4.0], [5.0]])
    both, difference = compiled(t, p)
    np.testing.assert_array_equal(both, np.stack([np.vstack([t * k, t + 2]) for k in p]))
    np.testing.assert_array_equal(difference, np.stack([t - k for k in p]))


@pytest.mark.parametrize("count", [1, 7, 8, 9, 64, 201])
@pytest.mark.usefixtures("compiler")
def test_extremes_are_those_of_all_instants_and_tell_what_is_no_number(count: int) -> None:
    values = ca.vertcat(*OPERATIONS[:-3], 1 / (x - 3), ca.log(x - y), x * y)
    function = ca.Function("sc_extremes", [x, y], [ca.densify(values), x - y])
    t, p = np.linspace(-2.0, 3.0, count)[None] + 0.1, np.array([[3.0], [-4.0], [np.nan], [-np.inf]])
    for native in (True, False):
        found = Extremes(function, (True, False), native, "all")(t, p)
        for extremes, rows in zip(found, Vectorized(function, (True, False), False, "all")(t, p), strict=True):
            np.testing.assert_array_equal(extremes, extremes_of(rows))
            finite = np.isfinite(rows).all(axis=2)
            np.testing.assert_array_equal(extremes[:, 0][finite], rows.max(axis=2)[finite])
            np.testing.assert_array_equal(extremes[:, 1][finite], rows.min(axis=2)[finite])
            assert np.isnan(extremes.transpose(0, 2, 1)[~finite]).all()


@pytest.mark.usefixtures("compiler")
def test_threads_give_what_one_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.setattr("servocore.numerics.vectorized._PER_THREAD", 100)
    function = ca.Function("sc_shared", [x, y], [x * y])
    for t, p in ((np.arange(1001.0)[None], np.array([3.0])), (np.arange(101.0)[None], np.arange(11.0)[:, None])):
        interpreted, compiled = (Vectorized(function, (True, False), native, "all")(t, p) for native in (False, True))
        np.testing.assert_array_equal(compiled, interpreted)


def runs_of_two_states(native: bool) -> SteppedRuns:
    """Return steps of two states whose second reading must be positive."""
    state, hp, numbers = ca.SX.sym("state", 2), ca.SX.sym("hp", 3), ca.SX.sym("numbers", 1)
    rate = ca.sin(state[0]) - ca.fmin(0.1 * x * state[1], hp[2]) + ca.if_else(x > 2, hp[1], x)
    step = ca.Function("sc_row", [state, x, numbers, hp], [ca.vertcat(state[1], rate), state * hp[1]])
    p = ca.SX.sym("p", 2)
    read = ca.Function("sc_read", [state, x, numbers, p], [ca.vertcat(state[0] * x, p[1] + state[1] ** 2)])
    return SteppedRuns(step, read, range(1, 2), native, "row")


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("instants", [1, 7, 100])
def test_steps_in_a_row_and_what_is_read_between_them_have_the_bits_of_the_interpreter(instants: int) -> None:
    path, h = np.linspace(0.0, 5.0, 34)[None], 5.0 / 33
    start, settings = np.array([[0.3, 0.1], [0.2, 0.0]]), np.array([[h, 1.2, 0.3], [h, 0.7, 0.1]])
    t = np.random.default_rng(1).uniform(0.0, 5.0, instants)
    for case in (slice(None), 1):
        run = Run(0.0, 5.0, 33, path, np.zeros(1), settings[case], start[case])
        found = [runs_of_two_states(native)(run, Instants(t, t[None])) for native in (False, True)]
        np.testing.assert_array_equal(found[1][0], found[0][0])
        assert found[0][0].shape == ((2,) if case != 1 else ()) + (2, instants)
        assert [sound for _, sound in found] == [True, True]


@pytest.mark.usefixtures("compiler")
def test_threads_step_cases_to_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    path, t = np.linspace(0.0, 5.0, 34)[None], np.linspace(0.0, 5.0, 50)
    settings = np.column_stack([np.full(11, 5.0 / 33), np.linspace(0.5, 1.5, 11), np.full(11, 0.2)])
    run = Run(0.0, 5.0, 33, path, np.zeros(1), settings, np.zeros((11, 2)))
    alone, _ = runs_of_two_states(True)(run, Instants(t, t[None]))
    monkeypatch.setattr("servocore.numerics.vectorized._PER_THREAD", 100)
    in_threads, sound = runs_of_two_states(True)(run, Instants(t, t[None]))
    np.testing.assert_array_equal(in_threads, alone)
    assert sound


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("native", [False, True])
def test_times_outside_values_that_are_no_numbers_and_wrong_signs_are_not_sound(native: bool) -> None:
    runs, inside = runs_of_two_states(native), np.linspace(0.0, 5.0, 20)
    run = Run(0.0, 5.0, 33, np.linspace(0.0, 5.0, 34)[None], np.zeros(1), np.array([5.0 / 33, 0.7, 0.1]), np.zeros(2))

    def sound(run: Run, t: np.ndarray) -> bool:
        return runs(run, Instants(t, t[None]))[1]

    assert sound(run, inside)
    for wrong in (-1e-9, 5.0 + 1e-9, np.nan, np.inf):
        assert not sound(run, np.array([*inside, wrong]))
    assert not sound(replace(run, settings=np.array([5.0 / 33, 0.7, -9.0])), inside)
    assert not sound(replace(run, start=np.array([np.nan, 0.0])), inside)
    assert sound(run, np.empty(0))


@pytest.mark.parametrize("profile", [sc.DEGREE9, sc.DEGREE13, sc.three_phase(), sc.three_phase(1.0)], ids=str)
def test_a_path_gives_the_same_bits_as_a_formula(profile: sc.Profile) -> None:
    path = sc.rest_to_rest((5.0, 0.0, -1.0), (-3.0, 1.5, -0.2), 7.3, profile, 0.4)
    t = np.concatenate([np.linspace(-1.0, 9.0, 997), [0.4, 7.7, 4.05]])
    for order in (0, 1, 4, 8):
        numbers = path.formula.numbers(order)
        time, given = ca.SX.sym("t"), ca.SX.sym("numbers", len(numbers))
        columns = path.formula.jet(time, ca.vertsplit(given), order)
        jet = ca.Function("sc_jet", [time, given], [ca.densify(ca.vertcat(*columns))])
        (found,) = Vectorized(jet, (True, False), False, "path")(t[None], np.array(numbers))
        np.testing.assert_array_equal(found.reshape(order + 1, 3, -1).transpose(2, 0, 1), path.jet(t, order))


@pytest.mark.parametrize("name", ["rotary_crane", "gantry_crane", "overhead_crane"])
@pytest.mark.usefixtures("compiler")
def test_a_solution_has_the_same_bits_but_for_angles(name: str) -> None:
    scene = getattr(sc.scenes, name)()
    interpreted, compiled = (sc.solve(scene, native=native) for native in (False, True))
    np.testing.assert_array_max_ulp(compiled.values, interpreted.values, 2)
    differ = (compiled.values != interpreted.values).any(axis=0)
    assert {channel.unit for channel, differs in zip(compiled.channels, differ, strict=True) if differs} <= {"rad"}
    assert compiled.statistics == interpreted.statistics


def test_many_instants_are_looked_at_in_parts_with_the_same_result(monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(3).standard_normal((3, 1001))
    x, y = ca.SX.sym("x", 3), ca.SX.sym("y", 2)
    product = Vectorized(ca.Function("product", [x, y], [x * y[0], x + y[1]]), (True, False), False, "a test")
    whole = product(values, np.array([2.0, 5.0]))
    monkeypatch.setattr(vectorized_module, "_AT_ONCE", 37)
    for one, other in zip(whole, product(values, np.array([2.0, 5.0])), strict=True):
        np.testing.assert_array_equal(one, other)


def test_machine_code_has_no_more_statements_than_the_expression_has_operations() -> None:
    problem = Problem.of(sc.scenes.rotary_crane())
    flat = present(inversion(problem.array).expression)
    source = vector_source(flat, (True, False))
    assert sum(line.startswith("   const vec") for line in source.splitlines()) <= flat.n_instructions()
    with pytest.raises(NoCounterpart):
        vector_source(inversion(problem.array).search, (True, False, True))


# When it is made -----------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("compiler")
def test_machine_code_is_made_from_the_second_call_on_and_found_by_the_next(own_cache: code_cache.CodeCache) -> None:
    function = ca.Function("sc_product", [x, y], [x * y])
    t, p = np.arange(100.0)[None], np.array([3.0])
    product = Vectorized(function, (True, False), None, "product")
    product(t, p)
    assert not own_cache.contents()
    product(t, p)
    BACKGROUND.wait()
    assert len(own_cache.contents()) == 1
    np.testing.assert_array_equal(product(t, p)[0], 3.0 * t)
    assert product.ready(100)
    another = Vectorized(function, (True, False), None, "product")
    assert [another.ready(1, called=True) for _ in range(2)] == [False, True]
    assert len(own_cache.contents()) == 1


@pytest.mark.usefixtures("compiler")
def test_many_instants_are_worth_it_at_once_and_false_switches_it_off(own_cache: code_cache.CodeCache) -> None:
    function = ca.Function("sc_sum", [x, y], [x + y])
    t, p = np.arange(10_000.0)[None], np.array([3.0])
    for native, expected in ((False, 0), (None, 1)):
        Vectorized(function, (True, False), native, "sum")(t, p)
        BACKGROUND.wait()
        assert len(own_cache.contents()) == expected


@pytest.mark.usefixtures("own_cache")
def test_without_a_compiler_all_goes_on_interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    function = ca.Function("sc_difference", [x, y], [x - y])
    for _ in range(3):
        found = Vectorized(function, (True, False), None, "difference")(np.arange(20_000.0)[None], np.array([3.0]))
        BACKGROUND.wait()
    np.testing.assert_array_equal(found[0][0], np.arange(20_000.0) - 3.0)


def test_a_compiler_that_starts_while_the_process_ends_is_ended_too(tmp_path: Path) -> None:
    processes = _Processes()

    class Late(set[Any]):
        """What is added here comes after all that runs was ended."""

        def add(self, compiler: Any) -> None:
            processes.close()
            super().add(compiler)

    processes.running = Late()
    begin = time.monotonic()
    assert processes.run(["sleep", "600"], tmp_path)[0] != 0
    assert time.monotonic() - begin < 500


def test_a_process_ends_at_once_though_a_compiler_runs(tmp_path: Path) -> None:
    slow = tmp_path / "slowcc"
    slow.write_text('#!/bin/sh\necho $$ > "$0.new"; mv "$0.new" "$0.pid"\nexec sleep 600\n')
    slow.chmod(0o755)
    code = (
        "import time, numpy as np, casadi as ca; from servocore.numerics.vectorized import Vectorized\n"
        "from pathlib import Path\nx, y = ca.SX.sym('x'), ca.SX.sym('y')\n"
        "Vectorized(ca.Function('sc_f', [x, y], [x * y]), (True, False), None, 'f')(np.zeros((1, 20000)), np.ones(1))\n"
        f"while not Path({str(slow)!r} + '.pid').exists(): time.sleep(0.01)\n"
    )
    cache = str(tmp_path / "cache")
    done = python("-c", code, seconds=500, CC=str(slow), SERVOCORE_CACHE=cache, SERVOCORE_MACHINE_CODE="")
    assert done.returncode == 0, done.stderr
    running = Path("/proc") / Path(f"{slow}.pid").read_text().strip()
    assert not running.exists()


def one_of_its_own(scene: sc.Scene) -> sc.Scene:
    """A scene that shares nothing compiled with those of other tests, which compile no machine code."""
    own = replace(scene.model(), name=f"{scene.model().name} of this test")
    return replace(scene, models={"own": lambda: own})


@pytest.mark.usefixtures("compiler", "own_cache")
def test_an_inversion_becomes_machine_code_from_the_second_call_on_and_keeps_its_bits() -> None:
    crane, t = one_of_its_own(sc.scenes.overhead_crane()), np.linspace(0.0, 3.0, 300)
    inputs = sc.ExactInversion(crane)
    first = inputs(t)
    inputs(t)
    BACKGROUND.wait()
    np.testing.assert_array_equal(inputs(t), first)
    problem = Problem.of(crane)
    assert input_evaluation(problem, None).by_expression.ready(problem, len(t))


@pytest.mark.usefixtures("compiler", "own_cache")
def test_inversions_on_other_paths_of_one_system_keep_their_own() -> None:
    crane = sc.scenes.overhead_crane()
    other = crane.with_reference(sc.rest_to_rest((5.0, -1.0), (0.0, -4.0), 4.0))
    scenes = [crane, other, crane.with_parameters(load_mass=1.5)]
    known = [sc.ExactInversion(scene, native=False) for scene in scenes]
    made = [sc.ExactInversion(scene, native=True) for scene in scenes]
    t = np.linspace(0.0, 3.0, 37)
    for k in (0, 1, 0, 2, 1, 1, 2, 0):
        np.testing.assert_array_equal(made[k](t), known[k](t))
    assert np.abs(made[0](t) - made[1](t)).max() > 0.1
    with pytest.raises(sc.ServocoreError, match="nan"):
        made[0]([0.1, np.nan])


@pytest.mark.usefixtures("compiler", "own_cache")
def test_steps_become_machine_code_from_the_second_solve_on_and_keep_their_bits() -> None:
    crane = one_of_its_own(sc.scenes.overhead_crane())
    problem = Problem.of(crane)
    how = (sc.Projected(), sc.BackwardEuler())
    program = program_of(problem, *how)
    first = sc.solve(crane, *how)
    assert program_of(problem, *how, None) is program
    BACKGROUND.wait()
    assert program_of(problem, *how, None).step.class_name() == "External"
    np.testing.assert_array_equal(sc.solve(crane, *how).values, first.values)
    assert program_of(problem, *how, False) is program


# Where it is kept ----------------------------------------------------------------------------------------------------


def test_the_folder_is_its_users_alone_and_another_is_refused(own_cache: code_cache.CodeCache) -> None:
    assert own_cache.store("a" * 40, b"code") is not None
    assert stat.S_IMODE(own_cache.folder.stat().st_mode) == 0o700
    assert own_cache.find("a" * 40) is not None
    own_cache.folder.chmod(0o755)
    assert "mode 0755: only its user may have access" in own_cache.refusal()
    assert own_cache.find("a" * 40) is None
    assert own_cache.store("b" * 40, b"code") is None
    refused = servocore("cache")
    assert refused.exit_code == 2
    assert "no machine code is kept" in refused.output.replace("\n", " ")


def test_a_link_in_the_place_of_the_folder_is_refused(own_cache: code_cache.CodeCache, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    own_cache.folder.symlink_to(tmp_path / "elsewhere")
    assert own_cache.refusal().endswith("is no folder")


@pytest.mark.usefixtures("compiler", "own_cache")
def test_contents_that_are_not_those_that_were_stored_are_not_loaded() -> None:
    path = built(Build(SOURCE, "an answer"))
    assert library_of(Build(SOURCE, "an answer")) == path
    path.write_bytes(path.read_bytes()[:-1] + b"?")
    assert library_of(Build(SOURCE, "an answer")) is None
    assert not path.exists()
    assert built(Build(SOURCE, "an answer")) == library_of(Build(SOURCE, "an answer"))


def test_the_longest_unused_go_when_there_is_no_room(own_cache: CodeCache, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(code_cache, "MOST_BYTES", 250)
    paths = [present(own_cache.store(f"{k}" * 40, bytes([k]) * 100)) for k in (1, 2)]
    os.utime(paths[0], (2e9, 2e9))
    os.utime(paths[1], (1e9, 1e9))
    newest = own_cache.store("3" * 40, b"3" * 100)
    assert set(own_cache.contents()) == {paths[0], newest}


@pytest.mark.usefixtures("compiler")
def test_processes_that_build_the_same_do_not_meet(own_cache: code_cache.CodeCache) -> None:
    code = (
        "from servocore.numerics.machine_code import Build, built\nprint('ready', flush=True)\ninput()\n"
        f"print(built(Build({SOURCE!r}, 'an answer')))"
    )
    command, pipe = [sys.executable, "-c", code], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as other:
        assert present(other.stdout).readline() == "ready\n"
        present(other.stdin).write("\n")
        present(other.stdin).flush()  # from here on both build
        found = {str(built(Build(SOURCE, "an answer"))), other.communicate(timeout=600)[0].strip()}
    assert [str(each) for each in own_cache.contents()] == sorted(found)
    assert not list(own_cache.folder.glob("*.part"))


def test_the_command_shows_and_clears_the_cache(own_cache: code_cache.CodeCache) -> None:
    own_cache.store("a" * 40, b"code" * 1000)
    shown = servocore("cache")
    assert "1 library of machine code with 0.004 MB of at most 67.1 MB in" in shown.output
    cleared = servocore("cache", "clear")
    assert "1 library of machine code with 0.004 MB removed" in cleared.output
    assert not own_cache.contents()
