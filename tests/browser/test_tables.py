"""Tables are sorted and copied, and figures saved, as a reader would."""

from pathlib import Path

from dynident.report.page import Column, PageSection, PageTable, render
from tests.browser.browsing import Browsing
from tests.report.test_page import figure

LONG = "robot_cell_left_manipulator_arm_joint_10_x"
VALUES = ("-1.5e-3", "-", "∞", "12", "≤ 2.8", "1.2e-5", "-40")
SORTED = ("-40", "-1.5e-3", "1.2e-5", "≤ 2.8", "12", "∞", "-")


def table() -> PageTable:
    heads = (Column("joint", numeric=False), Column("error", "all"), *(Column(f"value {k}", "more") for k in range(9)))
    names = (LONG, "=joint_9", *(f"joint_{k}" for k in range(8, 3, -1)))
    return PageTable(heads, tuple((name, x, *"123456789") for name, x in zip(names, VALUES, strict=True)), "errors")


def test_tables_are_sorted_by_value_and_copied_whole_and_figures_are_saved_on_white(
    browse: Browsing, tmp_path: Path
) -> None:
    """On a screen, and then on a phone, where a wide table is shown in parts."""
    path = tmp_path / "page.html"
    path.write_text(render("A <page>", "l", [PageSection("s", (table(), figure("a curve")))]), encoding="utf-8")
    page = browse(path, color_scheme="dark", permissions=["clipboard-read", "clipboard-write"])
    column = "[...document.querySelectorAll('table:not([hidden])')][0].tBodies[0].rows"
    shown = f"[...{column}].map((row) => row.cells[1].dataset.value ?? row.cells[1].textContent.replace('\u2212', '-'))"
    for width in (1280, 400):
        page.set_viewport_size({"width": width, "height": 800})
        page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        assert (page.locator("table:visible").count() > 1) is (width < 600)
        head = page.locator("th:visible", has_text="error").first
        assert page.evaluate(shown) == list(VALUES)
        assert page.get_by_text("1.2\u00a0×\u00a010⁻⁵", exact=True).count() > 0
        head.locator("button").focus()
        page.keyboard.press("Enter")
        assert head.get_attribute("aria-sort") == "ascending"
        assert page.evaluate(shown) == list(SORTED)
        page.keyboard.press("Enter")  # the focus has stayed
        assert head.get_attribute("aria-sort") == "descending"
        assert page.evaluate(shown) == [*SORTED[-2::-1], "-"]
        page.keyboard.press("Enter")
        assert head.get_attribute("aria-sort") is None
        assert page.evaluate(shown) == list(VALUES)
    page.get_by_role("button", name="Copy").click()
    page.get_by_role("button", name="Copied").wait_for()
    lines = page.evaluate("navigator.clipboard.readText()").splitlines()
    assert lines[0].split("\t") == ["joint", "all: error", *(f"more: value {k}" for k in range(9))]
    assert lines[1].split("\t") == [LONG, "-1.5e-3", *"123456789"]
    assert lines[2].split("\t")[0] == "'=joint_9"  # no formula of a spreadsheet
    assert len(lines) == 8
    page.locator("th:visible", has_text="joint").first.locator("button").click()
    names = page.evaluate(f"[...{column}].map((row) => row.cells[0].textContent)")
    assert names == ["=joint_9", *(f"joint_{k}" for k in range(4, 9)), LONG]

    with page.expect_download() as saved:
        page.get_by_role("button", name="Save the figure as SVG").click()
    text = Path(saved.value.path()).read_text(encoding="utf-8")
    assert saved.value.suggested_filename == "A-page-figure-1.svg"
    assert text.startswith("<svg")
    assert "rgb(255, 255, 255)" in text
    assert "rgb(17, 17, 17)" in text
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save the figure as PNG").click()
    assert Path(saved.value.path()).read_bytes().startswith(b"\x89PNG")
