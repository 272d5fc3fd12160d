"""Write docs/cli.md, the reference of the command, from its own help: .venv/bin/python docs/generate_cli.py."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path

import click

from dynident.cli import main
from dynident.io.results import write_text

TARGET = Path(__file__).with_name("cli.md")


def reference() -> str:
    """Return the reference as Markdown."""
    lines = [
        "# Commands",
        "",
        "Generated from the command's help by `docs/generate_cli.py`; a test fails where it is stale.",
        "",
        "A wrong setting or recording ends with one message and exit code 1, a wrong option with exit code 2. An error",
        "that was not foreseen is a fault of dynident: one line that says what to report, and exit code 70. Where a",
        "command fails, `--debug` before its name, or `DYNIDENT_DEBUG=1` in the environment, prints the traceback.",
    ]
    context = click.Context(main, info_name="dynident", **main.context_settings)
    for name in main.list_commands(context):
        command = main.get_command(context, name)
        if command is not None:
            lines += _section(command, click.Context(command, info_name=name, parent=context))
    return "\n".join(lines) + "\n"


def _section(command: click.Command, context: click.Context) -> Iterator[str]:
    usage = " ".join((context.command_path, *command.collect_usage_pieces(context)))
    yield from ("", f"## {context.command_path}", "", f"`{usage}`", "", inspect.cleandoc(str(command.help)), "")
    yield from ("| option | meaning |", "|---|---|")
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None and record[1]:  # arguments have no help of their own
            option, meaning = (" ".join(text.split()).replace("|", "\\|") for text in record)
            yield f"| `{option}` | {meaning} |"


if __name__ == "__main__":
    write_text(TARGET, reference())
