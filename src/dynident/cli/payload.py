"""``dynident payload``: what an arm carries, from a saved result and recordings with the payload."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.launcher import command
from dynident.cli.options import ALLOW_CODE, DIRECTORY, LOG_NAME, RESULT
from dynident.cli.terminal import console, say_line, status, tell

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.io.folder import ResultFolder
    from dynident.payload import Payload

__all__ = ["payload"]


@click.command(short_help="Identify what the arm carries.")
@click.argument("result", type=RESULT)
@click.argument("loaded", nargs=-1, required=True, metavar="LOADED...", type=LOG_NAME)
@click.option("--unloaded", multiple=True, type=LOG_NAME, help="Recording of the same day without it; repeat it.")
@click.option("--frame", help="Link that carries it; else the flange.")
@click.option("--known-mass", type=float, metavar="KG", help="Its mass, weighed: finds the gains of the drives.")
@click.option(
    "--known-centre", type=float, nargs=3, metavar="X Y Z",
    help="Its centre of mass in the frame (m), where that is known, too: for the gains of the wrist.",
)  # fmt: skip
@click.option("--gains", type=RESULT, help="payload.json of a payload of known mass, for the gains of the drives.")
@click.option(
    "--gain-error", type=float, default=3.0, show_default=True, metavar="PERCENT",
    help="How wrong the gains of the drives may be, all together and each (one standard deviation).",
)  # fmt: skip
@click.option(
    "--friction-change", type=float, default=30.0, show_default=True, metavar="PERCENT",
    help="How much friction and offsets may have drifted, and friction changed by the load, of a joint's friction.",
)  # fmt: skip
@click.option(
    "--load-friction", type=float, default=5.0, show_default=True, metavar="PERCENT",
    help="Friction that grows with the load, and is not in the model: about so much of the load.",
)  # fmt: skip
@click.option("--removed", is_flag=True, help="The arm carried it when RESULT was identified, and does no more.")
@click.option("--out", type=DIRECTORY, help="Folder for payload.json, report.html, and a URDF with the payload.")
@ALLOW_CODE
def payload(
    result: Path, loaded: tuple[str, ...], unloaded: tuple[str, ...], frame: str | None, known_mass: float | None,
    known_centre: tuple[float, float, float] | None, gains: Path | None, gain_error: float, friction_change: float,
    load_friction: float, removed: bool, out: Path | None, allow_code: bool,
) -> None:  # fmt: skip
    """Identify mass, centre of mass and inertia of what the arm in RESULT (the result.json of identify) carries.

    LOADED are recordings with the payload, with the channels of the configuration that was identified, or the
    result.json of such recordings.
    """
    from dataclasses import replace

    from dynident.io.folder import result_folder
    from dynident.io.opener import keep, refuse_inputs
    from dynident.io.payload import (
        NUMBERS,
        check_places,
        payload_logs,
        payload_name,
        read_arm,
        read_gains,
        read_loaded,
    )
    from dynident.payload import NoPayload, Request, find_payload
    from dynident.report.payload import gains_table, payload_table, payload_words, shares_table, torque_table
    from dynident.report.wording import note_lines, old_result_lines

    check_places(loaded, unloaded, out)
    for file in (result, *([gains] if gains else [])):
        keep(file)
    with result_folder(out) if out else nullcontext() as folder:
        with status() as say:
            known = read_gains(gains) if gains else None
            request = Request(
                frame, known_mass, known_centre, gain_error, known, friction_change, load_friction, removed
            )
            say("reading the result")
            saved = read_arm(result, allow_code=allow_code)
            if out:
                refuse_inputs(*(out / name for name in (NUMBERS, "report.html", payload_name(saved))))
            with_it, warnings = read_loaded(saved, loaded, allow_code=allow_code, say=say)
            without, notes, more = payload_logs(saved, unloaded, allow_code=allow_code, new=True, say=say)
            found = find_payload(saved, with_it, without, request, progress=say)
            found = replace(found, notes=(*notes, *found.notes))
        written, said = _write(folder, found, saved) if folder else ([], ())
    screen = console()
    screen.say(payload_words(found), "bold")
    for table in (payload_table(found), shares_table(found), *torque_table(found), *gains_table(found)):
        screen.show(table)
    for line in (*old_result_lines(saved), *note_lines(one for one in found.notes if not isinstance(one, NoPayload))):
        say_line(screen, line)
    for words in (*warnings, *more, *said):
        screen.remark(f"Note: {words}")
    for what, path in written:
        tell(screen, what, path)
    if out and known_mass is not None:
        next_one = command("payload", result, "LOADED", "--gains", out / "payload.json")
        screen.remark(f"To find another payload with these gains: {next_one}", whole=True)


def _write(
    folder: ResultFolder, found: Payload, saved: Identification
) -> tuple[list[tuple[str, Path]], tuple[str, ...]]:
    """Write the files of a payload; return what was written where, and what to say of the URDF."""
    from dynident.errors import ModelError
    from dynident.io.payload import payload_data, payload_name, payload_urdf
    from dynident.io.results import json_text
    from dynident.report.payload import payload_page
    from dynident.report.wording import words

    notes = [words(note) for note in found.notes]
    files = {"payload.json": json_text(payload_data(found, saved.provenance, notes))}
    files["report.html"] = payload_page(found, saved)
    said: tuple[str, ...] = ()
    try:
        files[payload_name(saved)], said = payload_urdf(saved, found, folder.path)
    except ModelError as error:
        said = (f"no URDF with the payload is written: {error}",)
    paths = folder.replace(files)
    kinds = ("Payload", "Report", "Robot with the payload")
    return list(zip(kinds, paths, strict=False)), said
