"""``dynident predict``: the torque of new recordings, from a saved result."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.options import ALLOW_CODE, FILE, LOG_NAME, RESULT
from dynident.cli.terminal import console, say_line, status, tell

if TYPE_CHECKING:
    from dynident.cli.screen import Screen
    from dynident.identification import Identification
    from dynident.validation import LogValidation

__all__ = ["predict"]


@click.command(short_help="Predict the torque of recordings from a saved result.")
@click.argument("result", type=RESULT)
@click.argument("logs", nargs=-1, required=True, metavar="LOG...", type=LOG_NAME)
@click.option("--out", type=FILE, help="Table of measured and predicted torques (.csv or .parquet).")
@ALLOW_CODE
def predict(result: Path, logs: tuple[str, ...], out: Path | None, allow_code: bool) -> None:
    """Predict the torque of each LOG with the model in RESULT (the result.json of identify).

    LOG has the channels of the configuration that was identified; torques may be missing. Where the configuration
    names several files for a recording, LOG is key=file,key=file.
    """
    from dynident.errors import ConfigError
    from dynident.io.opener import keep, refuse_inputs
    from dynident.io.results import probe_folder, table_kind, write_table
    from dynident.io.saved import load
    from dynident.report.prediction import prediction_frame, prediction_table
    from dynident.report.wording import old_result_lines

    if out:
        table_kind(out)
        keep(result)
        for text in logs:
            for file in (text, *(part.rpartition("=")[2] for part in text.split(","))):
                keep(file)
        refuse_inputs(out)
        probe_folder(out.parent)
    screen = console()
    with status() as say:
        say("reading the result")
        saved = load(result, allow_code=allow_code)
        if out:
            refuse_inputs(out)
        for line in old_result_lines(saved):
            say_line(screen, line)
        found = _predicted(saved, logs, allow_code, screen, say)
    measured = [one for one, known in found if known]
    if measured:
        screen.show(prediction_table(measured, saved.model.joints))
    unknown = [one.name for one, known in found if not known]
    if unknown and not out:
        raise ConfigError(f"{', '.join(unknown)}: there are no torques to compare with; give --out a file.")
    if out:
        tell(screen, "Torques", write_table(out, prediction_frame(found)))


def _predicted(
    saved: Identification, logs: tuple[str, ...], allow_code: bool, screen: Screen, say: Callable[[str], None]
) -> list[tuple[LogValidation, bool]]:
    """Return the prediction of every log, and whether its torques are known; print what reading warns of."""
    from dynident.io.saved import read_log_like

    found = []
    for text in logs:
        say(f"predicting {text}")
        reading = read_log_like(saved, text, allow_code=allow_code)
        for warning in reading.warnings:
            screen.remark(f"Warning: {warning}", "yellow")
        found += [(saved.predict(log), reading.measured) for log in reading.logs]
    return found
