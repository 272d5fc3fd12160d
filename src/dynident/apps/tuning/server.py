"""The server of the page: on the loopback, at a free port, until Ctrl-C."""

from __future__ import annotations

import hmac
import os
import secrets
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynident.apps.tuning.config import bench_of
from dynident.apps.tuning.session import Session
from dynident.project.project import read_project
from dynident.runtime import ConfigError, install_command

if TYPE_CHECKING:
    from flask import Flask
    from werkzeug.serving import BaseWSGIServer

HTTP_PORT = 80  # the port that browsers leave out
HEADER_TIME, MAX_CONNECTIONS = 5, 32  # s for the head of a request; at once: a page takes about ten
MAX_REQUEST_BYTES = 1_000_000  # bytes of a request; a setting takes some hundred
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
LOOPBACK, LOCAL_NAMES = "127.0.0.1", ("127.0.0.1", "localhost")


def guard(app: Flask, address: Address, content_policy: str) -> None:
    """Let an application answer nobody but its own page, at an address of the loopback.

    Refused with 403 and a sentence are: another Host than the loopback at this port, by which a page of a rebound name
    would ask; another Origin; a request that the browser marks as of another site; a path without the token. Every
    answer says by ``content_policy`` that it loads and requests nothing from elsewhere, and stands in no frame.
    """
    from flask import Response, request

    app.config["MAX_CONTENT_LENGTH"] = MAX_REQUEST_BYTES

    def refuse() -> Response | None:
        words = refusal(request.environ, address)
        return Response(words, 403, mimetype="text/plain") if words else None

    def add_headers(response: Response) -> Response:
        # what a fingerprint in its address tells apart may be kept: it is the same file for ever
        is_cacheable = "max-age" in response.headers.get("Cache-Control", "")
        caching = {} if is_cacheable else {"Cache-Control": "no-store"}
        response.headers.update({**HEADERS, **caching, "Content-Security-Policy": content_policy})
        return response

    app.before_request(refuse)
    app.after_request(add_headers)


def refusal(environ: Mapping[str, Any], address: Address) -> str:
    """Return the reason for which a request is refused; an empty text where it is not."""
    hosts = [f"{name}:{address.port}" for name in LOCAL_NAMES]
    hosts += LOCAL_NAMES if address.port == HTTP_PORT else ()
    # a rebound DNS name would reach the loopback with its own Host
    if environ.get("HTTP_HOST", "") not in hosts:
        return "This server answers its own machine only, under the address that it printed."
    if environ.get("HTTP_ORIGIN") not in (None, *(f"http://{host}" for host in hosts)):
        return "This server does not answer the pages of others."
    # another program of this machine with a page (such as a notebook) may show the link: it opens the page, no more
    site = environ.get("HTTP_SEC_FETCH_SITE", "none")
    is_navigation = environ.get("HTTP_SEC_FETCH_MODE") == "navigate" and environ.get("REQUEST_METHOD") == "GET"
    if not (site in ("none", "same-origin") or (site == "same-site" and is_navigation)):
        return "This server does not answer the pages of others; type its address, or paste it."
    # in constant time, so that the token cannot be guessed letter by letter
    token = environ.get("PATH_INFO", "").lstrip("/").partition("/")[0]
    if not hmac.compare_digest(token.encode("utf-8", "replace"), address.token.encode()):
        return "Open the whole address that dynident tune printed: a part of it is missing."
    return ""


def make_content_policy(hashes: Sequence[str] = ()) -> str:
    """Return a content policy: everything from this server; of scripts in the page those with these ``hashes``.

    The styles that Plotly and React set while they draw are in the page.
    """
    scripts = " ".join(("script-src 'self'", *hashes))
    return (
        f"default-src 'self'; {scripts}; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
        "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


@dataclass(frozen=True)
class Address:
    """Address of a page: a ``port`` of the loopback, and a secret ``token`` before all its paths."""

    port: int
    token: str

    @classmethod
    def at(cls, port: int) -> Address:
        """Return an address with a new token."""
        return cls(port, secrets.token_urlsafe(12))

    def __str__(self) -> str:
        return f"http://{LOOPBACK}:{self.port}/{self.token}/"


def bind_socket(port: int) -> socket.socket:
    """Return a socket at a ``port`` of the loopback, at a free one for 0; ConfigError where that cannot be had."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    if os.name != "nt":  # where it would share a port that another program has
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((LOOPBACK, port))
        listener.listen(64)
    except OSError as error:
        listener.close()
        raise ConfigError(
            f"--port {port}: {error.strerror or error}. Name another port, or none: then a free one is taken."
        ) from error
    return listener


def build_server(app: Flask, listener: socket.socket) -> BaseWSGIServer:
    """Return the server of an application on a socket that listens; ``serve_forever`` runs it."""
    from werkzeug.serving import ThreadedWSGIServer, WSGIRequestHandler

    free_threads = threading.BoundedSemaphore(MAX_CONNECTIONS)

    class Capped(ThreadedWSGIServer):
        """Connections beyond ``MAX_CONNECTIONS`` are closed at once, so that none can take all threads."""

        def process_request(self, request: Any, client_address: Any) -> None:
            if not free_threads.acquire(blocking=False):
                self.shutdown_request(request)
                return
            super().process_request(request, client_address)

        def process_request_thread(self, request: Any, client_address: Any) -> None:
            try:
                super().process_request_thread(request, client_address)
            finally:
                free_threads.release()

    class Quiet(WSGIRequestHandler):
        """Requests are not logged: they are of no interest in a terminal."""

        server_version, sys_version, timeout = "dynident", "", HEADER_TIME

        def setup(self) -> None:
            super().setup()
            # the socket's own timeout begins anew with each byte; this one ends what only drips
            self._alarm = threading.Timer(HEADER_TIME, _shut_down, [self.connection])
            self._alarm.daemon = True
            self._alarm.start()

        def parse_request(self) -> bool:
            is_parsed = super().parse_request()
            self._alarm.cancel()
            return is_parsed

        def finish(self) -> None:
            self._alarm.cancel()
            super().finish()

        def log(self, type: str, message: str, *args: object) -> None:  # noqa: A002, ARG002 -- so it is called
            return

    port = listener.getsockname()[1]
    # the server has its own copy of the socket
    return Capped(LOOPBACK, port, app, handler=Quiet, fd=listener.fileno())


def _shut_down(connection: socket.socket) -> None:
    with suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


def answer(server: BaseWSGIServer) -> None:
    """Answer until a signal ends it, which is raised."""
    # that of werkzeug itself takes all signals for Ctrl-C
    ThreadingHTTPServer.serve_forever(server)


def open_browser(address: Address) -> None:
    """Open the page, where there is a screen: a browser in the terminal would take it from the command."""
    screen = sys.platform in ("win32", "darwin") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if screen:
        threading.Thread(target=webbrowser.open, args=(str(address),), daemon=True).start()


@contextmanager
def serve_configuration(
    path: Path, port: int = 0, fault: Callable[[str], None] = lambda _: None
) -> Iterator[tuple[Address, BaseWSGIServer]]:
    """Yield the address of the page of a configuration, and its server, whose ``serve_forever`` answers until it ends.

    The logs are read and identified first. ``fault`` is called with unexpected errors. Raises the errors of
    ``read_project`` and ``bench_of``, and ConfigError where the port cannot be had, or Dash is not installed.
    """
    try:
        from dynident.apps.tuning.app import make_app
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] not in ("dash", "flask", "werkzeug"):
            raise
        raise ConfigError(f"The page needs the package dash; install it: {install_command('dash')}") from error
    project = read_project(path)
    with bind_socket(port) as listener:
        address = Address.at(listener.getsockname()[1])
        app = make_app(Session(project, bench_of(project), fault), address.token)
        guard(app.server, address, make_content_policy(app.csp_hashes()))
        server = build_server(app.server, listener)
    try:
        yield address, server
    finally:
        server.server_close()
