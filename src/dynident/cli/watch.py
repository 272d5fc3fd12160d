"""``dynident watch``: a robot watched by a file that grows, or by standard input."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.options import ALLOW_CODE, DIRECTORY, LOG_NAME, RESULT
from dynident.cli.terminal import console, say_line, status, tell

if TYPE_CHECKING:
    from dynident.io.watch_run import Watch

__all__ = ["watch"]


@click.command(short_help="Watch a robot, and say what changes.")
@click.argument("result", type=RESULT)
@click.argument("stream", metavar="FILE|-", type=LOG_NAME)
@click.option("--out", type=DIRECTORY, help="Folder for changes.jsonl and the state, by which a stopped watch goes on.")
@click.option("--once", is_flag=True, help="Stop at the end of FILE, instead of waiting for more.")
@click.option(
    "--false-alarms", type=float, default=0.03, show_default=True, metavar="PER_DAY",
    help="Changes found by chance in a day of a robot that does not change.",
)  # fmt: skip
@click.option(
    "--baseline", type=float, default=600.0, show_default=True, metavar="S",
    help="Seconds at the start that show what is usual; nothing should change in them.",
)  # fmt: skip
@click.option(
    "--block", type=float, default=5.0, show_default=True, metavar="S", help="Seconds that are looked at together."
)
@click.option(
    "--tolerance", type=float, default=0.05, show_default=True,
    help="Changes of the torque by this share of its noise are none.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print each event as a JSON object in a line.")
@ALLOW_CODE
def watch(
    result: Path,
    stream: str,
    out: Path | None,
    once: bool,
    false_alarms: float,
    baseline: float,
    block: float,
    tolerance: float,
    as_json: bool,
    allow_code: bool,
) -> None:
    """Watch a robot by the model in RESULT (the result.json of identify): friction, payload, offsets, what the model
    leaves, and sensors that fail.

    FILE is a text file that another program adds lines to, with the columns of the configuration that was identified;
    "-" is standard input, with such lines or JSON objects by column. A file may be rotated. With --out the same command
    goes on where it stopped, however it was stopped.
    """
    from dynident.io.folder import result_folder
    from dynident.io.opener import keep
    from dynident.io.saved import load
    from dynident.io.watch_run import watch_of
    from dynident.online import WatchSettings
    from dynident.report.watch import Stamps, end_words, watch_words

    how = WatchSettings(false_alarms, block, baseline, 6 * block, tolerance)
    keep(result)
    if stream != "-":
        keep(stream)
    with result_folder(out) if out else nullcontext() as folder:
        with status() as say:
            say("reading the result")
            found = load(result, allow_code=allow_code)
            say("computing the threshold")
            one = watch_of(found, result, stream, how, folder, allow_code=allow_code)
        if not as_json:
            console().remark(watch_words(how))
        _say(one, as_json, follow=not once)
    if not as_json:
        console().remark(end_words(one.watcher, one.events, Stamps(one.reader.zero)))
    if out and not as_json:
        from dynident.io.watch_run import EVENTS

        tell(console(), "Changes", out / EVENTS)


def _say(one: Watch, as_json: bool, *, follow: bool) -> None:
    """Print events as they come."""
    from dynident.errors import Severity
    from dynident.io.watch_run import event_data
    from dynident.report.watch import Stamps, event_line

    screen = console()
    try:
        for event in one.run(follow=follow):
            if as_json:
                click.echo(json.dumps(event_data(event)))
                continue
            line = event_line(event, one.watcher.joints, Stamps(one.reader.zero))
            if line.severity is Severity.WARNING:
                screen.say(line.text, "yellow")
            else:
                say_line(screen, line)
    except KeyboardInterrupt as stop:
        if one.folder is None:
            stop.add_note("nothing is kept; with --out FOLDER a watch goes on where it stopped.")
        else:
            stop.add_note(f"{one.folder.path}: the state is saved; the same command goes on.")
        raise
