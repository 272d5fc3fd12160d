"""The server of the page: on the loopback, at a free port, until Ctrl-C."""

from __future__ import annotations

import os
import secrets
import socket
import sys
import threading
import webbrowser
from dataclasses import dataclass
from http.server import ThreadingHTTPServer
from typing import TYPE_CHECKING

from dynident.errors import ConfigError
from dynident.ui.guard import Application, Guard

if TYPE_CHECKING:
    from werkzeug.serving import BaseWSGIServer

__all__ = ["Address", "answer", "bound_socket", "open_browser", "server_of"]

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class Address:
    """Where a page is: a ``port`` of the loopback, and a secret ``token`` before all its paths."""

    port: int
    token: str

    @classmethod
    def at(cls, port: int) -> Address:
        """Return an address with a new token."""
        return cls(port, secrets.token_urlsafe(12))

    def __str__(self) -> str:
        return f"http://{LOOPBACK}:{self.port}/{self.token}/"


def bound_socket(port: int) -> socket.socket:
    """Return a socket at a ``port`` of the loopback, at a free one for 0; ConfigError where that cannot be had."""
    own = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    if os.name != "nt":  # where it would share a port that another program has
        own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        own.bind((LOOPBACK, port))
        own.listen(64)
    except OSError as error:
        own.close()
        raise ConfigError(
            f"--port {port}: {error.strerror or error}. Name another port, or none: then a free one is taken."
        ) from error
    return own


def server_of(application: Application, own: socket.socket, token: str, content_policy: str) -> BaseWSGIServer:
    """Return the server of an application behind its guard, on a socket that listens; ``serve_forever`` runs it."""
    from werkzeug.serving import WSGIRequestHandler, make_server

    class Quiet(WSGIRequestHandler):
        """Requests are not logged: what a page asks is of no interest in a terminal."""

        server_version, sys_version, timeout = "dynident", "", 60

        def log(self, type: str, message: str, *args: object) -> None:  # noqa: A002, ARG002 -- so it is called
            return

    port = own.getsockname()[1]
    guarded = Guard(application, port, token, content_policy)
    made = make_server(LOOPBACK, port, guarded, threaded=True, request_handler=Quiet, fd=own.fileno())
    own.close()  # the server has its own copy
    return made


def answer(server: BaseWSGIServer) -> None:
    """Answer until a signal ends it, which is raised."""
    # that of werkzeug itself takes all signals for Ctrl-C
    ThreadingHTTPServer.serve_forever(server)


def open_browser(address: Address) -> None:
    """Open the page, where there is a screen: a browser in the terminal would take it from the command."""
    screen = sys.platform in ("win32", "darwin") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if screen:
        threading.Thread(target=webbrowser.open, args=(str(address),), daemon=True).start()
