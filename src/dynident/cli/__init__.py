"""The command ``dynident``: each command reads, calls and writes; heavy packages are imported when one runs."""

from __future__ import annotations

import click

from dynident.cli.comparison import compare, compare_results, fleet
from dynident.cli.demo import demo, reproduce
from dynident.cli.failures import Commands
from dynident.cli.identification import export, identify, init
from dynident.cli.logs import bound, check, schema, smooth
from dynident.cli.options import add_common_options, add_output_options
from dynident.cli.prediction import predict
from dynident.cli.robot import excite, payload, tune, watch


def _version(ctx: click.Context, option: click.Parameter, value: bool) -> None:  # noqa: ARG001
    if value and not ctx.resilient_parsing:
        from dynident.cli.options import version_text
        from dynident.runtime import ConfigError

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
    help="Print the traceback if a command fails.",
)
@add_output_options
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_version,
    help="Show the version, the commit and the kernel.",
)  # fmt: skip
def main(debug: bool) -> None:
    """Identify the dynamic parameters of robot arms from measured joint positions and torques."""


for _command in (
    demo, reproduce, init, excite, check, bound, identify, tune, compare, fleet, predict, compare_results, payload,
    watch, export, smooth, schema,
):  # fmt: skip
    add_common_options(_command)
    main.add_command(_command)
