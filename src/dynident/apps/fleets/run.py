"""Runs a fleet: its logs as jobs, their rows in a table, and what the rows say together."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident.apps.fleets.config import REPORT, RUNS, TABLE, FleetLog, fleet_logs, folder_names, read_fleet_settings
from dynident.apps.fleets.doubts import doubts, find_changes_and_residuals
from dynident.apps.fleets.fit import KEY, LogIdentifier, LogJob, LogResult, empty_row, histories_of, model_of, schema
from dynident.apps.fleets.recipe import FleetRecipe, fleet_recipe
from dynident.apps.fleets.report import fleet_page
from dynident.apps.fleets.result import MIN_ROBOTS, FleetBase, FleetResult, Population, pool_robots
from dynident.files.folder import result_folder
from dynident.files.opener import watch_inputs
from dynident.files.results import as_path
from dynident.files.row_store import RowStore
from dynident.regression import groups_of
from dynident.report.identification.report import run_files
from dynident.runtime import join_names, report_progress
from dynident.runtime.jobs import FAILURES, JobOptions, JobResult, Limits, Status

if TYPE_CHECKING:
    import polars as pl


def fleet(
    config: str | Path,
    out: str | Path | None = None,
    *,
    executor: Executor | None = None,
    limits: Limits | None = None,
    rerun: bool = False,
    rng: np.random.Generator | None = None,
) -> FleetResult:
    """Identify all logs of a fleet that are not known yet, and return what is known of all: parameters over time, what
    has changed, and what robots of one type share.

    ``config`` is the configuration of the fleet (YAML). In the folder ``out`` are kept: ``report.html``; the table
    ``fleet.parquet``, with a row for each log; ``recipe.yaml``, in which all that can be chosen is chosen, so that all
    logs have the same parameters; and below ``runs`` a folder for each log with its own report. A log that is in the
    table, with its file and its recipe as they are now, is not identified again, unless ``rerun`` or it failed. What
    fails is a row, and the rest goes on. The logs are spread over ``executor``; ``limits`` hold for each of them.
    ``rng`` draws fleets in which nothing changes, by default the same ones each time.

    Raises ConfigError and ModelError where the configuration or its recipe cannot be used, InputError where no log can.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> t = np.arange(1001) * 0.01
    >>> recipe = '''
    ... model: gallery:slider
    ... time: { column: t, unit: s }
    ... position: { slider: { column: x, unit: m } }
    ... torque: { slider: { column: f, unit: N } }
    ... '''
    >>> with TemporaryDirectory() as folder:
    ...     for robot, mass in (("old", 5), ("new", 6)):
    ...         table = np.column_stack([t, np.sin(3 * t), -9 * mass * np.sin(3 * t) + 24 * np.cos(3 * t)])
    ...         file = Path(folder, f"{robot}_2026-11-22.csv")
    ...         np.savetxt(file, table, delimiter=",", header="t,x,f", comments="")
    ...     _ = Path(folder, "robot.yaml").write_text(recipe)
    ...     _ = Path(folder, "fleet.yaml").write_text("recipe: robot.yaml\\nlogs: '{robot}_{date}.csv'")
    ...     found = dy.fleet(Path(folder, "fleet.yaml"))
    >>> for history in found.histories:
    ...     print(history.robot, found.base.names[0], round(history.value[0, 0], 2))
    new M 6.0
    old M 5.0
    """
    path, folder = as_path(config), None if out is None else as_path(out)
    with watch_inputs(path), nullcontext() if folder is None else result_folder(folder) as place:
        report_progress("listing the logs")
        settings = read_fleet_settings(path)
        logs, warnings = fleet_logs(settings, path.parent, folder)
        recipe = fleet_recipe(settings, logs, path.parent, place)
        model, basis = model_of(recipe)
        base = FleetBase.of(model, basis)
        files = run_files if folder is not None and settings.reports else None
        identifier = LogIdentifier(recipe, path.parent, base.names, files)
        jobs, options = _log_jobs(logs, recipe), JobOptions(executor, limits)
        rows, new_count = _log_rows(identifier, jobs, folder, options, rerun=rerun)
        start = min((date for date in rows["date"] if date), default=None)
        groups = groups_of(model, basis)
        warnings = (*warnings, *_gone_warnings(rows, logs))
        pairs = list(histories_of(rows, start))
        histories, residuals = tuple(pair[0] for pair in pairs), tuple(pair[1] for pair in pairs)
        kinds = _robots_by_type(rows)
        result = FleetResult(
            path.stem, rows, base, histories, groups, kinds, start, new_count, warnings, residuals=residuals
        )
        rng = rng or np.random.default_rng(0)
        result = with_statistics(result, settings.false_alarms, rng)
        result = replace(result, warnings=(*result.warnings, *doubts(result, rng.spawn(1)[0])))
        if place is not None:
            report_progress("writing the report")
            place.replace({REPORT: fleet_page(result)})
    return result


def with_statistics(result: FleetResult, rate: float, rng: np.random.Generator) -> FleetResult:
    """Return a result with the changes of its robots and what those of a type share, where there are enough."""
    changes, populations = [], dict[str, Population]()
    history_by_robot = {history.robot: history for history in result.histories}
    residuals_by_robot = {history.robot: history for history in result.residuals}
    # each type draws from a stream of its own, so that types do not affect each other
    for (kind, robots), type_rng in zip(result.types.items(), rng.spawn(len(result.types)), strict=True):
        histories = [history_by_robot[robot] for robot in robots if robot in history_by_robot]
        if histories:
            report_progress(f"looking for changes of {kind}")
            residuals = [residuals_by_robot[x.robot] for x in histories if x.robot in residuals_by_robot]
            joints = result.base.joints
            changes.append(find_changes_and_residuals(histories, result.groups, residuals, joints, type_rng, rate=rate))
        if len(histories) >= MIN_ROBOTS:
            populations[kind] = pool_robots(histories, result.groups, changes[-1].scatter, changes[-1].changes)
    return replace(result, changes=tuple(changes), pooled=populations)


def _log_rows(
    work: LogIdentifier,
    jobs: Sequence[LogJob],
    folder: Path | None,
    options: JobOptions,
    *,
    rerun: bool,
) -> tuple[pl.DataFrame, int]:
    """Return the rows of all logs, and how many of them are new; the others were known."""
    file = None if folder is None else folder / TABLE
    with RowStore(file, schema(), KEY, rerun=rerun, retried={"status": FAILURES}) as store:
        # a row with the present recipe and file is not made again
        new_count = store.fill(
            work, jobs, lambda job: job.key, lambda result: [_write_files(result, folder)], options, "identifying logs"
        )
        return _present_rows(store.table(), jobs, work.recipe), new_count


def _robots_by_type(rows: pl.DataFrame) -> dict[str, tuple[str, ...]]:
    """Return the robots of each type."""
    robots_by_type: dict[str, tuple[str, ...]] = {}
    for robot, kind in rows.select("robot", "type").unique("robot", maintain_order=True).iter_rows():
        robots_by_type[kind] = (*robots_by_type.get(kind, ()), robot)
    return robots_by_type


def _log_jobs(logs: Sequence[FleetLog], recipe: FleetRecipe) -> list[LogJob]:
    """Return the job of each log; the folder of its run is named after robot and file."""
    robots = folder_names(log.robot for log in logs)
    digests = recipe.digests(robots)
    logs_by_robot: dict[str, list[FleetLog]] = {}
    for log in logs:
        logs_by_robot.setdefault(log.robot, []).append(log)
    jobs = []
    for robot, robot_logs in logs_by_robot.items():
        stems = [PurePosixPath(log.log).stem for log in robot_logs]
        # files with the same stem get folders by their whole path
        names, full_names, count = folder_names(stems), folder_names(log.log for log in robot_logs), Counter(stems)
        for log, stem in zip(robot_logs, stems, strict=True):
            name = names[stem] if count[stem] == 1 else full_names[log.log]
            jobs.append(LogJob(log, digests[robot], f"{RUNS}/{robots[robot]}/{name}"))
    return jobs


def _write_files(finished_job: JobResult[LogJob, LogResult], folder: Path | None) -> Mapping[str, object]:
    """Return the row of a log, once the files of its run are written."""
    log_result = finished_job.value or LogResult(empty_row(finished_job.job, finished_job.status, finished_job.reason))
    if log_result.files and folder is not None:
        with result_folder(folder / finished_job.job.folder) as place:
            place.replace({name: zlib.decompress(data) for name, data in log_result.files.items()})
    return {**log_result.row, "seconds": finished_job.seconds}


def _present_rows(rows: pl.DataFrame, jobs: Sequence[LogJob], recipe: FleetRecipe) -> pl.DataFrame:
    """Return the rows of the present files and recipes, with type and date as they are listed now, and those of files
    that are gone, by robot and date."""
    import polars as pl

    kinds: dict[str, Any] = {name: schema()[name] for name in (*KEY, "type", "date")}
    # type and date may be listed otherwise now than when the log was identified
    now = pl.DataFrame([(*job.key, job.log.type, job.log.date) for job in jobs], schema=kinds, orient="row")
    order = rows.columns
    present = rows.drop("type", "date").join(now, on=KEY, how="inner").select(order)
    digests = recipe.digests(rows["robot"].unique())
    text_columns = {"robot": pl.String, "recipe": pl.String}
    current_recipes = pl.DataFrame(list(digests.items()), schema=text_columns, orient="row")
    # rows of the present recipe whose log is not listed any more
    gone = rows.join(current_recipes, on=["robot", "recipe"], how="semi").join(now, on=["robot", "log"], how="anti")
    gone = gone.filter(pl.col("status") == Status.OK).unique(["robot", "log"], keep="last", maintain_order=True)
    return pl.concat([present, gone]).sort("robot", "date", "log")


def _gone_warnings(rows: pl.DataFrame, logs: Sequence[FleetLog]) -> Iterator[str]:
    """Yield a warning where logs of the table are not there any more."""
    listed_logs = {(fleet_log.robot, fleet_log.log) for fleet_log in logs}
    gone = [log for robot, log in rows.select("robot", "log").iter_rows() if (robot, log) not in listed_logs]
    if gone:
        yield f"logs that are gone: {join_names(gone, 3)}; what was found of them stays."
