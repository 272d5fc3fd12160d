"""The server is on the loopback, says where, and answers nobody but the page itself."""

import http.client
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from queue import SimpleQueue
from typing import Any

import pytest

from dynident.apps.tuning import server
from dynident.apps.tuning.request_fields import is_well_formed
from dynident.runtime import ConfigError

flask = pytest.importorskip("flask")


@contextmanager
def served(app: flask.Flask, listener: socket.socket) -> Iterator[int]:
    """Answer on a socket; yield its port."""
    port, serving = listener.getsockname()[1], server.build_server(app, listener)
    listener.close()
    thread = threading.Thread(target=server.answer, args=(serving,), daemon=True)
    thread.start()
    yield port
    serving.shutdown()
    thread.join()
    serving.server_close()


def ask(port: int, path: str, host: str | None = None) -> tuple[http.client.HTTPResponse, str]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", path, headers={} if host is None else {"Host": host})
    response = connection.getresponse()
    return response, response.read().decode()


def test_a_free_port_and_a_secret() -> None:
    own = server.bind_socket(0)
    address = server.Address.at(own.getsockname()[1])
    assert own.getsockname()[0] == "127.0.0.1"
    assert server.Address.at(1).token != address.token
    with pytest.raises(ConfigError, match=rf"--port {address.port}: .*Name another port"):
        server.bind_socket(address.port)
    app = flask.Flask("served")
    app.add_url_rule("/<path:path>", "echo", lambda path: f"/{path}")
    server.guard(app, address, "default-src 'self'")
    with served(app, own) as port:
        response, text = ask(port, f"/{address.token}/here")
        assert (response.status, text) == (200, f"/{address.token}/here")
        assert "Werkzeug" not in (response.getheader("Server") or "")
        assert ask(port, "/here", "evil.example")[0].status == 403


def test_a_browser_is_opened_where_there_is_a_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = SimpleQueue[str]()
    monkeypatch.setattr("webbrowser.open", opened.put)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for port, platform in enumerate(("linux", "darwin")):
        monkeypatch.setattr("sys.platform", platform)
        server.open_browser(server.Address(port, "x"))
    assert opened.get(timeout=10) == str(server.Address(1, "x"))
    assert opened.empty()


@pytest.mark.parametrize("place", ["inputs", "state"])
def test_values_of_other_types_are_refused_wherever_they_stand(place: str) -> None:
    entry = {"id": "joint-degree", "property": "degree"}
    assert is_well_formed({"inputs": [], "state": [], place: [entry | {"value": "0.5"}]})
    assert not is_well_formed({"inputs": [], "state": [], place: [entry | {"value": "x"}]})


HOST = "127.0.0.1:8050"
OWN = {"REQUEST_METHOD": "GET", "HTTP_HOST": HOST, "PATH_INFO": "/secret/alive"}


def answered(port: int = 8050, cache: str = "no-cache", **changes: str | None) -> Any:
    """Ask an application behind its server.guard."""
    app = flask.Flask("guarded")

    @app.route("/secret/alive", methods=["GET", "POST"])
    def alive() -> Any:
        flask.request.get_data()
        return flask.Response("inside", headers={"Cache-Control": cache})

    server.guard(app, server.Address(port, "secret"), server.make_content_policy())
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
        ({"HTTP_SEC_FETCH_SITE": "same-site", "HTTP_SEC_FETCH_MODE": "cors"}, 403),
        ({"HTTP_SEC_FETCH_SITE": "same-site", "HTTP_SEC_FETCH_MODE": "navigate", "REQUEST_METHOD": "POST"}, 403),
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
    environ = {name: value for name, value in OWN.items() if name != "HTTP_HOST"}
    assert "its own machine only" in server.refusal(environ, server.Address(8050, "secret"))


def test_connections_that_send_nothing_or_drip_are_closed_soon_and_are_not_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(server, "HEADER_TIME", 0.25)
    with served(flask.Flask("served"), server.bind_socket(0)) as port:
        before = threading.active_count()
        connections = [
            socket.create_connection(("127.0.0.1", port), timeout=5) for _ in range(3 * server.MAX_CONNECTIONS)
        ]
        for connection in connections[::2]:
            with suppress(OSError):
                connection.sendall(b"GET / HT")
        assert threading.active_count() - before <= 2 * server.MAX_CONNECTIONS + 1  # each with its alarm
        start = time.monotonic()
        for connection in connections:
            with suppress(ConnectionError):
                while connection.recv(4096):
                    pass
            connection.close()
        assert time.monotonic() - start < 4
        assert ask(port, "/")[0].status == 404  # it answers again
