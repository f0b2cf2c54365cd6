"""What a run of the suite measures of itself, and what it leaves out."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import budgets
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


def test_of_every_function_the_slow_cases_before_the_first_quick_one_are_left_out() -> None:
    long = 2 * budgets.A_MOMENT
    taken = {"f::a[1]": long, "f::a[2]": 0.0, "f::a[3]": long, "f::b": long, "f::c[x[0]]": 0.0}
    assert budgets.slow_cases(taken) == ["f::a[1]", "f::b"]
    assert budgets.slow_cases({**taken, "g::a": 3 * long, "g::b[1]": 2 * long, "g::b[2]": 3 * long}) == [
        "f::a[1]", "f::b", "g::a", "g::b[2]"
    ]  # fmt: skip


def test_a_quick_run_lists_what_took_long_but_leaves_every_file_a_case() -> None:
    long, short = 2 * budgets.A_SECOND, budgets.A_SECOND / 2
    assert budgets.slow_alone({"f::a": long, "f::b": short, "g::a": long}) == ["f::a"]


def test_quick_asks_something_of_every_file_and_a_case_of_most_functions(request: pytest.FixtureRequest) -> None:
    """Most: some claims cannot be asked in a moment."""
    items = request.session.items
    if len({item.path for item in items}) < 100:
        pytest.skip("a part of the suite is run")
    chosen = budgets.representatives(items)
    assert {item.path.name for item in items} == {item.path.name for item in chosen}
    functions, asked = ({budgets.function_of(item.nodeid) for item in each} for each in (items, chosen))
    assert len(asked) > 0.7 * len(functions)
    if request.config.getoption("--quick"):
        return  # the others are not at hand
    cases = functions | {item.nodeid for item in items}
    gone = (budgets.listed(budgets.SLOW) | budgets.listed(budgets.FURTHER)) - cases
    files = {case.partition("::")[0] for case in cases}
    assert [case for case in gone if case.partition("::")[0] in files] == []


def test_members_that_are_not_kept_are_for_the_night() -> None:
    found = thinned([1, 2, (3, 4)], lambda case: case == 1)
    assert [(each.values, bool(each.marks)) for each in found] == [((1,), False), ((2,), True), ((3, 4), True)]
    with pytest.raises(ValueError, match="no case is kept"):
        thinned([1, 2], lambda _: False)


@pytest.mark.skipif(sys.platform == "win32", reason="the compiler that is kept is a shell script")
def test_a_library_is_compiled_again_only_if_something_of_it_has_changed(
    tmp_path: Path, compiler: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    kept, tools, headers = (tmp_path / name for name in ("kept", "tools", "headers"))
    for folder in (kept, tools, headers):
        folder.mkdir()
    (tools / "counted").write_text(f'#!/bin/sh\necho x >> "{tmp_path}/count"\nexec {" ".join(compiler)} "$@"\n')
    (tools / "cc").write_text(kept_compiler.script(str(tools / "counted")))
    for tool in tools.iterdir():
        tool.chmod(0o755)
    monkeypatch.setenv(kept_compiler.KEPT, str(kept))

    def compiled(folder: str, source: str, header: str, *options: str) -> bytes:
        place = tmp_path / folder
        place.mkdir(exist_ok=True)
        (place / "a.c").write_text(source)
        (headers / "a.h").write_text(header)
        command = [str(tools / "cc"), "-shared", "-fPIC", f"-I{headers}", *options, "a.c", "-o", "a.so"]
        subprocess.run(command, cwd=place, check=True, env=dict(os.environ))
        return (place / "a.so").read_bytes()

    text, number = '#include "a.h"\nint answer(void) { return NUMBER; }\n', "#define NUMBER 42\n"
    first = compiled("one", text, number)
    assert compiled("another", text, number) == first
    assert len((tmp_path / "count").read_text().split()) == 1
    changed = [
        compiled("one", text.replace("answer", "reply"), number),
        compiled("one", text, number.replace("42", "43")),
        compiled("one", text, number, "-O2"),
    ]
    assert first not in changed
    assert len((tmp_path / "count").read_text().split()) == 4
