"""The harness sees what it is there to see."""

from pathlib import Path

import pytest

from tests.browser.browsing import Browsing, is_local


@pytest.mark.parametrize(
    ("address", "local"),
    [
        ("file:///tmp/report.html", True),
        ("http://127.0.0.1:8050/x", True),
        ("http://localhost:1/", True),
        ("http://[::1]:1/", True),
        ("data:image/png;base64,AA", True),
        ("blob:null/1-2", True),
        ("https://cdn.example.org/plotly.js", False),
        ("http://127.0.0.1.example.org/", False),
        ("wss://example.org/", False),
    ],
)
def test_what_leaves_the_machine(address: str, local: bool) -> None:
    assert is_local(address) is local


def test_complaints_are_noted(browse: Browsing, tmp_path: Path) -> None:
    path = tmp_path / "bad.html"
    script = 'console.error("wrong"); fetch("https://example.org/x").catch(() => 0); setTimeout(() => nothing(), 0)'
    path.write_text(f'<html lang="en"><title>t</title><img src="data:,"><script>{script}</script></html>')
    page = browse(path)
    page.wait_for_function("performance.now() > 200")
    heard, browse.complaints[:] = sorted(browse.complaints), []
    assert [x.split(":")[0] for x in heard] == ["console", "console", "exception", "request"]
    assert "console: wrong" in heard
    assert heard[2] == "exception: nothing is not defined"
    assert heard[3] == "request: https://example.org/x"
    assert [barrier.split(":")[0] for barrier in browse.barriers(page)] == ["image-alt"]
