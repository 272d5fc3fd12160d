"""Every kind of page: nothing is cut on a screen, a phone or paper, and everybody can read it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from dynident.apps.article import study_page
from dynident.apps.excitation.report import excitation_page
from dynident.apps.fleets.report import fleet_page
from dynident.apps.ranking.page import ranking_page
from dynident.report.identification import identification_page
from tests.browser.browsing import Browsing
from tests.report.conftest import Reproduction, cases, identification_of, motion
from tests.report.designs import designed
from tests.report.fleets import fleet
from tests.report.rankings import ranking

if TYPE_CHECKING:
    from playwright.sync_api import Page

LONG = tuple(f"robot_cell_left_manipulator_arm_joint_{k}_x" for k in range(2))
# what is wider than its place: of the page, of tables, and of texts
CUT = """() => {
  const width = document.documentElement.clientWidth;
  const shown = [...document.querySelectorAll("main *")].filter((one) => one.offsetParent && !one.closest(".plot"));
  const beyond = shown.filter((one) => one.getBoundingClientRect().right > width + 1);
  const scrolled = shown.filter((one) => one.matches(".scroll, pre") && one.scrollWidth > one.clientWidth + 1);
  return [...beyond, ...scrolled].map((one) => `${one.tagName} ${one.className} ${one.textContent.slice(0, 60)}`);
}"""


def report() -> str:
    return identification_page(identification_of(LONG, ("swing.csv", "reach.csv")))


def study() -> str:
    return study_page(Reproduction(tuple(cases()), {"simulated": motion(start=0.0), "spline": motion(noise=0.05)}))


PAGES: dict[str, Callable[[], str]] = {
    "report": report,
    "study": study,
    "fleet": lambda: fleet_page(fleet(3, 6, LONG[0])),
    "ranking": lambda: ranking_page(ranking(4, 4, LONG[0])),
    "excitation": lambda: excitation_page(*designed()),
}


def settled(page: Page) -> None:
    """Open all folds, draw what is in view, and wait for the tables to be fitted."""
    page.evaluate("document.querySelectorAll('details').forEach((one) => (one.open = true))")
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


@pytest.mark.parametrize("name", PAGES)
def test_nothing_is_cut_and_all_can_read_it(browse: Browsing, tmp_path: Path, name: str) -> None:
    path = tmp_path / f"{name}.html"
    path.write_text(PAGES[name](), encoding="utf-8")
    page = browse(path)
    settled(page)
    assert page.evaluate(CUT) == []
    page.emulate_media(color_scheme="dark")  # of both schemes the contrasts are known by tests/report/test_canvas.py
    page.set_viewport_size({"width": 400, "height": 800})
    settled(page)
    assert page.evaluate(CUT) == []
    # the slowest rule: all kinds share the colours of the report
    assert browse.barriers(page, {"color-contrast": name == "report"}) == []
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 680, "height": 900})
    assert page.evaluate(CUT) == []
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    inks = "[...new Set([...document.querySelectorAll('.js-plotly-plot')].map((one) => one.layout.font.color))]"
    assert page.evaluate(inks) in ([], ["#111111"])
