"""The failure atlas end to end, in seconds: two rows measured, drawn and written, and the page that is committed."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.atlas.page import anchor, page, table  # noqa: E402
from benchmarks.atlas.record import Row, read_csv, write_csv  # noqa: E402
from benchmarks.atlas.rows import ROWS, named  # noqa: E402
from benchmarks.atlas.style import drawn, save  # noqa: E402

PAGE = ROOT / "docs" / "stability"


def test_a_run_writes_table_figures_and_page(tmp_path: Path) -> None:
    rows = [named("inconsistent-start"), named("elastic-bar")]
    findings = [row.measure(True) for row in rows]
    records = [record for found in findings for record in found.records]
    write_csv(tmp_path / "results.csv", records)
    assert read_csv(tmp_path / "results.csv") == records
    for row, found in zip(rows, findings, strict=True):
        save(drawn(row, found), tmp_path, row.name)
        assert (tmp_path / f"{row.name}.png").stat().st_size > 10_000
        assert (tmp_path / f"{row.name}.svg").read_text(encoding="utf-8").startswith("<?xml")
    text = page(rows, findings)
    assert table(findings[1].records) in text
    assert "All are as expected." in text


def test_the_page_that_is_committed_shows_the_table_that_is_committed() -> None:
    text = (PAGE / "index.md").read_text(encoding="utf-8")
    records = read_csv(PAGE / "results.csv")
    for row in ROWS:
        assert table(each for each in records if each.row == row.name) in text
        assert (PAGE / f"{row.name}.png").exists()
        assert (PAGE / f"{row.name}.svg").exists()


@pytest.mark.parametrize(("number", "row"), list(enumerate(ROWS, 1)), ids=[row.name for row in ROWS])
def test_the_page_has_the_fixed_sections_of_a_row(number: int, row: Row) -> None:
    text = (PAGE / "index.md").read_text(encoding="utf-8")
    start = text.index(f"## {number}. {row.title}\n")
    following = text.find("\n## ", start + 1)
    section = text[start : None if following < 0 else following]
    headings = re.findall(r"^### (.*)$", section, re.MULTILINE)
    assert headings == ["What fails", "What was seen", "What survives", "Its limit"]
    assert f"({anchor(number, row)})" in text


def test_files_and_functions_of_the_atlas_are_short() -> None:
    for path in sorted((ROOT / "benchmarks" / "atlas").glob("*.py")):
        assert len(path.read_text(encoding="utf-8").splitlines()) < 400, path.name
