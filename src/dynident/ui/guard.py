"""Who may ask the server: this machine's browser, from the page that was opened, and nobody else."""

from __future__ import annotations

import hmac
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

__all__ = ["Guard", "policy"]

Environ = dict[str, Any]
Start = Callable[..., Any]
Application = Callable[[Environ, Start], Iterable[bytes]]

HTTP = 80  # the port that browsers leave out
LARGEST = 1_000_000  # bytes of a request; a setting takes some hundred
METHODS = ("GET", "HEAD", "POST")
HEADERS = (
    ("X-Content-Type-Options", "nosniff"),
    ("Referrer-Policy", "no-referrer"),
    ("Cross-Origin-Opener-Policy", "same-origin"),
    ("Cross-Origin-Resource-Policy", "same-origin"),
    ("Cache-Control", "no-store"),
)


class Guard:
    """A WSGI application before another, on ``port`` of the loopback, below a secret ``token`` of its paths.

    Refused with 403 and a sentence: another Host than the loopback at this port, by which a page of a rebound name
    would ask; another Origin; a request that the browser marks as of another site; a path without the token. Every
    answer says by ``content_policy`` that it loads and asks nothing from elsewhere, and stands in no frame.
    """

    def __init__(self, inner: Application, port: int, token: str, content_policy: str) -> None:
        self.inner, self.token = inner, token
        names = ("127.0.0.1", "localhost")
        self.hosts = (*(f"{name}:{port}" for name in names), *(names if port == HTTP else ()))
        self.headers = (*HEADERS, ("Content-Security-Policy", content_policy))

    def __call__(self, environ: Environ, start: Start) -> Iterable[bytes]:
        """Answer a request, or refuse it."""
        if refusal := self.refusal(environ):
            return self._refused(*refusal, start)

        def with_headers(status: str, headers: list[tuple[str, str]], *more: Any) -> Any:
            own = {name.lower() for name, _ in self.headers}
            # what a fingerprint in its address tells apart may be kept: it is the same file for ever
            kept = any(name.lower() == "cache-control" and "max-age" in text for name, text in headers)
            own -= {"cache-control"} if kept else set()
            rest = [one for one in headers if one[0].lower() not in own]
            return start(status, [*rest, *(one for one in self.headers if one[0].lower() in own)], *more)

        return self.inner(environ, with_headers)

    def refusal(self, environ: Environ) -> tuple[str, str] | None:
        """Return the status and the reason for which a request is refused; None where it is not."""
        host, origin = environ.get("HTTP_HOST", ""), environ.get("HTTP_ORIGIN")
        if environ.get("REQUEST_METHOD") not in METHODS:
            return "405 Method Not Allowed", "This server answers GET and POST."
        if host not in self.hosts:
            return "403 Forbidden", "This server answers its own machine only, under the address that it printed."
        if origin is not None and origin not in [f"http://{one}" for one in self.hosts]:
            return "403 Forbidden", "This server does not answer the pages of others."
        if not _own_site(environ):
            return "403 Forbidden", "This server does not answer the pages of others; type its address, or paste it."
        if not hmac.compare_digest(_first(environ.get("PATH_INFO", "")), self.token.encode()):
            return "403 Forbidden", "Open the whole address that dynident tune printed: a part of it is missing."
        length = environ.get("CONTENT_LENGTH") or "0"
        if not re.fullmatch("[0-9]{1,12}", length) or int(length) > LARGEST:
            return "413 Content Too Large", "The request is too large for a setting."
        return None

    def _refused(self, status: str, reason: str, start: Start) -> Iterable[bytes]:
        text = reason.encode()
        plain = ("Content-Type", "text/plain; charset=utf-8"), ("Content-Length", str(len(text)))
        start(status, [*plain, *self.headers, ("Connection", "close")])
        return [text]


def _own_site(environ: Environ) -> bool:
    """Tell whether a request is of this page or of who types its address; browsers say so.

    Another program of this machine with a page (as a notebook's) may show the link: it opens the page, nothing else.
    """
    site = environ.get("HTTP_SEC_FETCH_SITE", "none")
    opened = environ.get("HTTP_SEC_FETCH_MODE") == "navigate" and environ.get("REQUEST_METHOD") == "GET"
    return site in ("none", "same-origin") or (site == "same-site" and opened)


def policy(hashes: Sequence[str] = ()) -> str:
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


def _first(path: str) -> bytes:
    """Return the first part of a path."""
    return path.lstrip("/").partition("/")[0].encode("utf-8", "replace")
