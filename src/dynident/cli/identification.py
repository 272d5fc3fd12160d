"""From files to a model: ``dynident init``, ``identify`` and ``export``."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.command_log import command_log
from dynident.cli.failures import command
from dynident.cli.options import ALLOW_CODE, DIRECTORY, FILE, LOG_NAME, WorkerOptions, add_worker_options
from dynident.cli.terminal import console, print_files, print_path, say_line, status
from dynident.runtime import Severity, choices, count, report_progress
from dynident.runtime.families import EXPORTERS

if TYPE_CHECKING:
    from dynident.apps.init.config_draft import ConfigDraft
    from dynident.cli.screen import Screen
    from dynident.files.folder import ResultFolder
    from dynident.files.tables import DataTable
    from dynident.identification import Identification
    from dynident.project.export import Export
    from dynident.project.project import Project

MAX_WARNINGS = 3  # of a fit; the others by --verbose
MAX_LEFT_OUT = 4  # quantities that a file cannot hold, named by export


@click.command(short_help="Draft a configuration for your robot and logs.")
@click.argument("robot", type=LOG_NAME)
@click.argument("logs", nargs=-1, required=True, type=LOG_NAME)
@click.option("-o", "--out", type=FILE, default="identify.yaml", show_default=True, help="The configuration to write.")
@click.option("--force", is_flag=True, help="Overwrite an existing configuration.")
def init(robot: str, logs: tuple[str, ...], out: Path, force: bool) -> None:
    """Write a configuration for `dynident identify`, with columns and units guessed from LOGS.

    ROBOT is a URDF or MJCF file, or gallery:NAME. The first log is fitted and the last one held out. Files that make
    one log together are joined by a plus sign: q.csv+tau.csv.
    """
    from dynident.files.opener import refuse_inputs, remember_inputs
    from dynident.files.results import write_text
    from dynident.runtime import InputError

    if os.path.lexists(out) and not force:
        raise InputError(f"{out}: exists already; choose another name with -o, or overwrite it with --force.")
    for file in (robot, robot.rpartition(":")[0], *logs, *(file.strip() for log in logs for file in log.split("+"))):
        remember_inputs(file)
    refuse_inputs(out)
    with status():
        written, tables = draft_from_files(robot, logs, out.parent)
    print_path(console(), "Configuration", write_text(out, written.text))
    _print_remarks(written, out, tables)


def draft_from_files(robot: str, logs: Sequence[str], folder: Path) -> tuple[ConfigDraft, list[DataTable]]:
    """Return the configuration drafted for a folder, and the tables that were read."""
    from dynident.apps.init.column_mapping import map_columns
    from dynident.apps.init.config_draft import check_same_columns, draft_config, read_source
    from dynident.apps.init.match import read_joints
    from dynident.apps.init.trial_fits import DraftFits
    from dynident.files.lerobot import recordings
    from dynident.files.xml_text import SUFFIXES

    joints = read_joints(robot)
    sources = []
    for log in recordings(logs):
        report_progress(f"reading {log}")
        sources.append(read_source(log))
    first_table, *other_tables = (source.table for source in sources)
    is_file = Path(robot).suffix.lower() in SUFFIXES
    mapping = map_columns(first_table, joints, sources[0].ros, other_tables, lockable=is_file)
    check_same_columns(mapping, sources)
    report_progress("looking at gains and gravity")
    fits = DraftFits(robot, joints, sources, folder)
    mapping = fits.with_gravity(fits.with_gains(mapping))
    return draft_config(robot, joints, mapping, sources, folder), [source.table for source in sources]


def _print_remarks(written: ConfigDraft, out: Path, tables: Sequence[DataTable]) -> None:
    """Print what to fill in and to confirm, and the next command."""
    screen = console()
    for note in written.notes:
        screen.remark(f"Note: {note}")
    known_notes = [note for table in tables for note in table.notes]
    notes = [note for table in tables for note in table.notes if note not in table.guesses]  # these are asked below
    for note in [*notes, *(() if written.blanks else _trial_warnings(written.text, out, known_notes))]:
        screen.remark(f"Warning: {note}", "yellow")
    for title, lines in (("Fill in:", written.blanks), ("Confirm or correct:", written.questions)):
        if lines:
            screen.say(title)
        for line in lines:
            screen.say(f"  {line}")
    lead = "Then" if written.blanks or written.questions else "Next"
    last = command("identify", out, "--out", f"{out.stem}-out") if written.servos else command("check", out)
    screen.remark(f"{lead}: {last}", no_wrap=True)


def _trial_warnings(text: str, out: Path, known_notes: Sequence[str]) -> list[str]:
    """Read the logs as the configuration says, and return the warnings or the error, without the ``known_notes``."""
    from dynident.apps.servo import read_servo_logs
    from dynident.project.drive_settings import ServoSettings
    from dynident.project.project import parse_project
    from dynident.runtime import DynidentError

    try:
        project = parse_project(text, out)
        if isinstance(project.config.simulation, ServoSettings):
            return [*project.warnings, *read_servo_logs(project)[1]]
        specs = (*project.config.train, *project.config.validation)
        known_warnings = {f"{spec.label}: {note}" for spec in specs for note in known_notes}
        return [warning for warning in (*project.warnings, *project.logs()[1]) if warning not in known_warnings]
    except DynidentError as error:
        return [f"the configuration cannot be used yet: {error}"]


@click.command(short_help="Identify parameters from recordings.")
@click.argument("config", type=FILE)
@click.option("--out", type=DIRECTORY, help="Folder for result.json, report.html, and the model's files.")
@click.option("--write-config", type=FILE, metavar="FILE", help="File (YAML) for the configuration with all choices.")
@add_worker_options
def identify(config: Path, out: Path | None, write_config: Path | None, spread: WorkerOptions) -> None:
    """Identify the parameters named in CONFIG (YAML) from its logs, and judge them on held-out logs.

    The result is a short summary; -v prints all tables. Logs too long for the memory (Parquet) are fitted in pieces by
    the workers; with --out an interrupted run continues where it stopped.
    """
    from dynident.apps.servo import identify_servos
    from dynident.cli.servo import print_servos
    from dynident.files.folder import result_folder
    from dynident.files.opener import refuse_inputs
    from dynident.files.results import write_text
    from dynident.identification import judge
    from dynident.project.drive_settings import ServoSettings
    from dynident.project.explicit_config import explicit_config
    from dynident.project.export import export_files, exports
    from dynident.project.export.proof import relocate_exports
    from dynident.project.project import read_project
    from dynident.report.identification.report import HEAD_SENTENCES, STYLES, verdict_text
    from dynident.report.identification.terms import choice_comments
    from dynident.runtime import ConfigError

    with result_folder(out) if out else nullcontext() as folder:
        with status():
            project = read_project(config)
            has_servos = isinstance(project.config.simulation, ServoSettings)
            if has_servos and write_config:
                raise ConfigError("--write-config: nothing is chosen for position servos; leave it out.")
            servos = identify_servos(project, folder) if has_servos else None
        if servos is not None:
            print_servos(servos, config, out)
            return
        with status():
            if write_config:
                refuse_inputs(_require_yaml_name(write_config))
            if out:
                names = ("result.json", "report.html", *export_files(project.model))
                refuse_inputs(*(out / name for name in names))
            # a cluster is asked for by name, so it also tries the smoothers of logs that fit the memory
            uses_cluster = spread.cluster is not None and len(project.recipe.smoothers) > 1
            is_spread = project.in_pieces or uses_cluster
            with spread.executor("dynident.project.long_recordings") if is_spread else nullcontext() as executor:
                state_folder = folder.path if folder else None
                identification = project.identify(executor=executor, limits=spread.limits, folder=state_folder)
            report_progress("writing and verifying the model")
            model_exports: tuple[Export, ...] = ()
            if folder:
                model_exports = relocate_exports(folder.path, exports(identification), identification.provenance)
        # written before anything is printed: the reader of a pipe may close it early
        written = write_result(folder, identification, model_exports) if folder else ()
        if write_config:
            text = explicit_config(identification, write_config, choice_comments(identification, config.name))
            write_text(write_config, text)
    screen = console()
    _show_result(screen, identification, model_exports)
    if spread.cluster is not None and not is_spread:
        screen.remark("Note: --cluster was not used: the logs fit the memory, and there is one smoother to try.")
    print_files(screen, written)
    if write_config:
        print_path(screen, "Configuration", write_config)
    is_chosen = identification.calibration.terms is not None and not write_config
    for k, line in enumerate(_next_commands(config, out, project, chose=is_chosen)):
        screen.remark(line, no_wrap=True, detail=k > 0)
    verdict = verdict_text(identification, None if command_log().verbose else HEAD_SENTENCES)
    screen.say(verdict, f"bold {STYLES[judge(identification).use]}")


def _show_result(screen: Screen, identification: Identification, model_exports: Sequence[Export]) -> None:
    """Print errors, the worst joint, the first warnings and the next step; by ``--verbose`` all tables and notes."""
    from dynident.report.identification import identification_notes, identification_tables
    from dynident.report.identification.head import summary_lines
    from dynident.report.identification.report import next_step_texts
    from dynident.report.identification.robot import export_notes
    from dynident.runtime.kernel import kernel

    for table in identification_tables(identification):
        screen.show(table, detail=True)
    screen.remark(f"Computed by {kernel()}.", detail=True)
    for text in summary_lines(identification):
        screen.say(text)
    warnings = 0
    for note in identification_notes(identification):
        warnings += note.severity is Severity.WARNING
        say_line(screen, note, detail=note.severity is not Severity.WARNING or warnings > MAX_WARNINGS)
    if warnings > MAX_WARNINGS and not command_log().verbose:
        screen.remark(f"{count(warnings - MAX_WARNINGS, 'more warning')}: -v shows all, with the tables.")
    for k, text in enumerate(export_notes(model_exports)):
        screen.remark(text, detail=k > 0)
    for k, step in enumerate(next_step_texts(identification)):
        screen.remark(f"Next: {step}", detail=k > 0)


def _require_yaml_name(path: Path) -> Path:
    """Return the path of a configuration to be written; raises ConfigError where its suffix is not that of YAML."""
    from dynident.runtime import ConfigError

    if path.suffix.lower() not in (".yaml", ".yml"):
        raise ConfigError(f"--write-config: {str(path)!r} is no name of a configuration; end it in .yaml.")
    return path


def _next_commands(config: Path, out: Path | None, project: Project, *, chose: bool) -> Iterator[str]:
    """Yield the next commands to type; ``chose`` tells that terms were chosen and not written out."""
    from dynident.project.logs import recording_argument

    if out is None:
        yield f"To keep this, with a report: {command('identify', config, '--out', f'{config.stem}-out')}"
    else:
        log = recording_argument(next(iter((*project.config.validation, *project.config.train))))
        result = out / "result.json"
        yield f"To predict the torque of a recording: {command('predict', result, log, '--out', out / 'torques.csv')}"
        yield f"To design what to record next: {command('excite', result, '-o', out / 'next')}"
        yield f"To export the model: {command('export', result, '--format', 'numpy', '--out', out / 'arm.py')}"
    if chose:
        explicit = config.with_name(f"{config.stem}-explicit.yaml")
        yield f"To write out the terms that were chosen: {command('identify', config, '--write-config', explicit)}"


def write_result(
    folder: ResultFolder, identification: Identification, model_exports: Sequence[Export]
) -> tuple[Path, ...]:
    """Write the model's files, result.json and report.html; return their paths."""
    from dynident.project.saved import model_files
    from dynident.report.identification.report import run_files

    files = {export.file: export.written.text for export in model_exports if export.ready and export.written}
    files |= run_files(identification, model_exports)
    # the models of an earlier run would pass for this one's
    return folder.replace(files, removed=model_files(folder.path / "result.json", identification.provenance))


def _check_format(ctx: click.Context, option: click.Parameter, kind: str) -> str:
    if kind not in EXPORTERS.kinds():
        raise click.BadParameter(f"{kind!r} is not a format; {choices(kind, EXPORTERS.kinds())}", ctx, option)
    return kind


@click.command(short_help="Write a saved result as a robot file, YAML, or Python module.")
@click.argument("result", type=FILE)
@click.option(
    "--format", "kind", metavar="|".join(EXPORTERS.table), required=True, callback=_check_format, help="Format."
)
@click.option("--out", type=FILE, required=True, help="File to write.")
@ALLOW_CODE
def export(result: Path, kind: str, out: Path, allow_code: bool) -> None:
    """Write the model in RESULT (the result.json of identify), after a check of its torque at random states.

    For servos, RESULT is servo.json.
    """
    from dataclasses import replace

    import numpy as np

    from dynident.files.opener import refuse_inputs, remember_inputs
    from dynident.files.results import probe_folder, write_text
    from dynident.project import export as exports
    from dynident.project.export import identified_model, random_states
    from dynident.project.export.proof import relocate_exports
    from dynident.project.saved import is_servo_result, load
    from dynident.report.identification.robot import export_notes
    from dynident.report.words import tiny
    from dynident.runtime import ModelError

    remember_inputs(result)
    refuse_inputs(out)
    probe_folder(out.parent)
    screen, remarks = console(), list[str]()
    if is_servo_result(result):
        from dynident.apps.servo import MODEL, load_servo_result

        if kind == "mjcf":  # that of an MJCF would keep its servos
            raise ModelError(f"{result}: the MJCF of servos is {result.parent / MODEL}, which identify has written.")
        servos = load_servo_result(result, allow_code=allow_code)
        identified, sources = servos.identified, servos.project.sources
        remarks += [*servos.warnings, *(f"Not in the file: {words}" for words in servos.left_out)]
    else:
        identification = load(result, allow_code=allow_code)
        identified, sources = identified_model(identification), identification.provenance
    refuse_inputs(out)
    states = random_states(len(identified.model.joints), np.random.default_rng(0))
    written = exports.export(identified, EXPORTERS.get(kind)(), states)
    (model_export,) = relocate_exports(out.parent, [written], sources)
    if not model_export.ready or model_export.written is None or model_export.proof is None:
        raise ModelError(f"{out}: not written: {model_export.refusal}")
    left_out = model_export.written.left_out
    shown = left_out if command_log().verbose else left_out[:MAX_LEFT_OUT]
    more = len(left_out) - len(shown)
    notes = export_notes([replace(model_export, file=out.name)], "listed here")
    notes += [f"Not in the file: {words}" for words in shown]
    notes += [f"Not in the file: {more} more; -v lists them."] * bool(more)
    for note in (*remarks, *notes, *(f"{words}." for words in model_export.proof.skipped)):
        screen.remark(note)
    difference = tiny(model_export.proof.agreement)
    screen.remark(f"Reloaded: the largest difference of a joint's torque, relative to its norm, is {difference}.")
    print_path(screen, "Model", write_text(out, model_export.written.text))
