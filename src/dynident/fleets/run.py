"""Runs a fleet: its logs as jobs, their rows in a table, and what the rows say together."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident.errors import InputError, Step, listed
from dynident.fleets.doubts import doubts
from dynident.fleets.fit import Fitted, LogFit, LogJob, empty_row, model_of
from dynident.fleets.folders import REPORT, RUNS, TABLE, folder_names
from dynident.fleets.listing import FleetLog, fleet_logs
from dynident.fleets.pooled import FEWEST, Pooled, pooled
from dynident.fleets.recipe import FleetRecipe, fleet_recipe
from dynident.fleets.residuals import changes_and_residuals
from dynident.fleets.result import FleetBase, FleetResult
from dynident.fleets.rows import KEY, histories_of, residuals_of, schema
from dynident.fleets.settings import read_fleet_settings
from dynident.identification import Identification
from dynident.io.folder import result_folder
from dynident.io.opener import watched
from dynident.io.results import as_path
from dynident.io.row_store import RowStore
from dynident.jobs import Done, Limits, Status, run_jobs
from dynident.regression import groups_of

if TYPE_CHECKING:
    import polars as pl

__all__ = ["run_fleet"]

Progress = Callable[[str], None]
AGAIN = {"status": [one.value for one in Status if one is not Status.OK]}  # another attempt may succeed


def run_fleet(
    config: str | Path,
    out: str | Path | None = None,
    *,
    run_files: Callable[[Identification], Mapping[str, str]] | None = None,
    page: Callable[[FleetResult], str] | None = None,
    executor: Executor | None = None,
    limits: Limits | None = None,
    rerun: bool = False,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
) -> FleetResult:
    """Do what ``dynident.fleet`` says; ``run_files`` (picklable) gives the texts of a run's files by name, ``page``
    that of the report, None for none."""
    path, folder, say = as_path(config), None if out is None else as_path(out), progress or (lambda _: None)
    with watched(path), nullcontext() if folder is None else result_folder(folder) as place:
        say("listing the logs")
        settings = read_fleet_settings(path)
        logs, warnings = fleet_logs(settings, path.parent, folder)
        recipe = fleet_recipe(settings, logs, path.parent, place, say)
        model, basis = model_of(recipe)
        base = FleetBase.of(model, basis)
        files = run_files if folder is not None and settings.reports else None
        work = LogFit(recipe, path.parent, base.names, files)
        rows, fitted = _rows(work, _jobs(logs, recipe), folder, executor, limits, rerun, say)
        start = min((one for one in rows["date"] if one), default=None)
        groups = groups_of(model, basis)
        warnings = (*warnings, *_gone(rows, logs))
        found = FleetResult(
            path.stem,
            rows,
            base,
            tuple(histories_of(rows, start)),
            groups,
            _types(rows),
            start,
            fitted,
            warnings,
            residuals=tuple(residuals_of(rows, start)),
        )
        rng = rng or np.random.default_rng(0)
        found = with_statistics(found, settings.false_alarms, rng, say)
        found = replace(found, warnings=(*found.warnings, *doubts(found, rng.spawn(1)[0])))
        if place is not None and page is not None:
            say("writing the report")
            place.replace({REPORT: page(found)})
    return found


def with_statistics(found: FleetResult, rate: float, rng: np.random.Generator, say: Progress) -> FleetResult:
    """Return a result with the changes of its robots and what those of a type share, where there are enough."""
    changes, shared = [], dict[str, Pooled]()
    of = {one.robot: one for one in found.histories}
    left = {one.robot: one for one in found.residuals}
    for (kind, robots), own in zip(found.types.items(), rng.spawn(len(found.types)), strict=True):
        histories = [of[robot] for robot in robots if robot in of]
        if histories:
            say(f"looking for changes of {kind}")
            residuals = [left[one.robot] for one in histories if one.robot in left]
            changes.append(changes_and_residuals(histories, found.groups, residuals, found.base.joints, own, rate=rate))
        if len(histories) >= FEWEST:
            shared[kind] = pooled(histories, found.groups, changes[-1].scatter, changes[-1].found)
    return replace(found, changes=tuple(changes), pooled=shared)


def _rows(
    work: LogFit,
    jobs: Sequence[LogJob],
    folder: Path | None,
    executor: Executor | None,
    limits: Limits | None,
    rerun: bool,
    say: Progress,
) -> tuple[pl.DataFrame, int]:
    """Return the rows of all logs, and how many of them are new; the others were known."""
    with RowStore(None if folder is None else folder / TABLE, schema(), KEY, rerun=rerun, again=AGAIN) as store:
        wanted = [job for job in jobs if job.key not in store]
        say(Step("identifying logs", 0, len(wanted)))
        try:
            for count, done in enumerate(run_jobs(work, wanted, executor, limits=limits), 1):
                store.add([_kept(done, folder)])
                say(Step("identifying logs", count, len(wanted)))
        except KeyboardInterrupt as stop:
            stop.add_note(_left(folder))
            raise
        except InputError as error:
            raise InputError(f"{error} {_left(folder)}") from error
        return _present(store.table(), jobs, work.recipe), len(wanted)


def _left(folder: Path | None) -> str:
    if folder is None:
        return "No log is kept; name a folder for the results to keep them."
    return f"Finished logs are kept in {folder / TABLE}; run the same command again to go on."


def _types(rows: pl.DataFrame) -> dict[str, tuple[str, ...]]:
    """Return the robots of each type."""
    found: dict[str, tuple[str, ...]] = {}
    for robot, kind in rows.select("robot", "type").unique("robot", maintain_order=True).iter_rows():
        found[kind] = (*found.get(kind, ()), robot)
    return found


def _jobs(logs: Sequence[FleetLog], recipe: FleetRecipe) -> list[LogJob]:
    """Return the job of each log; the folder of its run is named after robot and file."""
    robots = folder_names(one.robot for one in logs)
    digests = recipe.digests(robots)
    of: dict[str, list[FleetLog]] = {}
    for one in logs:
        of.setdefault(one.robot, []).append(one)
    jobs = []
    for robot, own in of.items():
        ends = [PurePosixPath(one.log).stem for one in own]
        names, whole, count = folder_names(ends), folder_names(one.log for one in own), Counter(ends)
        for one, end in zip(own, ends, strict=True):
            name = names[end] if count[end] == 1 else whole[one.log]
            jobs.append(LogJob(one, digests[robot], f"{RUNS}/{robots[robot]}/{name}"))
    return jobs


def _kept(done: Done[LogJob, Fitted], folder: Path | None) -> Mapping[str, object]:
    """Return the row of a log, once the files of its run are written."""
    fitted = done.value or Fitted(empty_row(done.job, done.status, done.reason))
    if fitted.files and folder is not None:
        with result_folder(folder / done.job.folder) as place:
            place.replace({name: zlib.decompress(data) for name, data in fitted.files.items()})
    return {**fitted.row, "seconds": done.seconds}


def _present(rows: pl.DataFrame, jobs: Sequence[LogJob], recipe: FleetRecipe) -> pl.DataFrame:
    """Return the rows of the present files and recipes, with type and date as they are listed now, and those of files
    that are gone, by robot and date."""
    import polars as pl

    kinds: dict[str, Any] = {name: schema()[name] for name in (*KEY, "type", "date")}
    now = pl.DataFrame([(*job.key, job.log.type, job.log.date) for job in jobs], schema=kinds, orient="row")
    order = rows.columns
    present = rows.drop("type", "date").join(now, on=KEY, how="inner").select(order)
    digests = recipe.digests(rows["robot"].unique())
    same = pl.DataFrame(list(digests.items()), schema={"robot": pl.String, "recipe": pl.String}, orient="row")
    gone = rows.join(same, on=["robot", "recipe"], how="semi").join(now, on=["robot", "log"], how="anti")
    gone = gone.filter(pl.col("status") == Status.OK).unique(["robot", "log"], keep="last", maintain_order=True)
    return pl.concat([present, gone]).sort("robot", "date", "log")


def _gone(rows: pl.DataFrame, logs: Sequence[FleetLog]) -> Iterator[str]:
    """Yield a warning where logs of the table are not there any more."""
    there = {(one.robot, one.log) for one in logs}
    gone = [log for robot, log in rows.select("robot", "log").iter_rows() if (robot, log) not in there]
    if gone:
        yield f"logs that are gone: {listed(gone, 3)}; what was found of them stays."
