"""What files hold and tell: ``dynident check``, ``bound``, ``smooth`` and ``schema``."""

from __future__ import annotations

import os
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from dynident.cli.command_log import print_error
from dynident.cli.failures import command
from dynident.cli.options import DIRECTORY, FILE, JSON_FILE, LOG, parse_noise
from dynident.cli.terminal import console, print_files, print_path, say_line, status

if TYPE_CHECKING:
    from dynident.checks import CheckResult
    from dynident.identification import TorqueNoise


@click.command(short_help="Find errors in recordings and robot files.")
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=FILE)
@JSON_FILE
def check(files: tuple[Path, ...], json_file: Path | None) -> None:
    """Check each FILE, a configuration (YAML) with its logs and robot file, or a robot file (URDF, MJCF) alone, and
    print what is wrong and how to mend it; -v adds hints and tables. The exit code is 1 if an error is found.
    """
    from dynident.files.results import claim_json, write_json
    from dynident.report.check import check_dict, check_summary, fact_tables, finding_tables
    from dynident.runtime import Severity

    claim_json(json_file, *(files if json_file else ()))
    screen, check_results = console(), {}
    for path in files:
        with status():
            check_results[str(path)] = check_result = _examine_file(path, json_file)
        if len(files) > 1:
            screen.say(str(path))
        for severity, table in finding_tables(check_result).items():
            screen.show(table, detail=severity is Severity.INFO)
        for table in fact_tables(check_result):
            screen.show(table, detail=True)
    if json_file:
        findings = {path: check_dict(check_result) for path, check_result in check_results.items()}
        print_path(screen, "Findings", write_json(json_file, findings))
    for path in files:
        screen.remark(_next_command(path, check_results[str(path)]), no_wrap=True)
    for name, check_result in check_results.items():
        screen.say(f"{name}: {check_summary(check_result)}", "bold")
    if any(check_result.has_errors for check_result in check_results.values()):
        raise SystemExit(1)


def _next_command(path: Path, check_result: CheckResult) -> str:
    """Return what to type next."""
    from dynident.files.xml_text import SUFFIXES

    if check_result.has_errors:
        return f"When the errors are corrected: {command('check', path)}"
    if path.suffix.lower() in SUFFIXES:
        init_command = command("init", path, "LOG.csv", "-o", path.with_suffix(".yaml").name)
        excite_command = command("excite", path, "-o", f"{path.stem}-motion")
        return f"Next, with a recording: {init_command}; without one: {excite_command}"
    return f"Next: {command('identify', path, '--out', f'{path.stem}-out')}"


def _examine_file(path: Path, json_file: Path | None) -> CheckResult:
    """Check one file; one that cannot be used gives an error finding, so that the others are still checked.

    Raises ConfigError where the findings would replace a file that is named in it.
    """
    from dynident.files.opener import file_status, refuse_inputs
    from dynident.files.xml_text import SUFFIXES
    from dynident.project.drive_settings import ServoSettings
    from dynident.project.project import read_project
    from dynident.runtime import DynidentError, InputError

    try:
        file_status(path, InputError, (".yaml", ".yml", *SUFFIXES))
        if path.suffix.lower() in SUFFIXES:
            return _check_robot_file(path)
        project = read_project(path)
    except DynidentError as error:
        return _unusable_result(error)
    refuse_inputs(*filter(None, [json_file]))
    try:
        if isinstance(project.config.simulation, ServoSettings):
            from dynident.apps.servo import examine_servos

            return examine_servos(project)
        return project.examine()
    except DynidentError as error:
        return _unusable_result(error)


def _unusable_result(error: Exception) -> CheckResult:
    from dynident.checks import CheckResult
    from dynident.checks.file_notes import Unusable
    from dynident.runtime import Finding

    return CheckResult((Finding(Unusable(str(error))),))


def _check_robot_file(path: Path) -> CheckResult:
    from dynident.checks import CheckResult, check_robot, joint_facts, link_facts
    from dynident.models.rigid_bodies import read_robot_file
    from dynident.project.config import robot_text

    file = read_robot_file(robot_text(path), path.name)
    return CheckResult(check_robot(file), links=link_facts(file), joints=joint_facts(file))


@click.command(short_help="Show the best accuracy that any method can reach.")
@click.argument("config", type=FILE)
@click.option("--sigma-q", multiple=True, help="Position noise (rad, m): a number, or joint=number; repeat it.")
@click.option("--sigma-tau", multiple=True, help="Torque noise (N m, N): a number, or joint=number; repeat it.")
@click.option(
    "--torque", type=click.Choice(["residual", "sensor"]), default="residual", show_default=True,
    help="Torque noise: the residual of the fit, or the scatter between neighbouring samples.",
)  # fmt: skip
@click.option("--out", type=DIRECTORY, help="Folder for report.html and bound.json.")
@JSON_FILE
def bound(
    config: Path, sigma_q: tuple[str, ...], sigma_tau: tuple[str, ...], torque: str, out: Path | None,
    json_file: Path | None,
) -> None:  # fmt: skip
    """Show how accurately any unbiased method could determine each parameter from the training logs of CONFIG (YAML),
    what limits the accuracy, and how much a better encoder, a better torque sensor or a longer recording would help.
    """
    from dynident.apps.bound import bound_dict, bound_findings, bound_page, bound_table, noise_table
    from dynident.files.folder import result_folder
    from dynident.files.opener import refuse_inputs
    from dynident.files.results import claim_json, json_text, write_text
    from dynident.project.project import read_project
    from dynident.report.words import Line, note_lines

    claim_json(json_file)
    targets = [json_file] if json_file else []
    targets += [out / "bound.json", out / "report.html"] if out else []
    with result_folder(out) if out else nullcontext() as folder:
        noise_levels = parse_noise("--sigma-q", sigma_q), parse_noise("--sigma-tau", sigma_tau)
        with status():
            project = read_project(config)
            refuse_inputs(*targets)
            accuracy = project.bound(*noise_levels, cast("TorqueNoise", torque))
        numbers = json_text(bound_dict(accuracy))
        written = folder.replace({"bound.json": numbers, "report.html": bound_page(accuracy)}) if folder else ()
    screen = console()
    for table in (noise_table(accuracy), bound_table(accuracy, short=True)):
        screen.show(table, detail=True)
    overall, *others = bound_findings(accuracy)
    for line in (*map(Line, others), *note_lines(accuracy.identification.notes)):
        say_line(screen, line)
    if json_file:
        print_path(screen, "Numbers", write_text(json_file, numbers))
    print_files(screen, written)
    screen.say(overall, "bold")


@click.command(short_help="Smooth and differentiate columns of a file.")
@click.argument("log", type=LOG)
@click.option("--time", "time_column", required=True, help="Column of the time stamps.")
@click.option("--time-unit", "unit", help="Unit of the time stamps; default: the one in the column's name, else s.")
@click.option("--column", "columns", multiple=True, help="Column to smooth; repeat it. Default: all but the time.")
@click.option(
    "--rule", type=click.Choice(["constraint", "gcv", "reml", "interpolate"]), default="constraint", show_default=True,
    help="How to choose the smoothing: S = n, cross-validation, restricted likelihood, or interpolation.",
)  # fmt: skip
@click.option("--sigma", type=float, help="Standard deviation of the noise; estimated where it is not given.")
@click.option("--lam", type=float, help="A fixed smoothing parameter instead of a rule.")
@click.option("--out", type=DIRECTORY, default="smooth-out", show_default=True, help="Folder for the results.")
def smooth(
    log: Path, time_column: str, unit: str | None, columns: tuple[str, ...], rule: str, sigma: float | None,
    lam: float | None, out: Path,
) -> None:  # fmt: skip
    """Smooth columns of LOG; write values and derivatives (smoothed.csv) and a plot (report.html).

    Derivatives are per second and bandwidths in seconds, whatever the unit of the time stamps.
    """
    from dynident.files.folder import result_folder
    from dynident.files.opener import refuse_inputs, remember_inputs
    from dynident.files.tables import read_columns
    from dynident.motion.splines import Fixed, rule_by_name
    from dynident.project.columns import read_name
    from dynident.project.fields import unit_factor
    from dynident.report.identification.validation import smooth_columns, smoothing_page, smoothing_table
    from dynident.runtime import ConfigError, count

    if lam is not None and rule != "constraint":
        raise ConfigError(f"--lam and --rule {rule} contradict each other; give one of them.")
    if unit is not None:
        unit_factor(unit, "time", "--time-unit")
    remember_inputs(log)
    refuse_inputs(out / "smoothed.csv", out / "report.html")
    smoothing_rule = rule_by_name(rule) if lam is None else Fixed(lam=lam)
    with result_folder(out) as folder:
        table = read_columns(log)
        file_unit = table.units.get(time_column)
        if file_unit is not None and unit not in (None, file_unit):
            raise ConfigError(
                f"--time-unit: {time_column!r} holds dates, times or durations, read in {file_unit}: not {unit!r}."
            )
        parsed_name = read_name(time_column, ())
        time_unit = unit or file_unit or (parsed_name.unit if parsed_name.role == "time" else None) or "s"
        seconds = unit_factor(time_unit, "time", "--time-unit")
        smoothed = smooth_columns(table, time_column, seconds, columns, smoothing_rule, sigma)
        page = smoothing_page(log.name, smoothed.names, smoothed.measured, smoothed.fit)
        written = folder.replace({"smoothed.csv": smoothed.frame().write_csv(), "report.html": page})
    screen = console()
    if unit is None and time_unit != "s":
        screen.remark(f"{time_column!r} is read in {time_unit}, as its name says; else give --time-unit.")
    missing = [f"{count(smoothed.missing, 'row')} left out, where columns are empty or NaN."] * bool(smoothed.missing)
    for note in (*table.notes, *missing):
        screen.remark(f"Warning: {note}", "yellow")
    screen.show(smoothing_table(smoothed.names, smoothed.fit))
    print_files(screen, written)


@click.command(short_help="Print a JSON schema, for completion in editors.")
@click.argument("kind", type=click.Choice(["config", "result", "fleet"]), default="config")
@click.option("--out", type=FILE, help="File to write it to.")
def schema(kind: str, out: Path | None) -> None:
    """Print the JSON schema (draft 2020-12) of the configuration (config), of result.json (result), or of the
    configuration of a fleet (fleet).

    The schema of the configuration includes the parts of installed packages.
    """
    import json

    from dynident.apps.fleets.config import fleet_schema
    from dynident.files.opener import content
    from dynident.files.results import write_json
    from dynident.project.parts import unusable
    from dynident.project.result_format import SCHEMAS
    from dynident.runtime import InputError
    from dynident.runtime.families import ESTIMATORS, SMOOTHERS, TERMS

    json_schema = {**SCHEMAS, "fleet": fleet_schema}[kind]()
    for family in (SMOOTHERS, TERMS, ESTIMATORS) if kind == "config" else ():
        for words in unusable(family):
            print_error(f"Warning: its settings are not in the schema: {words}")
    if out and os.path.exists(out) and b'"$schema"' not in content(out, remember=False):
        raise InputError(f"{out}: exists already and is no schema; choose another name.")
    if out:
        print_path(console(), "Schema", write_json(out, json_schema))
    else:
        click.echo(json.dumps(json_schema, indent=2, ensure_ascii=False))
