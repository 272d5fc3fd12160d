"""A robot in use: ``dynident excite``, ``payload``, ``watch`` and ``tune``."""

from __future__ import annotations

import json
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dynident.cli.command_log import print_error
from dynident.cli.failures import command
from dynident.cli.options import (
    ALLOW_CODE,
    DIRECTORY,
    FILE,
    LOG_NAME,
    POSITIVE,
    WorkerOptions,
    add_worker_options,
    parse_noise,
)
from dynident.cli.terminal import console, print_files, print_path, say_line, status
from dynident.runtime import report_progress

if TYPE_CHECKING:
    from dynident.apps.online.watch import Watch
    from dynident.apps.payload import Payload
    from dynident.files.folder import ResultFolder
    from dynident.identification import Identification

PROGRAMS = ("motion", "friction", "gravity", "all")


@click.command(short_help="Design a motion that shows the parameters of a robot.")
@click.argument("robot", type=FILE)
@click.option(
    "-o", "--out", type=DIRECTORY, required=True,
    help="Folder for the motions (CSV, NumPy) and programs that play them, identify.yaml and report.html.",
)  # fmt: skip
@click.option(
    "--settings", type=FILE, metavar="FILE",
    help="File (YAML) of the settings, limits and obstacles.  [default: section `excitation` of a configuration]",
)  # fmt: skip
@click.option(
    "--program", type=click.Choice(PROGRAMS),
    help="An optimised motion, constant speeds of each joint, poses for gravity, or all of these.",
)  # fmt: skip
@click.option(
    "--for", "purpose", type=click.Choice(["torque", "servo"]), default="torque", show_default=True,
    help="Motion for logs with torques; or commands (CSV, chirps) for position servos, which log none.",
)  # fmt: skip
@click.option("--duration", type=POSITIVE, metavar="S", help="Longest duration, with approach and return.")
@click.option("--criterion", type=click.Choice(["d", "a", "condition"]), help="What is optimised.")
@click.option("--parameter", multiple=True, metavar="NAME", help="Parameter that matters (criterion a); repeat it.")
@click.option("--family", type=click.Choice(["fourier", "bspline"]), help="Periodic (fourier) or single (bspline).")
@click.option("--period", type=POSITIVE, metavar="S", help="Seconds of a period.")
@click.option("--harmonics", type=click.IntRange(1), help="Harmonics of a period.")
@click.option("--rate", type=POSITIVE, metavar="HZ", help="Rate of the recording.")
@click.option("--file-rate", type=POSITIVE, metavar="HZ", help="Rate of the files.  [default: that of the recording]")
@click.option("--floor", type=float, metavar="M", help="Height of a floor, along z of the root link.")
@click.option(
    "--package", multiple=True, type=DIRECTORY,
    help="Folder of a package (package://) with the robot's meshes, or one around it; repeat it.",
)  # fmt: skip
@click.option("--grippers", is_flag=True, default=None, help="Move the joints of grippers, too.")
@click.option("--noise", multiple=True, help="Torque noise (N m, N): a number, or joint=number; repeat it.")
@click.option("--starts", type=click.IntRange(1), help="How many times the search starts again.")
@click.option("--seed", type=click.IntRange(0), help="Seed of the random starts: another seed gives another motion.")
@ALLOW_CODE
@add_worker_options
def excite(
    robot: Path, out: Path, settings: Path | None, parameter: tuple[str, ...], package: tuple[Path, ...],
    noise: tuple[str, ...], purpose: str, allow_code: bool, spread: WorkerOptions, **options: Any,
) -> None:  # fmt: skip
    """Design the motion that determines the parameters of ROBOT best within its limits, and another one for validation.
    The report predicts how accurate a result will be.

    ROBOT is a robot file (URDF, MJCF), a configuration (YAML), or the result.json of identify, whose recordings the
    motion then complements. Options replace the settings. Ctrl-C ends the search with the best motion so far.
    """
    from functools import partial

    from dynident.apps.excitation.expected_report import expected_findings, noise_words, room_findings
    from dynident.apps.excitation.report import NO_TRIAL, TRIAL, excitation_heading, limit_use_table
    from dynident.apps.excitation.robot import read_excitation
    from dynident.apps.excitation.run import CONFIG as DRAFT
    from dynident.apps.excitation.run import refuse_targets, write_design
    from dynident.cli.servo import write_chirps
    from dynident.files.folder import result_folder

    changes = {name: value for name, value in options.items() if value is not None}
    changes |= {"parameters": list(parameter), "criterion": "a"} if parameter else {}
    changes |= {"packages": list(package)} if package else {}
    changes |= {} if (size := parse_noise("--noise", noise)) is None else {"noise": size}
    if purpose == "servo":
        write_chirps(robot, out, settings, changes, allow_code=allow_code)
        return
    with result_folder(out) as folder, status():
        ready = partial(refuse_targets, folder.path)
        project = read_excitation(robot, settings, changes, ready=ready, allow_code=allow_code)
        with spread.executor("dynident.apps.excitation.design") as executor:
            design = project.design(executor)
        report_progress("writing the motions")
        written = write_design(folder, project, design)
    screen = console()
    screen.show(limit_use_table(design), detail=True)
    told, *details = expected_findings(design)
    for line in (*details, *noise_words(project)):
        screen.remark(line, detail=True)
    for line in room_findings(project, design):
        screen.remark(line)
    if not any(path.name.startswith(f"{TRIAL}.") for path in written):
        screen.remark(NO_TRIAL)
    print_files(screen, [path for path in written if path.suffix != ".npz"])
    screen.remark(
        "Beside each motion (.csv) are the same as .npz and programs that play it (ROS 2, and where the arm is known "
        "libfranka or URScript); their heads say how.",
        detail=True,
    )
    if any(path.name == DRAFT for path in written):
        screen.remark(f"Next, when both are recorded: {command('check', out / DRAFT)}", no_wrap=True)
    screen.say(f"{excitation_heading(design)} {told}", "bold")


@click.command(short_help="Identify the payload of an arm.")
@click.argument("result", type=FILE)
@click.argument("loaded", nargs=-1, required=True, metavar="LOADED...", type=LOG_NAME)
@click.option("--unloaded", multiple=True, type=LOG_NAME, help="Recording of the day without payload; repeat it.")
@click.option("--frame", help="Link that carries the payload; default: the flange.")
@click.option("--known-mass", type=float, metavar="KG", help="Weighed mass, to find the gains of the drives.")
@click.option(
    "--known-centre", type=float, nargs=3, metavar="X Y Z",
    help="Known centre of mass in the frame (m), to find the gains of the wrist.",
)  # fmt: skip
@click.option("--gains", type=FILE, help="payload.json of a payload of known mass, for the gains of the drives.")
@click.option(
    "--gain-error", type=float, default=3.0, show_default=True, metavar="PERCENT",
    help="Standard deviation of the gains of the drives, of all together and of each.",
)  # fmt: skip
@click.option(
    "--gain-change", type=float, default=1.0, show_default=True, metavar="PERCENT",
    help="How much the gain of a drive may have changed since RESULT was identified.",
)  # fmt: skip
@click.option(
    "--friction-change", type=float, default=30.0, show_default=True, metavar="PERCENT",
    help="Expected drift of friction and offsets, as a share of the joint's friction.",
)  # fmt: skip
@click.option(
    "--load-friction", type=float, default=5.0, show_default=True, metavar="PERCENT",
    help="Expected friction that grows with the load and is not in the model, as a share of the load.",
)  # fmt: skip
@click.option("--removed", is_flag=True, help="The payload was removed after RESULT was identified.")
@click.option("--out", type=DIRECTORY, help="Folder for payload.json, report.html, and a URDF with the payload.")
@ALLOW_CODE
def payload(
    result: Path, loaded: tuple[str, ...], unloaded: tuple[str, ...], frame: str | None, known_mass: float | None,
    known_centre: tuple[float, float, float] | None, gains: Path | None, gain_error: float, gain_change: float,
    friction_change: float, load_friction: float, removed: bool, out: Path | None, allow_code: bool,
) -> None:  # fmt: skip
    """Identify mass, centre of mass and inertia of the payload of an arm; RESULT is the result.json of identify.

    LOADED are recordings with the payload, or the result.json of such recordings. They have the channels of the
    configuration that was identified.
    """
    from dataclasses import replace

    from dynident.apps.payload import NoPayload, PayloadRequest, find_payload
    from dynident.apps.payload.config import NUMBERS, payload_logs, payload_name, read_arm, read_gains, read_loaded
    from dynident.apps.payload.report import gains_table, payload_table, payload_words, shares_table, torque_table
    from dynident.files.folder import refuse_other_report, result_folder
    from dynident.files.opener import refuse_inputs, remember_inputs
    from dynident.report.words import note_lines

    if out:
        refuse_other_report(out, NUMBERS)
    for file in (result, *([gains] if gains else [])):
        remember_inputs(file)
    with result_folder(out) if out else nullcontext() as folder:
        with status():
            known_gains = read_gains(gains) if gains else None
            request = PayloadRequest(
                frame, known_mass, known_centre, gain_error, known_gains, friction_change, load_friction, removed,
                gain_change,
            )  # fmt: skip
            report_progress("reading the result")
            saved = read_arm(result, allow_code=allow_code)
            if out:
                refuse_inputs(*(out / name for name in (NUMBERS, "report.html", payload_name(saved))))
            loaded_logs, warnings = read_loaded(saved, loaded, allow_code=allow_code)
            unloaded_logs, notes, unloaded_warnings = payload_logs(saved, unloaded, allow_code=allow_code, new=True)
            estimate = find_payload(saved, loaded_logs, unloaded_logs, request)
            estimate = replace(estimate, notes=(*notes, *estimate.notes))
        written, urdf_notes = _write_payload(folder, estimate, saved) if folder else ((), ())
    screen = console()
    for table in (payload_table(estimate), shares_table(estimate), *torque_table(estimate), *gains_table(estimate)):
        screen.show(table, detail=True)
    for line in note_lines(note for note in estimate.notes if not isinstance(note, NoPayload)):
        say_line(screen, line)
    for words in (*warnings, *unloaded_warnings, *urdf_notes):
        screen.remark(f"Note: {words}")
    print_files(screen, written)
    if out and known_mass is not None:
        next_command = command("payload", result, "LOADED", "--gains", out / "payload.json")
        screen.remark(f"To find another payload with these gains: {next_command}", no_wrap=True)
    screen.say(payload_words(estimate), "bold")


def _write_payload(
    folder: ResultFolder, estimate: Payload, saved: Identification
) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Write the files of a payload; return their paths, and notes on the URDF."""
    from dynident.apps.payload.config import payload_data, payload_name, payload_urdf
    from dynident.apps.payload.report import payload_page
    from dynident.files.results import json_text
    from dynident.runtime import ModelError

    notes = [str(note) for note in estimate.notes]
    files = {"payload.json": json_text(payload_data(estimate, saved.provenance, notes))}
    files["report.html"] = payload_page(estimate, saved)
    urdf_notes: tuple[str, ...] = ()
    try:
        files[payload_name(saved)], urdf_notes = payload_urdf(saved, estimate, folder.path)
    except ModelError as error:
        urdf_notes = (f"no URDF with the payload is written: {error}",)
    return folder.replace(files), urdf_notes


@click.command(short_help="Watch a robot and report changes.")
@click.argument("result", type=FILE)
@click.argument("stream", metavar="FILE|-", type=LOG_NAME)
@click.option("--out", type=DIRECTORY, help="Folder for changes.jsonl and the state, to continue a stopped watch.")
@click.option("--once", is_flag=True, help="Stop at the end of FILE, instead of waiting for more.")
@click.option(
    "--false-alarms", type=float, default=0.03, show_default=True, metavar="PER_DAY",
    help="Accepted rate of false alarms per day.",
)  # fmt: skip
@click.option(
    "--baseline", type=float, default=600.0, show_default=True, metavar="S",
    help="Seconds at the start that serve as the reference; nothing should change during them.",
)  # fmt: skip
@click.option(
    "--block", type=float, default=5.0, show_default=True, metavar="S", help="Seconds that are tested together."
)
@click.option(
    "--tolerance", type=float, default=0.05, show_default=True,
    help="Changes of the torque below this share of its noise are ignored.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print each event as a JSON object in a line.")
@ALLOW_CODE
def watch(
    result: Path, stream: str, out: Path | None, once: bool, false_alarms: float, baseline: float, block: float,
    tolerance: float, as_json: bool, allow_code: bool,
) -> None:  # fmt: skip
    """Watch a robot with the model in RESULT (the result.json of identify), and report changes of friction, payload,
    offsets and unexplained torque, and sensors that fail.

    FILE is a text file to which another program appends lines, with the columns of the configuration that was
    identified. "-" is standard input, with such lines or JSON objects. Other recordings (Parquet, a bag, ...) are
    read to their end. With --out the same command continues where it stopped.
    """
    from dynident.apps.online import WatchSettings
    from dynident.apps.online.recorded import is_recorded
    from dynident.apps.online.report import end_words, watch_words
    from dynident.apps.online.watch import make_watch
    from dynident.files.folder import result_folder
    from dynident.files.opener import remember_inputs

    settings = WatchSettings(false_alarms, block, baseline, 6 * block, tolerance)
    remember_inputs(result)
    if stream != "-":
        remember_inputs(stream)
    with result_folder(out) if out else nullcontext() as folder:
        with status():
            robot_watch = make_watch(result, stream, settings, folder, allow_code=allow_code)
        if not as_json:
            console().remark(watch_words(settings))
            if is_recorded(stream) and not once:
                console().remark(f"{stream} is no text that can be followed while it grows: it is watched to its end.")
        _print_events(robot_watch, as_json, follow=not once)
    if not as_json:
        console().remark(end_words(robot_watch.watcher, robot_watch.events, robot_watch.reader.zero))
    if out and not as_json:
        from dynident.apps.online.event_log import EVENTS

        print_path(console(), "Changes", out / EVENTS)


def _print_events(robot_watch: Watch, as_json: bool, *, follow: bool) -> None:
    """Print events as they come."""
    from dynident.apps.online.event_log import event_data
    from dynident.apps.online.report import event_line
    from dynident.runtime import Severity

    screen = console()
    try:
        for event in robot_watch.run(follow=follow):
            if as_json:
                click.echo(json.dumps(event_data(event)))
                continue
            line = event_line(event, robot_watch.watcher.joints, robot_watch.reader.zero)
            if line.severity is Severity.WARNING:
                screen.say(line.text, "yellow")
            else:
                say_line(screen, line)
    except KeyboardInterrupt as stop:
        if robot_watch.folder is None:
            stop.add_note("nothing is kept; with --out FOLDER a watch goes on where it stopped.")
        else:
            stop.add_note(f"{robot_watch.folder.path}: the state is saved; the same command goes on.")
        raise


@click.command(short_help="See and tune smoothing and fit in a browser.")
@click.argument("config", type=FILE)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, metavar="N", help="Port of this machine; by default a free one."
)
@click.option("--no-browser", is_flag=True, help="Print the address, and open no browser.")
def tune(config: Path, port: int, no_browser: bool) -> None:
    """Show the logs of CONFIG (YAML) as they are smoothed and fitted, on a page with controls for smoothing, samples,
    terms, joints and estimator. The settings can be saved as a new configuration beside CONFIG.

    Only this machine can open the page. Ctrl-C ends it.
    """
    from dynident.apps.tuning import serve_configuration
    from dynident.apps.tuning.server import answer, open_browser
    from dynident.cli.command_log import escape_controls

    with ExitStack() as stack:
        with status():
            serving = serve_configuration(config, port, lambda text: print_error(escape_controls(text)))
            address, server = stack.enter_context(serving)
        screen = console()
        screen.say(str(address), no_wrap=True)
        screen.remark("This address is for this machine alone. Ctrl-C ends it.")
        if not no_browser:
            open_browser(address)
        try:
            answer(server)
        except KeyboardInterrupt as stop:
            if hasattr(stop, "number"):  # another signal than Ctrl-C, which is how a person ends it
                raise
