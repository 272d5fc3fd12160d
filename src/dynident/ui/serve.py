"""A configuration served as a page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from dynident.errors import ConfigError, install_command
from dynident.ui.guard import policy
from dynident.ui.server import Address, bound_socket, server_of
from dynident.ui.session import Session

if TYPE_CHECKING:
    from werkzeug.serving import BaseWSGIServer

__all__ = ["serving"]


@contextmanager
def serving(
    path: Path, port: int = 0, fault: Callable[[str], None] = lambda _: None
) -> Iterator[tuple[Address, BaseWSGIServer]]:
    """Give the address of the page of a configuration, and its server, whose ``serve_forever`` answers until it ends.

    The logs are read meanwhile. ``fault`` is told of errors that nobody foresaw. Raises ConfigError where the port
    cannot be had, or Dash is not installed.
    """
    try:
        from dynident.ui.app import made
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] not in ("dash", "flask", "werkzeug"):
            raise
        raise ConfigError(f"The page needs the package dash; install it: {install_command('dash')}") from error
    own = bound_socket(port)
    address = Address.at(own.getsockname()[1])
    session = Session(path, fault)
    app = made(session, address.token)
    server = server_of(app.server, own, address.token, policy(app.csp_hashes()))
    session.start()
    try:
        yield address, server
    finally:
        server.server_close()
