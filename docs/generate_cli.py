"""Write docs/cli.md, the reference of the command, from its own help: .venv/bin/python docs/generate_cli.py."""

from __future__ import annotations

import inspect
from collections.abc import Collection, Iterator
from pathlib import Path

import click

from dynident.cli import main
from dynident.files.results import write_text

COMMON = """
## What is said, and where it is kept

Results go to standard output, in tables as wide as the terminal; where that is none (a pipe, a file), 150 columns
wide. What is being done, with the time left where that is known, goes to standard error, and only to a terminal. With
`-v` each step is printed there with its time, to a terminal or not. With `-q` only results, what was written and errors
are printed. `--log-file` keeps all of it, those steps too, with the time of each line, the version, the platform and
the command: runs are added to the file, and a file that is no log of dynident is never changed.

Each command ends with what to type next. It begins as dynident was started, as `dynident` or as `python -m dynident`;
the environment variable `DYNIDENT_COMMAND` sets it to something else. What computes is the compiled kernel where there
is one, else NumPy and LAPACK; `DYNIDENT_KERNEL=off` chooses these, and `--version` says which runs.

These options stand before or after the name of a command, `--debug` and `--version` before it:
"""
COMPLETION = """
## Completion

A shell completes commands, options, and files by their kind, such as configurations after `identify`, when one of
these lines is in its start-up file. They work for an installed `dynident`.

| shell | file | line |
|---|---|---|
| bash (4.4 or newer) | `~/.bashrc` | `eval "$(_DYNIDENT_COMPLETE=bash_source dynident)"` |
| zsh | `~/.zshrc` | `eval "$(_DYNIDENT_COMPLETE=zsh_source dynident)"` |
| fish | `~/.config/fish/completions/dynident.fish` | `_DYNIDENT_COMPLETE=fish_source dynident \\| source` |
"""
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
    lines += [*COMMON.splitlines(), "", *_options(main, context)]
    for name in main.list_commands(context):
        command = main.get_command(context, name)
        if command is not None:
            lines += _section(command, click.Context(command, info_name=name, parent=context))
    lines += COMPLETION.rstrip().splitlines()
    return "\n".join(lines) + "\n"


def _section(command: click.Command, context: click.Context) -> Iterator[str]:
    usage = " ".join((context.command_path, *command.collect_usage_pieces(context)))
    yield from ("", f"## {context.command_path}", "", f"`{usage}`", "", inspect.cleandoc(str(command.help)), "")
    said = {parameter.name for parameter in main.params}  # once, at the head
    yield from _options(command, context, {*said, "help"})


def _options(command: click.Command, context: click.Context, said: Collection[str | None] = ()) -> Iterator[str]:
    yield from ("| option | meaning |", "|---|---|")
    for parameter in command.get_params(context):
        if parameter.name in said:
            continue
        record = parameter.get_help_record(context)
        if record is not None and record[1]:  # arguments have no help of their own
            option, meaning = (" ".join(text.split()).replace("|", "\\|") for text in record)
            yield f"| `{option}` | {meaning} |"


if __name__ == "__main__":
    write_text(TARGET, reference())
