"""``dynident tune``: a page to look at the logs of a configuration and to tune its settings by hand."""

from __future__ import annotations

from pathlib import Path

import click

from dynident.cli.options import CONFIG
from dynident.cli.terminal import console
from dynident.cli.voice import complain

__all__ = ["tune"]


@click.command(short_help="Look and tune, in a browser.")
@click.argument("config", type=CONFIG)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, metavar="N", help="Port of this machine; by default a free one."
)
@click.option("--no-browser", is_flag=True, help="Print the address, and open no browser.")
def tune(config: Path, port: int, no_browser: bool) -> None:
    """Show the logs of CONFIG (YAML) smoothed and fitted, on a page that follows its controls: degree of smoothing,
    samples, terms, joints, estimator; and save the settings into CONFIG.

    The page is for this machine alone. Ctrl-C ends it.
    """
    from dynident.cli.escapes import visible
    from dynident.io.project import read_project
    from dynident.ui import serving
    from dynident.ui.server import answer, open_browser

    read_project(config)  # what is wrong in it is said here
    with serving(config, port, lambda text: complain(visible(text))) as (address, server):
        screen = console()
        screen.say(str(address), whole=True)
        screen.remark("This address is for this machine alone. Ctrl-C ends it.")
        if not no_browser:
            open_browser(address)
        try:
            answer(server)
        except KeyboardInterrupt as stop:
            if hasattr(stop, "number"):  # another signal than Ctrl-C, which is how a person ends it
                raise
