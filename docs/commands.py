"""The page of the commands, from their own help: docs/pages.py puts it into the site."""

from __future__ import annotations

import inspect
from collections.abc import Collection, Iterator

import click

from dynident.cli import main

COMMON = """
## Output and common options

Results go to standard output, in tables as wide as the terminal (150 columns in a pipe). Progress goes to standard
error, if that is a terminal. `-v` prints all tables, notes and steps; `-q` prints only results, written files and
errors. `--log-file` keeps everything, with times: runs are appended, and a file that is no log of dynident is never
changed. Commands that are printed begin with the variable `DYNIDENT_COMMAND`, if it is set.
`DYNIDENT_KERNEL=off` switches the compiled kernel off.

These options stand before or after the name of a command (`--debug` and `--version` before it):
"""
COMPLETION = """
## Completion

A shell completes commands, options and files, when one of these lines is in its start-up file. They work for an
installed `dynident`.

| shell | file | line |
|---|---|---|
| bash (4.4 or newer) | `~/.bashrc` | `eval "$(_DYNIDENT_COMPLETE=bash_source dynident)"` |
| zsh | `~/.zshrc` | `eval "$(_DYNIDENT_COMPLETE=zsh_source dynident)"` |
| fish | `~/.config/fish/completions/dynident.fish` | `_DYNIDENT_COMPLETE=fish_source dynident \\| source` |
"""
SHARED = {"workers", "cluster", "time_limit", "worker_memory", "memory"}
SHARED_LEAD = "Long work and large files; the section of a command names those that it has:"


def reference() -> str:
    """Return the reference as Markdown."""
    lines = [
        "# Commands",
        "",
        "A wrong setting or recording ends with one message and exit code 1, a wrong option with exit code 2. An",
        "unexpected error is a fault of dynident: it ends with exit code 70. `--debug` before the command, or",
        "`DYNIDENT_DEBUG=1`, prints the traceback.",
    ]
    context = click.Context(main, info_name="dynident", **main.context_settings)
    lines += [*COMMON.splitlines(), "", *_options(main, context), "", SHARED_LEAD, ""]
    identify = main.commands["identify"]
    shared = click.Command("shared", params=[each for each in identify.params if each.name in SHARED])
    lines += _options(shared, click.Context(shared), {"help"})
    for name in main.list_commands(context):
        command = main.get_command(context, name)
        if command is not None:
            lines += _section(command, click.Context(command, info_name=name, parent=context))
    lines += COMPLETION.rstrip().splitlines()
    return "\n".join(lines) + "\n"


def _section(command: click.Command, context: click.Context) -> Iterator[str]:
    usage = " ".join((context.command_path, *command.collect_usage_pieces(context)))
    yield from ("", f"## {context.command_path}", "", f"`{usage}`", "", inspect.cleandoc(str(command.help)), "")
    said = {parameter.name for parameter in main.params} | SHARED  # once, at the head
    yield from _options(command, context, {*said, "help"})
    if common := [parameter.opts[-1] for parameter in command.params if parameter.name in SHARED]:
        yield from ("", f"Also {', '.join(f'`{name}`' for name in common)}.")


def _options(command: click.Command, context: click.Context, said: Collection[str | None] = ()) -> Iterator[str]:
    yield from ("| option | meaning |", "|---|---|")
    for parameter in command.get_params(context):
        if parameter.name in said or "--help" in parameter.opts:
            continue
        record = parameter.get_help_record(context)
        if record is not None and record[1]:  # arguments have no help of their own
            option, meaning = (" ".join(text.split()).replace("|", "\\|") for text in record)
            yield f"| `{option}` | {meaning} |"
