"""Numbers with powers of ten are sorted by their value, as they were written."""

from __future__ import annotations

from pathlib import Path

from dynident.report.page import Column, PageSection, PageTable, render
from tests.browser.browsing import Browsing


def test_powers_of_ten_are_sorted_by_value(browse: Browsing, tmp_path: Path) -> None:
    rows = (("a", "9.5e-8"), ("b", "2.1e-5"), ("c", "0.3"), ("d", "-4e-6"))
    table = PageTable((Column("name", numeric=False), Column("value")), rows, "Values")
    path = tmp_path / "table.html"
    path.write_text(render("Title", "Lead", [PageSection("One", (table,))]), encoding="utf-8")
    page = browse(path)
    cells = "[...document.querySelectorAll('tbody td.number')].map(one => one.textContent)"
    assert page.evaluate(cells)[1] == "2.1\u00a0×\u00a010⁻⁵"
    page.locator("thead th", has_text="value").first.click()
    found = page.evaluate("[...document.querySelectorAll('tbody tr')].map(row => row.cells[0].textContent)")
    assert found in (list("dabc"), list("cbad"))
