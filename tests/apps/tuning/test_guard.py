"""Nobody but the page itself is answered."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("flask")

import flask

from dynident.apps.tuning.server import Address, guard, make_content_policy, refusal

HOST = "127.0.0.1:8050"
OWN = {"REQUEST_METHOD": "GET", "HTTP_HOST": HOST, "PATH_INFO": "/secret/alive"}


def answered(port: int = 8050, cache: str = "no-cache", **changes: str | None) -> Any:
    """Ask an application behind its guard."""
    app = flask.Flask("guarded")

    @app.route("/secret/alive", methods=["GET", "POST"])
    def alive() -> Any:
        flask.request.get_data()
        return flask.Response("inside", headers={"Cache-Control": cache})

    guard(app, Address(port, "secret"), make_content_policy())
    environ = {name: value for name, value in (OWN | changes).items() if value is not None}
    return app.test_client().open(environ_overrides=environ)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"HTTP_HOST": "localhost:8050"},
        {"HTTP_ORIGIN": "http://127.0.0.1:8050", "REQUEST_METHOD": "POST", "CONTENT_LENGTH": "0"},
        {"HTTP_SEC_FETCH_SITE": "same-origin", "REQUEST_METHOD": "POST"},
        {"HTTP_SEC_FETCH_SITE": "none"},
        {"HTTP_SEC_FETCH_SITE": "same-site", "HTTP_SEC_FETCH_MODE": "navigate"},
        {"port": 80, "HTTP_HOST": "localhost", "HTTP_ORIGIN": "http://localhost"},
        {"port": 80, "HTTP_HOST": "127.0.0.1:80"},
    ],
)
def test_the_page_is_answered(changes: dict[str, Any]) -> None:
    response = answered(**changes)
    assert (response.status_code, response.data) == (200, b"inside")
    assert "frame-ancestors 'none'" in response.headers["Content-Security-Policy"]
    assert response.headers["X-Content-Type-Options"] == "nosniff"
    assert response.headers["Referrer-Policy"] == "no-referrer"
    assert response.headers["Cache-Control"] == "no-store"


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"HTTP_HOST": "evil.example:8050"}, 403),  # a name that was bound anew to the loopback
        ({"HTTP_HOST": ""}, 403),
        ({"HTTP_HOST": "127.0.0.1:8051"}, 403),
        ({"HTTP_HOST": "evil.example", "port": 80}, 403),
        ({"HTTP_HOST": "127.0.0.1:8050,evil.example"}, 403),
        ({"HTTP_ORIGIN": "https://evil.example"}, 403),
        ({"HTTP_ORIGIN": "null"}, 403),
        ({"HTTP_ORIGIN": "http://127.0.0.1:8888"}, 403),
        ({"HTTP_SEC_FETCH_SITE": "cross-site"}, 403),
        ({"HTTP_SEC_FETCH_SITE": "cross-site", "HTTP_SEC_FETCH_MODE": "navigate"}, 403),
        ({"HTTP_SEC_FETCH_SITE": "same-site", "REQUEST_METHOD": "POST"}, 403),
        ({"PATH_INFO": "/"}, 403),
        ({"PATH_INFO": "/secre/alive"}, 403),
        ({"PATH_INFO": "/x/secret/alive"}, 403),
        ({"PATH_INFO": "/secret/elsewhere"}, 404),
        ({"REQUEST_METHOD": "PUT"}, 405),
        ({"REQUEST_METHOD": "POST", "CONTENT_LENGTH": "1000001"}, 413),
    ],
)
def test_others_are_refused(changes: dict[str, Any], code: int) -> None:
    response = answered(**changes)
    assert response.status_code == code
    assert response.data != b"inside"
    assert "default-src 'self'" in response.headers["Content-Security-Policy"]
    if code == 403:
        assert response.data.endswith(b".")
        assert response.mimetype == "text/plain"


@pytest.mark.parametrize("length", ["-1", "\u00b2", "9" * 5000])
def test_a_length_that_is_none_does_no_harm(length: str) -> None:
    assert answered(REQUEST_METHOD="POST", CONTENT_LENGTH=length).status_code < 500


def test_a_request_without_a_host_is_refused() -> None:
    assert "its own machine only" in refusal(OWN | {"HTTP_HOST": ""}, Address(8050, "secret"))


def test_files_that_never_change_may_be_kept() -> None:
    kept = "public, max-age=31536000"
    assert answered(cache=kept).headers["Cache-Control"] == kept


def test_only_scripts_that_are_known_run() -> None:
    assert "script-src 'self' 'sha256-abc'" in make_content_policy(["'sha256-abc'"])
    assert "unsafe-eval" not in make_content_policy()
