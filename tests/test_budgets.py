"""What a run of the suite measures of itself, and what it leaves out."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import chain
from pathlib import Path

import budgets
import concerned
import kept_compiler
import pytest
from thinned import thinned

TESTS = Path(__file__).resolve().parent


def test_files_over_budget_are_listed_the_worst_first() -> None:
    taken, allowed = {"a.py": 5.0, "b.py": 9.0, "c.py": 1.0, "new.py": budgets.UNLISTED + 1}, {"a.py": 4.0, "b.py": 2.0}
    listed = [line.partition(" ")[0] for line in budgets.over_budget(taken, allowed)]
    assert listed == ["b.py", "a.py", "new.py"]
    assert [line.partition(" ")[0] for line in budgets.over_budget(taken, allowed, 2.0)] == ["b.py"]


def test_every_budget_is_that_of_a_file() -> None:
    assert [name for name in budgets.budgets() if name != budgets.BUILT and not (TESTS / name).is_file()] == []


def test_quick_runs_the_first_short_case_of_a_function_and_the_shortest_of_a_file_without_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(budgets, "slow", lambda: {"f::a[1]": 3.0, "f::b": 0.0, "g::a": 2.0, "g::b": 1.0})
    cases = ["f::a[1]", "f::a[2]", "f::a[3]", "f::b", "g::a", "g::b"]
    assert budgets.representatives(cases) == ["f::a[2]", "f::b", "g::b"]


def test_short_cases_of_the_files_that_concern_a_change_most_are_added_as_time_allows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    long = budgets.BESIDES - 1.0
    monkeypatch.setattr(budgets, "slow", lambda: {"tests/f::a": long, "tests/g::a": long, "tests/h::b": long + 2.0})
    cases = [f"tests/{case}" for case in ("f::a", "f::b", "f::c", "g::a", "g::b", "h::a", "h::b")]
    added = budgets.besides(cases, [cases[1]], ["h::b", "h::a", "f", "g"])
    assert added == ["tests/h::a", "tests/f::c", "tests/g::b", "tests/f::a"]


def test_changes_are_those_since_the_last_commit_then_those_of_the_branch_then_those_of_the_last_commit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(concerned, "ROOT", tmp_path)
    assert concerned.changed() == []

    def commit(name: str, *before: list[str]) -> None:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("x")
        user = ["-c", "user.name=a", "-c", "user.email=a@b"]
        for words in (*before, ["add", name], [*user, "commit", "-m", name]):
            subprocess.run(["git", *words], cwd=tmp_path, check=True, capture_output=True)

    commit("servocore/a.py", ["init", "-b", "main"])
    commit("tests/b.py")
    assert concerned.changed() == ["tests/b.py"]
    commit("crane_fmu/c.py", ["checkout", "-b", "other"])
    commit("servocore/d.py")
    assert concerned.changed() == ["crane_fmu/c.py", "servocore/d.py"]
    for change in (["branch", "-m", "main", "old"], ["update-ref", "refs/remotes/origin/main", "old"]):
        subprocess.run(["git", *change], cwd=tmp_path, check=True, capture_output=True)
    assert concerned.changed() == ["crane_fmu/c.py", "servocore/d.py"]  # as in a clone of the branch
    (tmp_path / "servocore/a.py").unlink()
    (tmp_path / "README.md").write_text("z")
    assert concerned.changed() == ["servocore/a.py", "README.md"]


def test_tests_of_a_change_run_its_lines_and_few_others(monkeypatch: pytest.MonkeyPatch) -> None:
    rare, common, other = ("servocore/a.py", 1), ("servocore/a.py", 2), ("servocore/x/b.py", 1)
    runs = {"all.py::a": {common, other}, "own.py::a": {rare, common}, "third.py::a": {other}}
    table = concerned.table_of(runs)
    assert table == {"servocore/a.py": ["own.py", "all.py"], "servocore/x/b.py": ["all.py", "third.py"]}
    monkeypatch.setattr(concerned, "table", lambda: table)
    assert concerned.tests_of("servocore/a.py") == ["own.py", "all.py"]
    assert concerned.tests_of("servocore/x/c/new.h") == ["all.py", "third.py"]
    assert concerned.tests_of("servocore/new.py") == ["own.py", "all.py", "third.py"]
    assert concerned.tests_of("tests/outside/test_a.py") == ["outside/test_a.py"]
    assert concerned.tests_of("docs/a.md")[0].endswith("[docs/a.md]")


def test_quick_asks_something_of_every_file_and_a_case_of_most_functions(request: pytest.FixtureRequest) -> None:
    """Most: some claims cannot be asked in a moment."""
    cases = [item.nodeid for item in request.session.items]
    if len(set(map(budgets.file_of, cases))) < 100:
        pytest.skip("a part of the suite is run")
    chosen = budgets.representatives(cases)
    assert set(map(budgets.file_of, cases)) == set(map(budgets.file_of, chosen))
    functions, asked = (set(map(budgets.function_of, each)) for each in (cases, chosen))
    assert len(asked) > 0.85 * len(functions)
    assert budgets.dear_but_asked() <= asked
    if request.config.getoption("--quick"):
        return  # the others are not at hand
    listed = {*budgets.slow(), *(f"tests/{name}" for name in chain(*concerned.table().values()) if "::" in name)}
    files = set(map(budgets.file_of, cases))
    assert [case for case in listed.difference(cases) if budgets.file_of(case) in files] == []


def test_members_that_are_not_kept_are_for_the_night() -> None:
    found = thinned([1, 2, (3, 4)], lambda case: case == 1)
    assert [(each.values, bool(each.marks)) for each in found] == [((1,), False), ((2,), True), ((3, 4), True)]
    with pytest.raises(ValueError, match="no case is kept"):
        thinned([1, 2], lambda _: False)


TEXT, NUMBER = '#include "a.h"\nint answer(void) { return NUMBER; }\n', "#define NUMBER 42\n"
CHANGED: dict[str, tuple[str, ...]] = {
    "nothing": (TEXT, NUMBER),
    "source": (TEXT.replace("answer", "reply"), NUMBER),
    "header": (TEXT, NUMBER.replace("42", "43")),
    "option": (TEXT, NUMBER, "-O2"),
    "warning": (f"{TEXT}#warning x\n", NUMBER),
}


@pytest.mark.skipif(sys.platform == "win32", reason="the compiler that is kept is a shell script")
@pytest.mark.parametrize("what", CHANGED)
def test_a_library_is_compiled_again_only_if_something_of_it_has_changed(
    what: str, tmp_path: Path, compiler: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    kept, tools, headers = (tmp_path / name for name in ("kept", "tools", "headers"))
    for folder in (kept, tools, headers):
        folder.mkdir()
    (tools / "counted").write_text(f'#!/bin/sh\necho x >> "{tmp_path}/count"\nexec {" ".join(compiler)} "$@"\n')
    (tools / "cc").write_text(kept_compiler.script(str(tools / "counted")))
    for tool in tools.iterdir():
        tool.chmod(0o755)
    monkeypatch.setenv(kept_compiler.KEPT, str(kept))
    monkeypatch.delenv(kept_compiler.OPTIONS, raising=False)  # of a quick run

    def compiled(folder: str, source: str, header: str, *options: str) -> bytes:
        place = tmp_path / folder
        place.mkdir(exist_ok=True)
        (place / "a.c").write_text(source)
        (headers / "a.h").write_text(header)
        command = [str(tools / "cc"), "-fPIC", f"-I{headers}", *options]
        for words in (["-c", "-fstack-usage", "a.c", "-o", "a.o"], ["-shared", "a.o", "-o", "a.so"]):
            subprocess.run([*command, *words], cwd=place, check=True, env=dict(os.environ))
        return (place / "a.so").read_bytes() + (place / "a.su").read_bytes()

    first, second = compiled("one", TEXT, NUMBER), compiled("two", *CHANGED[what])
    made = 2 if what == "nothing" else 4
    assert len((tmp_path / "count").read_text().split()) == made
    assert (first == second) == (what in {"nothing", "warning"})
    compiled("three", *CHANGED[what])
    assert len((tmp_path / "count").read_text().split()) == made + (what == "warning")  # which is to be seen again
