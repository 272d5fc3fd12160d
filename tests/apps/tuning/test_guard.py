"""Nobody but the page itself is answered."""

from __future__ import annotations

from typing import Any

import pytest

from dynident.apps.tuning.server import RequestGuard, make_content_policy

HOST = "127.0.0.1:8050"
OWN = {"REQUEST_METHOD": "GET", "HTTP_HOST": HOST, "PATH_INFO": "/secret/alive"}


def asked(**changes: str | None) -> tuple[str, dict[str, str], bytes]:
    """Ask an application behind its guard; return status, headers and body."""
    heard: list[Any] = []

    def inner(environ: dict[str, Any], start: Any) -> list[bytes]:
        start("200 OK", [("Content-Type", "text/html"), ("Cache-Control", environ.get("cache", "no-cache"))])
        return [b"inside"]

    given = {name: value for name, value in (OWN | changes).items() if value is not None}
    body = b"".join(RequestGuard(inner, 8050, "secret", make_content_policy())(given, lambda *told: heard.extend(told)))
    return heard[0], dict(heard[1]), body


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"HTTP_HOST": "localhost:8050"},
        {"HTTP_ORIGIN": "http://127.0.0.1:8050", "REQUEST_METHOD": "POST", "CONTENT_LENGTH": "20"},
        {"HTTP_SEC_FETCH_SITE": "same-origin", "REQUEST_METHOD": "POST"},
        {"HTTP_SEC_FETCH_SITE": "none"},
        {"HTTP_SEC_FETCH_SITE": "same-site", "HTTP_SEC_FETCH_MODE": "navigate"},
    ],
)
def test_the_page_is_answered(changes: dict[str, str]) -> None:
    status, headers, body = asked(**changes)
    assert (status, body) == ("200 OK", b"inside")
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["Cache-Control"] == "no-store"


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"HTTP_HOST": "evil.example:8050"}, "403"),  # a name that was bound anew to the loopback
        ({"HTTP_HOST": None}, "403"),
        ({"HTTP_HOST": "127.0.0.1:8051"}, "403"),
        ({"HTTP_HOST": "127.0.0.1:8050,evil.example"}, "403"),
        ({"HTTP_ORIGIN": "https://evil.example"}, "403"),
        ({"HTTP_ORIGIN": "null"}, "403"),
        ({"HTTP_ORIGIN": "http://127.0.0.1:8888"}, "403"),
        ({"HTTP_SEC_FETCH_SITE": "cross-site"}, "403"),
        ({"HTTP_SEC_FETCH_SITE": "cross-site", "HTTP_SEC_FETCH_MODE": "navigate"}, "403"),
        ({"HTTP_SEC_FETCH_SITE": "same-site", "REQUEST_METHOD": "POST"}, "403"),
        ({"PATH_INFO": "/"}, "403"),
        ({"PATH_INFO": "/secre/alive"}, "403"),
        ({"PATH_INFO": "/x/secret/alive"}, "403"),
        ({"REQUEST_METHOD": "PUT"}, "405"),
        ({"REQUEST_METHOD": "POST", "CONTENT_LENGTH": "1000001"}, "413"),
        ({"REQUEST_METHOD": "POST", "CONTENT_LENGTH": "-1"}, "413"),
        ({"REQUEST_METHOD": "POST", "CONTENT_LENGTH": "\u00b2"}, "413"),  # a digit, and no number
        ({"REQUEST_METHOD": "POST", "CONTENT_LENGTH": "9" * 5000}, "413"),
    ],
)
def test_others_are_refused_in_words(changes: dict[str, str | None], code: str) -> None:
    status, headers, body = asked(**changes)
    assert status.startswith(code)
    assert body != b"inside"
    assert body.endswith(b".")
    assert headers["Content-Type"].startswith("text/plain")
    assert "default-src 'self'" in headers["Content-Security-Policy"]


def test_the_port_that_browsers_leave_out() -> None:
    own = RequestGuard(lambda _, __: [], 80, "secret", make_content_policy())
    assert own.refusal(OWN | {"HTTP_HOST": "localhost", "HTTP_ORIGIN": "http://localhost"}) is None
    assert own.refusal(OWN | {"HTTP_HOST": "127.0.0.1:80"}) is None
    assert own.refusal(OWN | {"HTTP_HOST": "evil.example"}) is not None


def test_files_that_never_change_may_be_kept() -> None:
    assert asked(cache="public, max-age=31536000")[1]["Cache-Control"] == "public, max-age=31536000"


def test_only_scripts_that_are_known_run() -> None:
    assert "script-src 'self' 'sha256-abc'" in make_content_policy(["'sha256-abc'"])
    assert "unsafe-eval" not in make_content_policy()
