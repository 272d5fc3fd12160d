"""The command ``dynident``: each command reads, calls and writes; heavy packages are imported when one runs."""

from __future__ import annotations

from typing import Any

import click

from dynident import __version__
from dynident.cli.bound import bound
from dynident.cli.check import check
from dynident.cli.export import export
from dynident.cli.identify import identify
from dynident.cli.init import init
from dynident.cli.predict import predict
from dynident.cli.reproduce import reproduce
from dynident.cli.schema import schema
from dynident.cli.smooth import smooth
from dynident.cli.terminal import MEMORY_OPTION
from dynident.errors import DynidentError
from dynident.io.opener import watched

__all__ = ["main"]


class _Commands(click.Group):
    """Turns the errors meant for the user into one message and exit code 1."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with watched():
                return super().invoke(ctx)
        except DynidentError as error:
            raise click.ClickException(str(error)) from error
        except KeyboardInterrupt:
            click.echo("Interrupted.", err=True)
            raise SystemExit(130) from None


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="dynident")
def main() -> None:
    """Identify the dynamic parameters of robot arms from measured joint positions and torques."""


for _command in (reproduce, init, check, bound, identify, predict, export, smooth, schema):
    MEMORY_OPTION(_command)
    main.add_command(_command)
