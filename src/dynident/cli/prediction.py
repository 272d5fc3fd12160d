"""What a saved result says of other recordings: ``dynident predict``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.options import ALLOW_CODE, FILE, LOG_NAME
from dynident.cli.terminal import console, print_path, say_line, status
from dynident.runtime import report_progress

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.report.words import Line
    from dynident.validation import LogValidation


@click.command(short_help="Predict the torque of recordings from a saved result.")
@click.argument("result", type=FILE)
@click.argument("logs", nargs=-1, required=True, metavar="LOG...", type=LOG_NAME)
@click.option("--out", type=FILE, help="Table of measured and predicted torques (.csv or .parquet).")
@ALLOW_CODE
def predict(result: Path, logs: tuple[str, ...], out: Path | None, allow_code: bool) -> None:
    """Predict the torque of each LOG with the model in RESULT (the result.json of identify).

    For servos, RESULT is servo.json, and positions are predicted from the commands in LOG.

    LOG has the channels of the configuration that was identified; torques may be missing. Where the configuration
    names several files for a recording, LOG is key=file,key=file.
    """
    from dynident.files.opener import refuse_inputs, remember_inputs
    from dynident.files.results import probe_folder, table_kind, write_table
    from dynident.project.saved import is_servo_result, load
    from dynident.report.identification.validation import prediction_frame, prediction_table
    from dynident.runtime import ConfigError

    if out:
        table_kind(out)
        remember_inputs(result)
        for text in logs:
            for file in (text, *(part.rpartition("=")[2] for part in text.split(","))):
                remember_inputs(file)
        refuse_inputs(out)
        probe_folder(out.parent)
    screen = console()
    if is_servo_result(result):
        from dynident.apps.servo import predict_servos
        from dynident.cli.servo import print_prediction

        with status():
            prediction = predict_servos(result, logs, allow_code=allow_code)
            if out:
                refuse_inputs(out)
        print_prediction(prediction, out)
        return
    with status():
        report_progress("reading the result")
        saved = load(result, allow_code=allow_code)
        if out:
            refuse_inputs(out)
        predictions, warnings = _predict_logs(saved, logs, allow_code)
    for line in warnings:
        say_line(screen, line)
    measured = [validation for validation, has_torque in predictions if has_torque]
    if measured:
        screen.show(prediction_table(measured, saved.model.joints))
    unknown = [validation.name for validation, has_torque in predictions if not has_torque]
    if unknown and not out:
        raise ConfigError(f"{', '.join(unknown)}: there are no torques to compare with; give --out a file.")
    if out:
        print_path(screen, "Torques", write_table(out, prediction_frame(predictions)))


def _predict_logs(
    saved: Identification, logs: tuple[str, ...], allow_code: bool
) -> tuple[list[tuple[LogValidation, bool]], list[Line]]:
    """Return the prediction of every log, with whether its torques are known, and the warnings of reading."""
    from dynident.identification import substitute_notes
    from dynident.project.saved import read_log_like
    from dynident.report.words import Line, note_lines
    from dynident.runtime import Severity

    predictions, warnings = [], []
    for text in logs:
        report_progress(f"predicting {text}")
        reading = read_log_like(saved, text, allow_code=allow_code)
        warnings += [Line(f"Warning: {words}", Severity.WARNING) for words in reading.warnings]
        validations = [saved.predict(log) for log in reading.logs]
        warnings += note_lines(substitute_notes(validations))
        predictions += [(validation, reading.measured) for validation in validations]
    return predictions, warnings
