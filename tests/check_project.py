"""What `make check` asks of the project's own rules: sizes, names, spelling, links of pages. Nothing is computed."""

from __future__ import annotations

import ast
import inspect
import io
import re
import subprocess
import tokenize
import tomllib
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path

import concerned
import pytest
from present import present

import servocore as sc

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PACKAGES = ("servocore", "crane_fmu", "benchmarks")
COMMAND_LINE = ("choices", "command", "console", "interruption", "kinds", "options", "run_summary")
SHARED_MODULES = {"servocore.cli", "servocore.files", "servocore.planning.durations"}
SHARED_MODULES |= {f"servocore.cli.{name}" for name in COMMAND_LINE}
"""Modules of servocore without public names that crane_fmu may import."""
LONGEST_FUNCTION, LONGEST_FILE = 60, 400
NUMERICAL_PACKAGES = ("formulations", "methods", "numerics", "solvers", "stepping", "structure")
LEAST_COMMENTS = 2  # per hundred lines that are not blank
CODE_BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
PUBLIC = [(name, getattr(sc, name)) for name in sc.__all__]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
SOURCES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def short(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def tracked_texts() -> Iterator[tuple[str, str]]:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listed.returncode:
        pytest.skip("not a git clone")
    for name in filter(None, listed.stdout.decode().split("\0")):
        path = ROOT / name
        if path.suffix in {".png", ".ico", ".fmu"} or not path.exists():
            continue
        yield name, path.read_text(encoding="utf-8")


# Code ----------------------------------------------------------------------------------------------------------------


def test_files_are_short() -> None:
    lengths = {short(path): len(path.read_text(encoding="utf-8").splitlines()) for path in SOURCES}
    assert {name: length for name, length in lengths.items() if length >= LONGEST_FILE} == {}


def test_functions_are_short() -> None:
    lengths = {
        f"{short(path)}:{node.lineno} {node.name}": lines_without_docstring(node)
        for path in SOURCES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    }
    assert {name: length for name, length in lengths.items() if length >= LONGEST_FUNCTION} == {}


def lines_without_docstring(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    first = node.body[0]
    length = present(node.end_lineno) - node.lineno + 1
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str):
        length -= present(first.end_lineno) - first.lineno + 1
    return length


@pytest.mark.parametrize("package", NUMERICAL_PACKAGES)
def test_a_numerical_package_is_commented(package: str) -> None:
    comments = lines = 0
    for path in (ROOT / "servocore" / package).glob("*.py"):
        text = path.read_text(encoding="utf-8")
        comments += sum(is_comment(each) for each in tokenize.generate_tokens(io.StringIO(text).readline))
        lines += sum(bool(line.strip()) for line in text.splitlines())
    assert 100 * comments >= LEAST_COMMENTS * lines, f"{comments} comments in {lines} lines"


def is_comment(token: tokenize.TokenInfo) -> bool:
    """Whether a token is a comment for readers, not one for a tool."""
    return token.type == tokenize.COMMENT and not re.match(r"# *(noqa|type:|fmt:|-{3})", token.string)


def test_crane_fmu_uses_public_names_of_servocore_only() -> None:
    strangers = [
        f"{short(path)}:{vars(node)['lineno']} {name}"
        for path in (ROOT / "crane_fmu").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        for name in used_names(node)
        if name not in SHARED_MODULES.union(sc.__all__) and not name.startswith("__")
        # an FMU around an exported model, and a system of them, are packed from its parts
        if not (path.parent.name == "build" and name.startswith("servocore.export."))
    ]
    assert strangers == []


def used_names(node: ast.AST) -> list[str]:
    """Return what a node takes out of servocore, written ``sc`` where it is imported whole."""
    if isinstance(node, ast.ImportFrom) and node.module == "servocore":
        return [each.name for each in node.names]
    if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("servocore."):
        return [node.module]
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "sc":
        return [node.attr]
    return []


OXFORD = re.compile(  # stems that take -ize; other words do not: otherwise, precise, revise
    r"(?<![a-z])(discreti|emphasi|factori|generali|initiali|lineari|minimi|maximi|normali|optimi|organi|parametri|penali"
    r"|recogni|regulari|seriali|stabili|summari|symmetri|synchroni|utili|vectori|visuali)s(e|ing|ation|able)",
    re.IGNORECASE,
)
PUBLIC_SPELLING = re.compile(r"\b(generali[sz]e|[Dd]iscretis(e|ation)|factorizations|linearized?)\b|emphasis")


def test_words_are_spelled_as_in_oxford() -> None:
    """With -ize where the ending is Greek, but analyse; public names, former ones too, keep theirs."""
    covered = ("servocore/", "crane_fmu/", "docs/", "examples/", "tests/", "README.md", "CONTRIBUTING.md")
    wrong = [
        f"{name}: {word[0]}"
        for name, text in tracked_texts()
        if name.startswith(covered) and not name.endswith((".svg", "0110-words.md", "check_project.py"))
        for word in OXFORD.finditer(PUBLIC_SPELLING.sub("", text))
    ]
    assert wrong == []


DIALECT = re.compile(
    r"""(?:^|[.:;(] |\"\"\"(?:Return |Say )?)(?:what|who|whoever|nobody|whatever|that which) [a-z]+"""
    r"""|\bReturn what\b|\bsay what\b|\bof late\b|\bfor ever\b|\b(?:is|was|are|were|been) told\b|stands? on its head"""
    r"""|nobody asked|\bin vain\b|\bby itself\b, the|\bas it is told\b""",
    re.IGNORECASE | re.MULTILINE,
)
MOST_DIALECT = 40
"""Phrases of a private dialect: sentences that begin with a relative clause, code that is told something.

Readers look for the terms of the field and for a subject; a few are right, in questions for instance."""


def test_sentences_are_those_of_the_field() -> None:
    rooms = ("README.md", "CONTRIBUTING.md", "docs/", "servocore/", "crane_fmu/", "demands/")
    texts = (".md", ".py", ".j2", ".h", ".c", ".js")
    found = [
        f"{name}: {phrase[0].strip()}"
        for name, text in tracked_texts()
        if name.startswith(rooms) and name.endswith(texts) and "/decisions/" not in name
        for phrase in DIALECT.finditer(text)
    ]
    assert len(found) <= MOST_DIALECT, found


def test_nothing_mentions_the_machine_it_was_written_on() -> None:
    places = ("/" + "work/", "/" + "home/", "/" + "root/", "share" + "d/design", "share" + "d/theory", "bash" + "_jobs")
    found = [f"{name} mentions {place}" for name, text in tracked_texts() for place in places if place in text]
    assert found == []


# Public names --------------------------------------------------------------------------------------------------------


def exported_by(attribute: str, argument: str) -> list[str]:
    return [
        name
        for name, value in PUBLIC
        if inspect.isclass(value) and hasattr(value, attribute) and not getattr(value, "_is_protocol", False)
        if argument in inspect.signature(getattr(value, attribute)).parameters
    ]


@pytest.mark.parametrize("name", [*exported_by("dae", "system"), *exported_by("discretize", "dae")])
def test_a_formulation_or_method_is_explained(name: str) -> None:
    assert f"`{name}`" in (DOCS / "theory.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", sc.scenes.REGISTRY)
def test_a_scene_has_a_sketch_a_closed_form_and_a_place_among_the_pages(name: str) -> None:
    factory = sc.scenes.REGISTRY[name]
    text = present(present(inspect.getmodule(factory)).__doc__)
    drawn = [line for line in text.splitlines() if line.startswith("    ") and re.search(r"[|/\\=\[]", line)]
    assert len(drawn) >= 3, "the head of its file has no sketch"
    assert factory().closed_form is not None or "closed form" in text, "neither a closed form nor a reason"
    assert f"`{name}`" in (DOCS / "scenes.md").read_text(encoding="utf-8")


def test_every_public_name_has_its_place_in_the_api_reference() -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.rst"))
    listed = re.findall(r"^(?:   |\.\. autodata:: )(?:servocore\.)?(?:scenes\.)?(\w+)$", pages, re.MULTILINE)
    assert set(sc.__all__).union(sc.scenes.REGISTRY, {"REGISTRY", "from_file"}) ^ set(listed) == {"scenes"}
    assert [name for name in set(listed) if listed.count(name) > 1] == []


def test_public_functions_that_take_a_path_take_it_as_text_too() -> None:
    public = [getattr(sc, name) for name in sc.__all__]
    functions: list[Callable[..., object]] = [each for each in public if inspect.isfunction(each)]
    functions += [value for each in public if inspect.isclass(each) for _, value in inspect.getmembers(each, callable)]
    given = []
    for function in functions:
        of_paths = [text for text in getattr(function, "__annotations__", {}).items() if "Path" in str(text[1])]
        given += [(function.__qualname__, name, str(text)) for name, text in of_paths if name != "return"]
    assert len(given) >= 8
    assert [each for each in given if "str" not in each[2]] == []


def test_every_story_of_the_gallery_tells_its_title_and_runs_in_the_site() -> None:
    stories = sorted((ROOT / "examples").glob("story_*.py"))
    assert len(stories) >= 8
    for story in stories:
        title, line = story.read_text(encoding="utf-8").splitlines()[1:3]
        assert line == "=" * len(title), f"{story.name}: the title is not underlined"


def test_the_table_of_concerned_tests_names_modules_and_test_files_that_exist() -> None:
    tests = chain.from_iterable(concerned.table().values())
    names = {*concerned.table(), *(f"tests/{name.partition('::')[0]}" for name in tests)}
    assert [name for name in names if not (ROOT / name).is_file()] == []


# Pages ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES, ids=short)
def test_links_of_a_page_lead_somewhere(page: Path) -> None:
    text = CODE_BLOCK.sub("", page.read_text(encoding="utf-8"))
    targets = re.findall(r"\]\((?!https?://)([^)#]+)", text)
    assert [target for target in targets if not (page.parent / target).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=short)
def test_rows_of_a_table_have_the_cells_of_its_heading(page: Path) -> None:
    """A bar in a cell, as in the magnitude of M_b, is escaped."""
    text = re.sub(r"^ *```.*?^ *```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    tables = [found.splitlines() for found in re.findall(r"(?:^ *\|.*\n)+", text, re.MULTILINE)]
    bars = [[len(re.findall(r"(?<!\\)\|", row)) for row in table] for table in tables]
    assert [table[0] for table, counts in zip(tables, bars, strict=True) if len(set(counts)) > 1] == []


def test_the_index_names_every_page() -> None:
    index = "".join((DOCS / name).read_text(encoding="utf-8") for name in ("index.md", "development.md"))
    pages = [path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md") if path.name != "index.md"]
    pages = [page for page in pages if not page.startswith("site/")]  # nothing of their own: what only the site shows
    assert [page for page in pages if f"({page})" not in index] == []


def test_sections_of_the_theory_that_are_referred_to_exist() -> None:
    sections = set(re.findall(r"^## (\d+)\.", (DOCS / "theory.md").read_text(encoding="utf-8"), re.MULTILINE))
    wanted = {
        (name, number)
        for name, text in tracked_texts()
        for number in re.findall(r"theory(?:\.md)?\]?(?:\([^)]*\))?,? section (\d+)", text)
    }
    assert {each for each in wanted if each[1] not in sections} == set()


# Versions ------------------------------------------------------------------------------------------------------------


def test_all_say_the_same_version_and_the_changelog_has_an_entry_for_it() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert sc.__version__ == project["version"]
    assert f"\nversion: {sc.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    entry = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split(f"## [{sc.__version__}]")
    assert len(entry) == 2
    assert re.search(r"^\* \w", entry[1], re.MULTILINE)


def test_every_target_of_the_makefile_explains_itself() -> None:
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = present(re.search(r"^\.PHONY: (.*)$", text, re.MULTILINE))[1].split()
    assert [each for each in targets if not re.search(rf"^{each}:.*## \w", text, re.MULTILINE)] == []
