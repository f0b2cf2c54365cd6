"""The failure atlas end to end, in seconds: two rows measured, drawn and written, and the page that is committed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.atlas.page import anchor, page
from benchmarks.atlas.record import FACTS, RECORDS, Row, read_findings, write_csv, write_facts
from benchmarks.atlas.rows import ROWS, named
from benchmarks.atlas.style import drawn, save

PAGE = Path(__file__).resolve().parents[1] / "docs" / "stability"


@pytest.mark.parametrize("names", [["inconsistent-start"], ["inconsistent-start", "elastic-bar"]], ids=len)
def test_a_run_writes_table_figures_and_page(names: list[str], tmp_path: Path) -> None:
    rows = [named(name) for name in names]
    findings = [row.measure(True) for row in rows]
    records = [record for found in findings for record in found.records]
    write_csv(tmp_path / RECORDS, records)
    write_facts(tmp_path / FACTS, findings)
    stored = read_findings(tmp_path, rows)
    assert [record for found in stored for record in found.records] == records
    for row, found in zip(rows, findings, strict=True):
        save(drawn(row, found), tmp_path, row.name)
        assert (tmp_path / f"{row.name}.png").stat().st_size > 10_000
        assert (tmp_path / f"{row.name}.svg").read_text(encoding="utf-8").startswith("<?xml")
    text = page(rows, findings)
    assert page(rows, stored) == text
    assert "All are as expected." in text


def test_the_page_that_is_committed_belongs_to_the_results_beside_it() -> None:
    text = (PAGE / "index.md").read_text(encoding="utf-8")
    assert page(ROWS, read_findings(PAGE, ROWS)) == text, "python -m benchmarks.atlas --page"
    for row in ROWS:
        assert (PAGE / f"{row.name}.png").exists()
        assert (PAGE / f"{row.name}.svg").exists()


@pytest.mark.parametrize(("number", "row"), list(enumerate(ROWS, 1)), ids=[row.name for row in ROWS])
def test_the_page_has_the_fixed_sections_of_a_row(number: int, row: Row) -> None:
    text = (PAGE / "index.md").read_text(encoding="utf-8")
    start = text.index(f"## {number}. {row.title}\n")
    following = text.find("\n## ", start + 1)
    section = text[start : None if following < 0 else following]
    leads = re.findall(r"^(!\[|\*\*\w+\.\*\*)", section, re.MULTILINE)
    assert leads == ["![", "**Survives.**", "**Limits.**"]
    assert f"({anchor(number, row)})" in text
