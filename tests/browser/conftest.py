"""One browser for all tests of this folder, and pages that are watched.

Its scope is the folder's: as long as it runs, its event loop would be in the way of tests that start one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from tests.browser.browsing import CHROMIUM, Browsing, executable

if TYPE_CHECKING:
    from playwright.sync_api import Browser

# as root, in a container, with 3-D drawn by the processor; no name is looked up
SWITCHES = (
    *("--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"),
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost",
)


@pytest.fixture(scope="package")
def chromium() -> Iterator[Browser]:
    """The browser of this machine; without one, or without playwright, these tests are skipped."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (extra dev)")
    if (path := executable()) is None:
        pytest.skip(f"no Chromium: install it (on Debian: apt install chromium), or name one in {CHROMIUM}")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=SWITCHES)
        yield browser
        browser.close()


@pytest.fixture
def browse(chromium: Browser) -> Iterator[Browsing]:
    """Opens pages; at the end of a test none of them may have complained."""
    browsing = Browsing(chromium)
    yield browsing
    browsing.close()
    assert browsing.complaints == []
