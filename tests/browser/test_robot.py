"""The robot in a report: it moves with the slider, the keyboard and the figures over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from dynident.estimators import PhysicallyConsistent
from dynident.report.identification import identification_page
from tests.browser.browsing import Browsing
from tests.report.robots import identified, tree

if TYPE_CHECKING:
    from playwright.sync_api import Page

VIEW = ".plot:has(~ .player)"
TORQUE = ".view:not([hidden]) .plot"
HAND = "[...document.querySelectorAll('.plot')].find((one) => one.parentElement.querySelector('.player'))"


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("robot") / "report.html"
    path.write_text(identification_page(identified(PhysicallyConsistent())), encoding="utf-8")
    return path


def until(page: Page, condition: str) -> None:
    """Wait for a condition; the policy of the page forbids playwright's own way."""
    for _ in range(200):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(50)
    raise AssertionError(condition)


def drawn(page: Page) -> None:
    """Wait until the robot and the torques beside it are drawn."""
    page.locator(VIEW).first.scroll_into_view_if_needed()
    until(page, "document.querySelector('.player')?.hidden === false")
    page.wait_for_selector(f".beside {TORQUE} .cursor", state="attached")


def shown(page: Page) -> float:
    return float(page.locator(".player output").inner_text().split()[0])


def vertices(page: Page, *traces: int) -> list[np.ndarray]:
    """What the view draws of bodies, once it has come to rest."""
    page.wait_for_timeout(300)
    result = page.evaluate(
        f"(traces) => traces.map((k) => ['x', 'y', 'z'].map((axis) => [...{HAND}._fullData[k][axis]]))", traces
    )
    return [np.array(x).T for x in result]


def at(t: float, log: int) -> tuple[np.ndarray, np.ndarray]:
    """Where the hand is at a time of a log, by the robot itself."""
    motion = identified(PhysicallyConsistent()).validations[log].motion
    q = np.array([[np.interp(t, motion.t, x) for x in motion.q.T]])
    placed = tree().placements(q)
    return placed.rotations[0, 2], placed.origins[0, 2]


def hidden(page: Page) -> int:
    return page.evaluate(f"{HAND}.data.filter((one) => one.visible === false).length")


def same(page: Page, first: np.ndarray, time: float, log: int) -> None:
    """The hand has moved from its ``first`` vertices to where it is at that time."""
    (R0, p0), (R, p) = at(0.0, 1), at(time, log)
    np.testing.assert_allclose(vertices(page, 2)[0], ((first - p0) @ R0) @ R.T + p, atol=2e-2)


def test_the_arm_the_slider_and_the_torques_move_together(browse: Browsing, report: Path) -> None:
    page = browse(report)
    drawn(page)
    (first,) = vertices(page, 2)
    slider, cursor = page.locator(".player input"), page.locator(f".beside {TORQUE} .cursor")
    slider.evaluate("(one) => { one.value = 200; one.dispatchEvent(new Event('input')); }")
    assert shown(page) == pytest.approx(2.8, abs=0.01)
    same(page, first, 2.796, 1)
    box = page.locator(f".beside {TORQUE} .nsewdrag").first.bounding_box()
    line = cursor.bounding_box()
    assert line["x"] == pytest.approx(box["x"] + 0.4 * box["width"], abs=2)
    slider.focus()
    page.keyboard.press("ArrowRight")
    assert shown(page) > 2.8
    assert cursor.bounding_box()["x"] >= line["x"]
    assert "of tuesday (held out)" in slider.get_attribute("aria-valuetext")
    page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + box["height"] / 2)  # points at the torque
    until(page, "parseFloat(document.querySelector('.player output').value) > 5")
    time = shown(page)
    assert time == pytest.approx(0.75 * 6.99, abs=0.1)
    same(page, first, time, 1)
    page.get_by_role("button", name="monday (training)").first.click()  # another log, at the same time
    assert shown(page) == pytest.approx(time, abs=0.01)
    same(page, first, time, 0)
    assert page.locator(f".beside {TORQUE} .cursor").is_visible()

    page.set_viewport_size({"width": 400, "height": 800})
    until(page, "document.documentElement.scrollWidth <= 400")
    play, inertia = page.locator(".player button").all()
    play.click()
    until(page, f"parseFloat(document.querySelector('.player output').value) > {time + 0.1}")
    play.click()
    inertia.click()
    assert hidden(page) == 0
    result, *links = vertices(page, 4, 0, 1, 2, 3)
    assert np.linalg.norm(result.mean(axis=0) - np.concatenate(links).mean(axis=0)) < 0.5
    inertia.click()
    assert hidden(page) == 4
