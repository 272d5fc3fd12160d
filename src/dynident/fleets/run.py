"""Runs a fleet: its logs as jobs, their rows in a table, and what the rows say together."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynident.errors import InputError, Step
from dynident.fleets.fit import Fitted, LogFit, LogJob, Pages, built, empty_row
from dynident.fleets.folders import folder_names
from dynident.fleets.groups import groups_of
from dynident.fleets.listing import FleetLog, fleet_logs
from dynident.fleets.recipe import FleetRecipe, fleet_recipe
from dynident.fleets.result import FleetBase, FleetResult
from dynident.fleets.rows import KEY, histories_of, schema
from dynident.fleets.settings import read_fleet_settings
from dynident.io.folder import result_folder
from dynident.io.opener import watched
from dynident.io.results import as_path
from dynident.io.row_store import RowStore
from dynident.jobs import Done, Limits, Status, run_jobs

if TYPE_CHECKING:
    import polars as pl

__all__ = ["TABLE", "run_fleet"]

Progress = Callable[[str], None]
TABLE, RUNS = "fleet.parquet", "runs"
AGAIN = {"status": [one.value for one in Status if one is not Status.OK]}  # another attempt may succeed


def run_fleet(
    config: str | Path,
    out: str | Path | None = None,
    *,
    executor: Executor | None = None,
    limits: Limits | None = None,
    rerun: bool = False,
    pages: Pages | None = None,
    progress: Progress = lambda _: None,
) -> FleetResult:
    """Identify all logs of a fleet that are not known yet, and return what is known of all.

    ``config`` is the configuration of the fleet (``FleetSettings``). In the folder ``out`` are kept: the table
    ``fleet.parquet``, with a row for each log; ``recipe.yaml``, in which all that can be chosen is chosen; and a folder
    for each run below ``runs``, with what ``pages`` makes of its identification, by name of the file. A log that is in
    the table, as its file and its recipe are now, is not identified again, unless ``rerun`` or it failed; what fails is
    a row, and the rest goes on. The logs are spread over ``executor``; ``limits`` hold for each.

    Raises ConfigError and ModelError where the configuration or its recipe cannot be used, InputError where no log can.
    """
    path, folder = as_path(config), None if out is None else as_path(out)
    with watched(path):
        progress("listing the logs")
        settings = read_fleet_settings(path)
        logs, warnings = fleet_logs(settings, path.parent)
        recipe = fleet_recipe(settings, logs, path.parent, folder, progress)
        jobs = _jobs(logs, recipe)
        project, basis = built(recipe, "", recipe.digest(""))
        base = FleetBase.of(project.model, basis)
        work = LogFit(recipe, path.parent, base.names, folder, pages if settings.reports else None)
        with RowStore(None if folder is None else folder / TABLE, schema(), KEY, rerun=rerun, again=AGAIN) as store:
            wanted = [job for job in jobs if job.key not in store]
            for count, done in enumerate(run_jobs(work, wanted, executor, limits=limits), 1):
                store.add([_kept(done, folder)])
                progress(Step("identifying logs", count, len(wanted)))
            rows = _present(store.table(), jobs)
    start = min((one for one in rows["date"] if one), default=None)
    histories, groups = tuple(histories_of(rows, start)), groups_of(project.model, basis)
    warnings = (*warnings, *_gone(rows, logs))
    return FleetResult(path.stem, rows, base, histories, groups, _types(rows), start, folder, len(wanted), warnings)


def _types(rows: pl.DataFrame) -> dict[str, tuple[str, ...]]:
    """Return the robots of each type."""
    found: dict[str, tuple[str, ...]] = {}
    for robot, kind in rows.select("robot", "type").unique("robot", maintain_order=True).iter_rows():
        found[kind] = (*found.get(kind, ()), robot)
    return found


def _jobs(logs: Sequence[FleetLog], recipe: FleetRecipe) -> list[LogJob]:
    """Return the job of each log; the folder of its run is named after robot and file."""
    robots = folder_names(one.robot for one in logs)
    digests = {robot: recipe.digest(robot) for robot in robots}
    of: dict[str, list[FleetLog]] = {}
    for one in logs:
        of.setdefault(one.robot, []).append(one)
    jobs = []
    for robot, own in of.items():
        ends = [one.log.rpartition("/")[2] for one in own]
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


def _present(rows: pl.DataFrame, jobs: Sequence[LogJob]) -> pl.DataFrame:
    """Return the rows of the present files and recipes, with type and date as they are listed now, and those of files
    that are gone, by robot and date."""
    import polars as pl

    kinds = dict.fromkeys(KEY, pl.String) | {"type": pl.String, "date": pl.Datetime("us")}
    listed = pl.DataFrame([(*job.key, job.log.type, job.log.date) for job in jobs], schema=kinds, orient="row")
    order = rows.columns
    present = rows.drop("type", "date").join(listed, on=KEY, how="inner").select(order)
    recipes = listed.select("robot", "recipe").unique()
    gone = rows.join(recipes, on=["robot", "recipe"], how="semi").join(listed, on=["robot", "log"], how="anti")
    gone = gone.filter(pl.col("status") == Status.OK).unique(["robot", "log"], keep="last", maintain_order=True)
    return pl.concat([present, gone]).sort("robot", "date", "log")


def _gone(rows: pl.DataFrame, logs: Sequence[FleetLog]) -> Iterator[str]:
    """Yield a warning where logs of the table are not there any more."""
    listed = {(one.robot, one.log) for one in logs}
    gone = [key for key in rows.select("robot", "log").iter_rows() if key not in listed]
    if gone:
        yield f"{len(gone)} logs are gone, such as {gone[0][1]}; what was found of them stays."


def nothing_found(result: FleetResult) -> InputError | None:
    """Return the error of a fleet of which no log could be identified; None where one could."""
    if result.histories:
        return None
    reason = next(iter(result.rows["reason"]), "")
    return InputError(f"{result.name}: none of {len(result.rows)} logs could be identified; the first: {reason}")
