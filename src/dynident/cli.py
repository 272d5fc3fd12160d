"""The command ``dynident``: each command reads, calls and writes; heavy packages are imported when one runs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dynident import __version__
from dynident.errors import DynidentError

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["main"]

DIRECTORY = click.Path(file_okay=False, path_type=Path)
FILE = click.Path(dir_okay=False, path_type=Path)


class _Commands(click.Group):
    """Turns the errors meant for the user into one message and exit code 1."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except DynidentError as error:
            raise click.ClickException(str(error)) from error
        except KeyboardInterrupt:
            click.echo("Interrupted.", err=True)
            raise SystemExit(130) from None


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="dynident")
def main() -> None:
    """Identify the dynamic parameters of robot arms from measured joint positions and torques."""


@main.command(short_help="Run the article's study again.")
@click.option("--scenario", default="tabulated", show_default=True, help="tabulated, stated or weak.")
@click.option("--runs", default=30, show_default=True, help="Recordings per noise level.")
@click.option("--seed", default=0, show_default=True, help="Seed of the noise.")
@click.option("--methods", default="raw,filtered,spline", show_default=True, help="Methods, separated by commas.")
@click.option("--out", type=DIRECTORY, help="Folder for report.html and study.parquet; a study in it is resumed.")
@click.option("--json", "json_file", type=FILE, help="File for the sample means and variances.")
def reproduce(scenario: str, runs: int, seed: int, methods: str, out: Path | None, json_file: Path | None) -> None:
    """Run the article's study (sec. 3) again and print its tables 2-7 beside the printed numbers."""
    from dynident import article
    from dynident.io.results import probe_folder, write_json, write_text
    from dynident.report.study import study_page, study_text

    for folder in filter(None, (out, json_file and json_file.parent)):
        probe_folder(folder)
    names = [name.strip() for name in methods.split(",") if name.strip()]
    table = out / "study.parquet" if out else None
    try:
        with _bar(f"{scenario}, {runs} runs") as progress:
            found = article.reproduce(scenario, runs, seed, names, path=table, progress=progress)
    except KeyboardInterrupt:
        if table:
            click.echo(f"What was finished is kept in {table}: run the same command again to go on.", err=True)
        raise
    console = _console()
    console.print(study_text(found))
    page = study_page(found) if out else ""
    if json_file:
        write_json(json_file, found.summary())
    if out:
        _tell(console, "Report", write_text(out / "report.html", page))


@main.command(short_help="Identify parameters from recordings.")
@click.argument("config", type=FILE)
@click.option("--out", type=DIRECTORY, help="Folder for result.json and report.html.")
def identify(config: Path, out: Path | None) -> None:
    """Identify the parameters named in CONFIG (YAML) from its logs, and judge them on held-out logs."""
    from dynident.io.results import probe_folder, write_json, write_text
    from dynident.report import identification_notes, identification_page, identification_tables, result_dict

    if out:
        probe_folder(out)
    with _status() as say:
        found = _identify(config, say)
    console = _console()
    for table in identification_tables(found):
        console.print(table)
    for note in identification_notes(found):
        style = "yellow" if note.startswith("Warning") else None
        console.print(note, style=style, soft_wrap=True, highlight=False, markup=False)
    if out:
        result, page = result_dict(found), identification_page(found)
        _tell(console, "Result", write_json(out / "result.json", result))
        _tell(console, "Report", write_text(out / "report.html", page))


@main.command(short_help="Smooth and differentiate columns of a file.")
@click.argument("log", type=FILE)
@click.option("--time", "time_column", required=True, help="Column of the time stamps (s).")
@click.option("--column", "columns", multiple=True, help="Column to smooth; repeat it. Default: all but the time.")
@click.option(
    "--rule", type=click.Choice(["constraint", "gcv", "reml", "interpolate"]), default="constraint", show_default=True,
    help="How much to smooth: S = n with the noise, cross-validation, likelihood, or not at all.",
)  # fmt: skip
@click.option("--sigma", type=float, help="Standard deviation of the noise; estimated where it is not given.")
@click.option("--lam", type=float, help="A fixed smoothing parameter instead of a rule.")
@click.option("--out", type=DIRECTORY, default="smooth-out", show_default=True, help="Folder for the results.")
def smooth(
    log: Path, time_column: str, columns: tuple[str, ...], rule: str, sigma: float | None, lam: float | None, out: Path
) -> None:
    """Smooth columns of LOG; write values and derivatives (smoothed.csv) and a plot (report.html)."""
    from dynident.errors import ConfigError
    from dynident.io.results import write_table, write_text
    from dynident.io.tables import read_columns
    from dynident.report.page import terminal
    from dynident.report.smoothing import smoothed_columns, smoothing_page, smoothing_table
    from dynident.splines import Fixed, rule_named

    if lam is not None and rule != "constraint":
        raise ConfigError(f"--lam and --rule {rule} contradict each other; give one of them.")
    chosen = rule_named(rule) if lam is None else Fixed(lam=lam)
    found = smoothed_columns(read_columns(log), time_column, columns, chosen, sigma)
    page = smoothing_page(log.name, found.names, found.measured, found.fit)
    console = _console()
    console.print(terminal(smoothing_table(found.names, found.fit)))
    _tell(console, "Table", write_table(out / "smoothed.csv", found.frame()))
    _tell(console, "Report", write_text(out / "report.html", page))


def _tell(console: Console, what: str, path: Path) -> None:
    console.print(f"{what}: {path.resolve()}", soft_wrap=True, highlight=False, markup=False)


def _identify(path: Path, say: Callable[[str], None]) -> Any:
    from dataclasses import replace

    from dynident.errors import ConfigError
    from dynident.identify import identify as run
    from dynident.io.config import config_warnings, load_model, read_config
    from dynident.io.logs import read_logs
    from dynident.io.recipe import build_recipe

    config = read_config(path)
    say("building the model")
    model = load_model(config.model, path.parent)
    recipe = build_recipe(config)
    logs: dict[str, dict[str, Any]] = {"train": {}, "validation": {}}
    warnings = [*config_warnings(config), *(note for term in model.terms for note in getattr(term, "notes", ()))]
    for role in logs:
        for spec in getattr(config, role):
            say(f"reading {spec.label}")
            reading = read_logs(spec, config, model.joints)
            for log in reading.logs:
                if log.source in logs[role]:
                    raise ConfigError(f"{role}: two logs are called {log.source!r}; give one of them another `name`.")
                logs[role][log.source] = log
            warnings += reading.warnings
    found = run(model, logs["train"], logs["validation"], recipe, progress=say)
    settings = {"configuration": path.read_text(encoding="utf-8"), **found.settings}
    return replace(found, warnings=(*warnings, *found.warnings), settings=settings)


def _console() -> Console:
    """Return the console of standard output; wide enough for the tables where it is no terminal."""
    from rich.console import Console

    return Console() if sys.stdout.isatty() else Console(width=150)


@contextmanager
def _bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar on standard error; silent where that is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def _status() -> Iterator[Callable[[str], None]]:
    """Show what is being done on standard error; silent where that is no terminal."""
    from rich.console import Console

    if not sys.stderr.isatty():
        yield lambda _: None
        return
    with Console(stderr=True).status("starting") as status:
        yield lambda step: status.update(step)
