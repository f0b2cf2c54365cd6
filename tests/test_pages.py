"""Python blocks of the pages run one after another, and the README's prints what the README says."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
pytestmark = pytest.mark.usefixtures("empty_folder")
CODE_BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]


def short(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("page", [p for p in PAGES if CODE_BLOCK.search(p.read_text(encoding="utf-8"))], ids=short)
def test_python_blocks_of_a_page_run_one_after_another(page: Path, tmp_path: Path) -> None:
    shutil.copy(ROOT / "examples" / "ur5.urdf", tmp_path)
    names: dict[str, object] = {"__name__": "page"}
    text = page.read_text(encoding="utf-8")
    for block in CODE_BLOCK.finditer(text):
        run(block[1], page, text[: block.start(1)].count("\n"), names)


def run(block: str, page: Path, line: int, names: dict[str, object]) -> None:
    """Run a block as if it stood alone, with line numbers of its page."""
    exec(compile("\n" * line + block, str(page), "exec", dont_inherit=True), names)


def test_the_readme_example_has_ten_lines_and_prints_what_the_readme_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (block,) = CODE_BLOCK.findall(text)
    assert len([line for line in block.splitlines() if line]) <= 10
    run(block, ROOT / "README.md", 0, {})
    assert f"`{capsys.readouterr().out.strip()}`" in text
    assert (tmp_path / "inputs.csv").read_text(encoding="utf-8").startswith("time,M_b,F,M_w\n")
