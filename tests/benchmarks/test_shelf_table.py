"""The documentation's table of the shelf is made from the stored figures."""

from pathlib import Path

import pytest

from benchmarks.shelf import END, START, with_table
from graycast.rig.shelf import SHELF, measured

PAGE = Path(__file__).resolve().parents[2] / "docs/reference/shelf.md"


@pytest.mark.slow
def test_the_page_shows_the_stored_figures():
    page = PAGE.read_text()
    assert with_table(page, measured().scanners) == page


def test_the_table_has_a_row_for_each_scanner_and_the_rest_of_the_page_is_kept():
    text = with_table(f"before {START} old {END} after", {})
    assert text.startswith(f"before {START}") and text.endswith(f"{END} after")
    rows = [line for line in text.splitlines() if line.startswith("| `")]
    assert [row.split("`")[1] for row in rows] == list(SHELF)
    assert {row.count("|") for row in rows} == {10}
