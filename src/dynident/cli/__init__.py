"""The command ``dynident``: each command reads, calls and writes; heavy packages are imported when one runs."""

from __future__ import annotations

import click

from dynident import __version__
from dynident.cli.bound import bound
from dynident.cli.check import check
from dynident.cli.demo import demo
from dynident.cli.export import export
from dynident.cli.failures import Commands
from dynident.cli.identify import identify
from dynident.cli.init import init
from dynident.cli.predict import predict
from dynident.cli.reproduce import reproduce
from dynident.cli.schema import schema
from dynident.cli.smooth import smooth
from dynident.cli.terminal import MEMORY_OPTION

__all__ = ["main"]


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option(
    "--debug",
    is_flag=True,
    envvar="DYNIDENT_DEBUG",
    help="Print the traceback where a command fails.",
)
@click.version_option(__version__, prog_name="dynident")
def main(debug: bool) -> None:
    """Identify the dynamic parameters of robot arms from measured joint positions and torques."""


for _command in (demo, reproduce, init, check, bound, identify, predict, export, smooth, schema):
    MEMORY_OPTION(_command)
    main.add_command(_command)
