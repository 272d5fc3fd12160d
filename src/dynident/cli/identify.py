"""``dynident identify``: from a configuration to parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.launcher import command
from dynident.cli.options import CONFIG, DIRECTORY
from dynident.cli.terminal import console, say_line, status, tell
from dynident.cli.workers import Spread, spread

if TYPE_CHECKING:
    from dynident.export import Export
    from dynident.identification import Identification
    from dynident.io.folder import ResultFolder
    from dynident.io.project import Project

__all__ = ["identify", "write_result"]


@click.command(short_help="Identify parameters from recordings.")
@click.argument("config", type=CONFIG)
@click.option("--out", type=DIRECTORY, help="Folder for result.json, report.html, and the model's files.")
@click.option(
    "--write-config",
    type=CONFIG,
    metavar="FILE",
    help="File (YAML) for the same configuration with all that was chosen written out.",
)
@spread
def identify(config: Path, out: Path | None, write_config: Path | None, spread: Spread) -> None:
    """Identify the parameters named in CONFIG (YAML) from its logs, and judge them on held-out logs.

    Logs too long for the memory (Parquet) are fitted in pieces, by the workers; with --out an interrupted run goes on
    where it stopped.
    """
    from dynident.export import export_files, exports
    from dynident.identification import judge
    from dynident.io.explicit_config import explicit_config
    from dynident.io.folder import result_folder
    from dynident.io.model_files import moved_to
    from dynident.io.opener import refuse_inputs
    from dynident.io.project import read_project
    from dynident.io.results import write_text
    from dynident.kernel import kernel
    from dynident.report import identification_notes, identification_tables
    from dynident.report.exports import export_notes
    from dynident.report.terms import choice_comments
    from dynident.report.verdict import STYLES, verdict_text
    from dynident.report.wording import Line

    with result_folder(out) if out else nullcontext() as folder:
        with status() as say:
            project = read_project(config, say)
            if write_config:
                refuse_inputs(_named_yaml(write_config))
            if out:
                names = ("result.json", "report.html", *export_files(project.model))
                refuse_inputs(*(out / name for name in names))
            with spread.executor("dynident.io.long_run") if project.long else nullcontext() as executor:
                kept = folder.path if folder else None
                found = project.identify(say, executor=executor, limits=spread.limits, folder=kept)
            say("writing and verifying the model")
            made = moved_to(folder.path, exports(found), found.provenance) if folder else ()
        # written before anything is printed: the reader of a pipe may close it early
        written = write_result(folder, found, made) if folder else []
        if write_config:
            text = explicit_config(found, write_config, choice_comments(found, config.name))
            written.append(("Configuration", write_text(write_config, text)))
    screen = console()
    verdict, steps = verdict_text(found)
    screen.say(verdict, f"bold {STYLES[judge(found).use]}")
    for table in identification_tables(found):
        screen.show(table)
    for note in (*identification_notes(found), *map(Line, export_notes(made))):
        say_line(screen, note)
    for step in steps:
        screen.remark(f"Next: {step}")
    screen.remark(f"Computed by {kernel()}.")
    for what, path in written:
        tell(screen, what, path)
    for line in _next(config, out, project, chose=found.calibration.terms is not None and not write_config):
        screen.remark(line, whole=True)


def _named_yaml(path: Path) -> Path:
    """Return the path of a configuration to be written; ConfigError where it is not named so."""
    from dynident.errors import ConfigError

    if path.suffix.lower() not in (".yaml", ".yml"):
        raise ConfigError(f"--write-config: {str(path)!r} is no name of a configuration; end it in .yaml.")
    return path


def _next(config: Path, out: Path | None, project: Project, *, chose: bool) -> Iterator[str]:
    """Yield what to type next; ``chose`` tells that terms were chosen and not written out."""
    from dynident.io.named_log import named

    if chose:
        explicit = config.with_name(f"{config.stem}-explicit.yaml")
        yield f"To write out the terms that were chosen: {command('identify', config, '--write-config', explicit)}"
    if out is None:
        yield f"To keep this, with a report: {command('identify', config, '--out', f'{config.stem}-out')}"
        return
    result, log = out / "result.json", named(next(iter((*project.config.validation, *project.config.train))))
    yield f"To predict the torque of a recording: {command('predict', result, log, '--out', out / 'torques.csv')}"
    yield f"To design what to record next: {command('excite', result, '-o', out / 'next')}"
    yield f"To export the model: {command('export', result, '--format', 'numpy', '--out', out / 'arm.py')}"


def write_result(folder: ResultFolder, found: Identification, made: Sequence[Export]) -> list[tuple[str, Path]]:
    """Write the model's files, result.json and report.html; return what was written where."""
    from dynident.io.saved import model_files
    from dynident.report.run_files import run_files

    files = {one.file: one.written.text for one in made if one.ready and one.written is not None}
    kinds = dict.fromkeys(files, "Model") | {"result.json": "Result", "report.html": "Report"}
    files |= run_files(found, made)
    # the models of an earlier run would pass for this one's
    paths = folder.replace(files, gone=model_files(folder.path / "result.json", found.provenance))
    return [(kinds[path.name], path) for path in paths]
