"""A browser that notes what a page may not do: complain on its console, or ask for anything beyond this machine."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

__all__ = ["CHROMIUM", "Browsing", "executable", "is_local"]

CHROMIUM = "DYNIDENT_CHROMIUM"  # an environment variable: the browser, where it has another name or place
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
LOOPBACK = ("127.0.0.1", "localhost", "::1")
HINTS = ("GL Driver Message", "willReadFrequently")  # how fast 3-D is drawn without a graphics card
GRAVE = ("serious", "critical")


def executable() -> str | None:
    """The browser of this machine, if it has one."""
    return os.environ.get(CHROMIUM) or next(filter(None, map(shutil.which, NAMES)), None)


def is_local(address: str) -> bool:
    """Whether a request stays on this machine."""
    parts = urlsplit(address)
    if parts.scheme in ("data", "blob", "about"):
        return True
    return parts.hostname in LOOPBACK if parts.scheme in ("http", "https", "ws", "wss") else parts.scheme == "file"


@dataclass
class Browsing:
    """Opens pages, each with a storage of its own, and gathers their ``complaints``: errors and warnings on the
    console, exceptions, requests that leave the machine. A test that expects some takes them out of the list.
    """

    browser: Browser
    complaints: list[str] = field(default_factory=list)
    contexts: list[BrowserContext] = field(default_factory=list)

    def __call__(self, address: str | Path, width: int = 1280, height: int = 800, **settings: Any) -> Page:
        """Open a file, or an address of a server on this machine; ``settings`` are those of playwright's contexts,
        such as ``color_scheme="dark"``."""
        context = self.browser.new_context(viewport={"width": width, "height": height}, **settings)
        self.contexts.append(context)
        page = context.new_page()
        page.on("console", self._said)
        page.on("pageerror", lambda error: self.complaints.append(f"exception: {error}"))
        context.on("request", lambda request: self._asked(request.url))
        page.on("websocket", lambda socket: self._asked(socket.url))
        page.goto(address.resolve().as_uri() if isinstance(address, Path) else address)
        return page

    def close(self) -> None:
        for context in self.contexts:
            context.close()

    def _said(self, message: Any) -> None:
        if message.type in ("error", "warning") and not any(hint in message.text for hint in HINTS):
            self.complaints.append(f"console: {message.text}")

    def _asked(self, address: str) -> None:
        if not is_local(address):
            self.complaints.append(f"request: {address[:200]}")

    @staticmethod
    def barriers(page: Page, rules: Mapping[str, bool] | None = None) -> Sequence[str]:
        """What axe-core finds on a page that keeps people from reading it: serious and critical violations, a line
        each. What plotly draws within its boxes is left out."""
        from axe_playwright_python.sync_playwright import Axe

        options = {"resultTypes": ["violations"], "rules": {k: {"enabled": v} for k, v in (rules or {}).items()}}
        outcome = Axe().run(page, {"exclude": [[".plot > *"]]}, options).response["violations"]
        return [
            f"{x['id']}: {x['help']} -- {node['html'][:160]} ({node['failureSummary'][:200]})"
            for x in outcome
            if x["impact"] in GRAVE
            for node in x["nodes"][:5]
        ]
