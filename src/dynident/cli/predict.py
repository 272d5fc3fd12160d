"""``dynident predict``: the torque of new recordings, from a saved result."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.options import ALLOW_CODE, FILE, LOG_NAME, RESULT
from dynident.cli.terminal import console, say_line, status, tell

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.report.wording import Line
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
        found, warnings = _predicted(saved, logs, allow_code, say)
    for line in (*old_result_lines(saved), *warnings):
        say_line(screen, line)
    measured = [one for one, known in found if known]
    if measured:
        screen.show(prediction_table(measured, saved.model.joints))
    unknown = [one.name for one, known in found if not known]
    if unknown and not out:
        raise ConfigError(f"{', '.join(unknown)}: there are no torques to compare with; give --out a file.")
    if out:
        tell(screen, "Torques", write_table(out, prediction_frame(found)))


def _predicted(
    saved: Identification, logs: tuple[str, ...], allow_code: bool, say: Callable[[str], None]
) -> tuple[list[tuple[LogValidation, bool]], list[Line]]:
    """Return the prediction of every log, and whether its torques are known; and what reading warns of."""
    from dynident.errors import Severity
    from dynident.identification import substituted
    from dynident.io.saved import read_log_like
    from dynident.report.wording import Line, note_lines

    found, warnings = [], []
    for text in logs:
        say(f"predicting {text}")
        reading = read_log_like(saved, text, allow_code=allow_code)
        warnings += [Line(f"Warning: {words}", Severity.WARNING) for words in reading.warnings]
        made = [saved.predict(log) for log in reading.logs]
        warnings += note_lines(substituted(made))
        found += [(one, reading.measured) for one in made]
    return found, warnings
