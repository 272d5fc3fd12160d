"""The server is on the loopback, and says where."""

from __future__ import annotations

import http.client
import threading

import pytest

from dynident.apps.tuning.server import Address, answer, bind_socket, build_server, guard, open_browser
from dynident.runtime import ConfigError


def test_a_free_port_and_a_secret() -> None:
    flask = pytest.importorskip("flask")
    own = bind_socket(0)
    address = Address.at(own.getsockname()[1])
    assert own.getsockname()[0] == "127.0.0.1"
    assert Address.at(1).token != address.token
    with pytest.raises(ConfigError, match=rf"--port {address.port}: .*Name another port"):
        bind_socket(address.port)

    app = flask.Flask("served")
    app.add_url_rule("/<path:path>", "echo", lambda path: f"/{path}")
    guard(app, address, "default-src 'self'")
    server = build_server(app, own)
    own.close()
    thread = threading.Thread(target=answer, args=(server,), daemon=True)
    thread.start()
    asked = http.client.HTTPConnection("127.0.0.1", address.port, timeout=10)
    asked.request("GET", f"/{address.token}/here")
    found = asked.getresponse()
    assert (found.status, found.read().decode()) == (200, f"/{address.token}/here")
    assert "Werkzeug" not in (found.getheader("Server") or "")
    asked.request("GET", "/here", headers={"Host": "evil.example"})
    assert asked.getresponse().status == 403
    server.shutdown()
    thread.join()
    server.server_close()


def test_no_browser_where_there_is_no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    open_browser(Address(1, "x"))
    assert opened == []
