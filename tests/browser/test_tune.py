"""The page of ``dynident tune`` as a person uses it: what it shows follows what is set, and the address keeps it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote_plus

import numpy as np
import pytest

from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Viscous
from tests.apps.tuning.arms import recording
from tests.browser.browsing import Browsing
from tests.robots import joint, link, urdf

pytest.importorskip("dash")

if TYPE_CHECKING:
    from playwright.sync_api import Page

HOSTILE = "<img src=x onerror=alert(1)>"
QUOTED = HOSTILE.replace("<", "&lt;").replace(">", "&gt;")
CONFIG = f"""\
# an arm of two joints
model: {{ file: arm.urdf, terms: [viscous, coulomb] }}
time: {{ column: t, unit: s }}
position: {{ elbow: {{ column: q, unit: rad }}, "{HOSTILE}": {{ column: p, unit: rad }} }}
torque: {{ elbow: {{ column: u, unit: N m }}, "{HOSTILE}": {{ column: w, unit: N m }} }}
train: [ {{ file: monday.npz }} ] # the longer one
validation: [ {{ file: tuesday.npz }} ]
time_offset: 0
smoother: {{ kind: spline }}
"""


def recorded(path: Path, seed: int) -> None:
    """Write a recording of the arm with its noise."""
    bodies = RigidBodies(path.with_name("arm.urdf").read_text())
    model = Model((bodies, Viscous(bodies.joints), Coulomb(bodies.joints)))
    theta = np.array([0.4 if parameter.value is None else parameter.value for parameter in model.parameters])
    log = recording(seed, 4.0, model=model, theta=theta)
    columns = dict(zip("qpuw", (*log.q.T, *log.tau.T), strict=True))
    np.savez(path, t=log.t, temperature=20 + 0.1 * log.t, **columns)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An arm, two recordings, and the configuration of both."""
    made = tmp_path_factory.mktemp("tune")
    parts = [link("base", 1.0)]
    for name, parent, child in (("elbow", "base", "upper"), (QUOTED, "upper", "lower")):
        parts += [link(child, 1.0, (0.1, 0, 0), tensor=np.diag([0.02, 0.02, 0.02]))]
        parts += [joint(name, "revolute", parent, child, (0.3, 0, 0), axis=(0, 1, 0))]
    (made / "arm.urdf").write_text(urdf(*parts))
    (made / "arm.yaml").write_text(CONFIG)
    recorded(made / "monday.npz", 0)
    recorded(made / "tuesday.npz", 1)
    return made


@contextmanager
def served(path: Path) -> Iterator[str]:
    """Give the address of the page of a configuration."""
    from dynident.apps.tuning import serve_configuration
    from dynident.apps.tuning.server import answer

    faults: list[str] = []
    with serve_configuration(path, fault=faults.append) as (address, server):
        thread = threading.Thread(target=answer, args=(server,), daemon=True)
        thread.start()
        yield str(address)
        server.shutdown()
        thread.join()
    assert faults == []


@pytest.fixture(scope="module")
def address(folder: Path) -> Iterator[str]:
    with served(folder / "arm.yaml") as case:
        yield case


def identified(page: Page) -> None:
    """Wait until all has come: curves, quick fit and verdict."""
    page.wait_for_selector("#verdict .badge")
    page.wait_for_selector("#motion .main-svg")
    page.wait_for_selector("#torque .main-svg")


def settled(page: Page, before: str) -> str:
    """Wait until the address has changed and the fit of it is shown; return what it asks for."""
    decoded = "decodeURIComponent(location.search.replaceAll('+', ' '))"  # as this function returns it
    page.wait_for_function(f"before => {decoded} !== before", arg=before)
    page.wait_for_function("JSON.parse(sessionStorage.getItem('last'))?.now === location.search")
    return unquote_plus(page.evaluate("location.search"))


def drawn(page: Page, trace: int = 4) -> str:
    return page.evaluate(
        f"String(document.querySelector('#motion .js-plotly-plot')._fullData[{trace}].y.slice(300, 320))"
    )


def test_after_a_wrong_address_curves_and_fit_follow_the_slider_and_a_new_file_is_saved(
    browse: Browsing, address: str, folder: Path
) -> None:
    page, config = browse(f"{address}?degree=much", bypass_csp=True), folder / "arm.yaml"
    page.wait_for_selector("#complaint:has-text('degree is \\'much\\', which is no JSON')")
    page.click("text=Start again")
    identified(page)
    assert page.url == address
    before, acceleration, error = config.read_text(), drawn(page), page.inner_text("#numbers")
    page.press("#degree", "ArrowRight")
    page.wait_for_selector("#degree-words:has-text('S/n = 1.05')")
    assert settled(page, "") == "?degree=[0.02,0.02]"
    page.click("#keep")
    page.fill("#degree", "1.2")
    assert settled(page, "?degree=[0.02,0.02]") == "?degree=[1.2,1.2]"
    assert drawn(page) != acceleration
    assert page.inner_text("#numbers") != error
    assert "smoothing of all joints: S/n = 1.00 → S/n = 15.8" in page.inner_text("#unsaved")
    for figure in ("torque", "loop"):
        page.wait_for_function(
            f"document.querySelector('#{figure} .js-plotly-plot').textContent.includes('other setting')"
        )
    column = page.locator("input[list=columns]")
    column.fill("temperature")
    column.press("Enter")
    page.wait_for_function("document.querySelector('#motion .js-plotly-plot').data.at(-1).name === 'temperature'")
    page.go_back()
    assert settled(page, "") == "?degree=[1.2,1.2]"
    page.click("#keep")
    page.wait_for_selector("#marks button")
    page.wait_for_selector("#verdict .badge")

    page.reload()
    identified(page)
    assert page.input_value("#degree") == "1.2"
    page.click("#save")
    page.wait_for_selector("#saved:has-text('Saved in arm-tuned.yaml.')")
    assert "factor: 3.98" in (folder / "arm-tuned.yaml").read_text()
    assert config.read_text() == before
    page.click("text=Start again")
    assert settled(page, "?degree=[1.2,1.2]") == ""
    page.wait_for_function("document.querySelector('#degree').value === '0'")
    page.wait_for_selector("#saved", state="hidden")


def test_tabs_are_apart_hostile_names_are_text_and_all_can_read(browse: Browsing, address: str) -> None:
    """On a screen a window is left out by dragging; on a phone in the dark a term is switched, of a hostile joint."""
    page = browse(address, bypass_csp=True)
    phone = browse(address, width=400, color_scheme="dark")  # as it comes: no script of another may run
    identified(page)
    page.click("#dragging")
    place = page.locator("#motion .nsewdrag").first.bounding_box()
    x, y = place["x"] + 0.3 * place["width"], place["y"] + 0.5 * place["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 40, y + 5, steps=4)
    page.mouse.move(x + 80, y + 5, steps=4)
    page.mouse.up()
    search = settled(page, "")
    assert search.startswith('?excluded=[["monday",')
    assert "monday: " in page.inner_text("#windows")
    page.wait_for_function("document.querySelector('#motion .js-plotly-plot').layout.shapes.length === 1")

    identified(phone)
    phone.click(f"[aria-label='Joint'] button[title='{HOSTILE}']")
    phone.wait_for_selector("#torque-name:has-text('<img src=x onerror')")
    phone.wait_for_selector("#errors tr.here:has-text('<img src')")
    phone.click("text=this joint")
    phone.click("button:has-text('stribeck')")
    phone.wait_for_url(
        lambda url: 'terms=[["viscous","coulomb"],["viscous","coulomb","stribeck"]]' in unquote_plus(url)
    )
    assert "exclude" not in phone.url
    assert page.inner_text("#windows").startswith("monday")
    for tab in (page, phone):
        identified(tab)  # what still comes draws the button anew
    page.click("text=use again")
    assert settled(page, search) == ""
    assert browse.barriers(phone) == []
    for width, scheme in ((400, "dark"), (1280, "light")):
        phone.set_viewport_size({"width": width, "height": 800})
        phone.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
        phone.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        assert phone.locator("img").count() == 0
        assert phone.evaluate("document.documentElement.scrollWidth") <= width
