"""The server of the page: on the loopback, at a free port, until Ctrl-C."""

from __future__ import annotations

import hmac
import os
import re
import secrets
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynident.apps.tuning.session import Session
from dynident.runtime import ConfigError, install_command

if TYPE_CHECKING:
    from werkzeug.serving import BaseWSGIServer

Environ = dict[str, Any]
StartResponse = Callable[..., Any]
Application = Callable[[Environ, StartResponse], Iterable[bytes]]

HTTP_PORT = 80  # the port that browsers leave out
MAX_REQUEST_BYTES = 1_000_000  # bytes of a request; a setting takes some hundred
METHODS = ("GET", "HEAD", "POST")
HEADERS = (
    ("X-Content-Type-Options", "nosniff"),
    ("Referrer-Policy", "no-referrer"),
    ("Cross-Origin-Opener-Policy", "same-origin"),
    ("Cross-Origin-Resource-Policy", "same-origin"),
    ("Cache-Control", "no-store"),
)

LOOPBACK = "127.0.0.1"


class RequestGuard:
    """A WSGI application in front of another, on ``port`` of the loopback, below a secret ``token`` of its
    paths.

    Refused with 403 and a sentence are: another Host than the loopback at this port, by which a page of a
    rebound name would ask; another Origin; a request that the browser marks as of another site; a path
    without the token. Every answer says by ``content_policy`` that it loads and requests nothing from
    elsewhere, and stands in no frame.
    """

    def __init__(self, inner: Application, port: int, token: str, content_policy: str) -> None:
        self.inner, self.token = inner, token
        names = ("127.0.0.1", "localhost")
        self.hosts = (*(f"{name}:{port}" for name in names), *(names if port == HTTP_PORT else ()))
        self.headers = (*HEADERS, ("Content-Security-Policy", content_policy))

    def __call__(self, environ: Environ, start: StartResponse) -> Iterable[bytes]:
        """Answer a request, or refuse it."""
        if refusal := self.refusal(environ):
            return self._refuse(*refusal, start)

        def with_headers(status: str, headers: list[tuple[str, str]], *more: Any) -> Any:
            own_names = {name.lower() for name, _ in self.headers}
            # what a fingerprint in its address tells apart may be kept: it is the same file for ever
            is_cacheable = any(name.lower() == "cache-control" and "max-age" in text for name, text in headers)
            own_names -= {"cache-control"} if is_cacheable else set()
            other_headers = [header for header in headers if header[0].lower() not in own_names]
            return start(
                status, [*other_headers, *(header for header in self.headers if header[0].lower() in own_names)], *more
            )

        return self.inner(environ, with_headers)

    def refusal(self, environ: Environ) -> tuple[str, str] | None:
        """Return the status and the reason for which a request is refused; None where it is not."""
        host, origin = environ.get("HTTP_HOST", ""), environ.get("HTTP_ORIGIN")
        if environ.get("REQUEST_METHOD") not in METHODS:
            return "405 Method Not Allowed", "This server answers GET and POST."
        # a rebound DNS name would reach the loopback with its own Host
        if host not in self.hosts:
            return "403 Forbidden", "This server answers its own machine only, under the address that it printed."
        if origin is not None and origin not in [f"http://{allowed_host}" for allowed_host in self.hosts]:
            return "403 Forbidden", "This server does not answer the pages of others."
        if not _is_own_site(environ):
            return "403 Forbidden", "This server does not answer the pages of others; type its address, or paste it."
        # in constant time, so that the token cannot be guessed letter by letter
        if not hmac.compare_digest(_first_path_part(environ.get("PATH_INFO", "")), self.token.encode()):
            return "403 Forbidden", "Open the whole address that dynident tune printed: a part of it is missing."
        length = environ.get("CONTENT_LENGTH") or "0"
        if not re.fullmatch("[0-9]{1,12}", length) or int(length) > MAX_REQUEST_BYTES:
            return "413 Content Too Large", "The request is too large for a setting."
        return None

    def _refuse(self, status: str, reason: str, start: StartResponse) -> Iterable[bytes]:
        text = reason.encode()
        content_headers = ("Content-Type", "text/plain; charset=utf-8"), ("Content-Length", str(len(text)))
        start(status, [*content_headers, *self.headers, ("Connection", "close")])
        return [text]


def _is_own_site(environ: Environ) -> bool:
    """Return whether a request comes from this page or from a typed address, as browsers tell.

    Another program of this machine with a page (such as a notebook) may show the link: it opens the page,
    nothing else.
    """
    site = environ.get("HTTP_SEC_FETCH_SITE", "none")
    is_navigation = environ.get("HTTP_SEC_FETCH_MODE") == "navigate" and environ.get("REQUEST_METHOD") == "GET"
    return site in ("none", "same-origin") or (site == "same-site" and is_navigation)


def make_content_policy(hashes: Sequence[str] = ()) -> str:
    """Return a content policy: everything from this server; of scripts in the page those with these ``hashes``.

    The styles that Plotly and React set while they draw are in the page.
    """
    return "; ".join(
        (
            "default-src 'self'",
            " ".join(("script-src 'self'", *hashes)),
            "style-src 'self' 'unsafe-inline'",
            "img-src 'self' data: blob:",
            *("object-src 'none'", "base-uri 'none'", "form-action 'none'", "frame-ancestors 'none'"),
        )
    )


def _first_path_part(path: str) -> bytes:
    """Return the first part of a path."""
    return path.lstrip("/").partition("/")[0].encode("utf-8", "replace")


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


def build_server(application: Application, listener: socket.socket, token: str, content_policy: str) -> BaseWSGIServer:
    """Return the server of an application behind its guard, on a socket that listens; ``serve_forever`` runs
    it.
    """
    from werkzeug.serving import WSGIRequestHandler, make_server

    class Quiet(WSGIRequestHandler):
        """Requests are not logged: they are of no interest in a terminal."""

        server_version, sys_version, timeout = "dynident", "", 60

        def log(self, type: str, message: str, *args: object) -> None:  # noqa: A002, ARG002 -- so it is called
            return

    port = listener.getsockname()[1]
    guard = RequestGuard(application, port, token, content_policy)
    server = make_server(LOOPBACK, port, guard, threaded=True, request_handler=Quiet, fd=listener.fileno())
    listener.close()  # the server has its own copy
    return server


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
    """Yield the address of the page of a configuration, and its server, whose ``serve_forever`` answers until
    it ends.

    The logs are read meanwhile. ``fault`` is called with unexpected errors. Raises ConfigError where the
    port cannot be had, or Dash is not installed.
    """
    try:
        from dynident.apps.tuning.app import make_app
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] not in ("dash", "flask", "werkzeug"):
            raise
        raise ConfigError(f"The page needs the package dash; install it: {install_command('dash')}") from error
    listener = bind_socket(port)
    address = Address.at(listener.getsockname()[1])
    session = Session(path, fault)
    app = make_app(session, address.token)
    server = build_server(app.server, listener, address.token, make_content_policy(app.csp_hashes()))
    session.start()
    try:
        yield address, server
    finally:
        server.server_close()
