"""The command ``dynident``: each command reads, calls and writes; heavy packages are imported when one runs."""

from __future__ import annotations

import click

from dynident.cli.bound import bound
from dynident.cli.check import check
from dynident.cli.compare import compare
from dynident.cli.compare_results import compare_results
from dynident.cli.demo import demo
from dynident.cli.excite import excite
from dynident.cli.export import export
from dynident.cli.failures import Commands
from dynident.cli.fleet import fleet
from dynident.cli.identify import identify
from dynident.cli.init import init
from dynident.cli.options import common, said
from dynident.cli.payload import payload
from dynident.cli.predict import predict
from dynident.cli.reproduce import reproduce
from dynident.cli.schema import schema
from dynident.cli.smooth import smooth
from dynident.cli.tune import tune
from dynident.cli.watch import watch

__all__ = ["main"]


def _version(ctx: click.Context, option: click.Parameter, value: bool) -> None:  # noqa: ARG001
    if value and not ctx.resilient_parsing:
        from dynident.cli.version import version_text
        from dynident.errors import ConfigError

        try:
            click.echo(version_text())
        except ConfigError as error:
            raise click.ClickException(str(error)) from error
        ctx.exit()


@click.group(
    "dynident", cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}
)
@click.option(
    "--debug",
    is_flag=True,
    envvar="DYNIDENT_DEBUG",
    help="Print the traceback where a command fails.",
)
@said
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_version,
    help="Show the version, what it was built from and what it runs with.",
)  # fmt: skip
def main(debug: bool) -> None:
    """Identify the dynamic parameters of robot arms from measured joint positions and torques."""


for _command in (
    demo, reproduce, init, excite, check, bound, identify, tune, compare, fleet, predict, compare_results, payload,
    watch, export, smooth, schema,
):  # fmt: skip
    common(_command)
    main.add_command(_command)
