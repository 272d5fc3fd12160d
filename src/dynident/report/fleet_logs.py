"""The logs of a fleet in its report: which could not be identified and why, and each with a link to its own report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dynident.errors import Use
from dynident.jobs import Status
from dynident.report.page import Column, Fold, PageBlock, PageSection, PageTable, number, relative
from dynident.report.words import count

if TYPE_CHECKING:
    from dynident.fleets import FleetResult

__all__ = ["REPORT", "failed", "failed_table", "failure_words", "log_section", "robot_table", "rows_of"]

REPORT = "report.html"  # of a log, in its folder
IN_TABLES, LEAST, ROBOTS, FAILED = 2000, 5, 300, 200  # logs, those of a robot at least, robots, failed logs
LONGEST = 200  # letters of a reason
Row = Mapping[str, Any]


def rows_of(found: FleetResult) -> Sequence[Row]:
    """Return the rows of the logs, without what is for computing only."""
    return found.rows.drop("value", "information").to_dicts()


def failed(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of logs that have no result."""
    return [row for row in rows if row["status"] != Status.OK]


def failure_words(rows: Sequence[Row]) -> str:
    """Say how many logs have no result, by what became of them; "" where all have."""
    lost = Counter(row["status"] for row in failed(rows))
    parts = [f"{times} {status}" for status, times in lost.most_common()]
    have = "has" if lost.total() == 1 else "have"
    return f"{lost.total()} of {count(len(rows), 'log')} {have} no result: {', '.join(parts)}." if lost else ""


def failed_table(rows: Sequence[Row], most: int = FAILED) -> Iterator[PageTable]:
    """Yield the table of logs without a result, where there is one, with the reasons."""
    lost = failed(rows)
    if lost:
        heads = (
            Column("log", numeric=False),
            Column("robot", numeric=False),
            Column("status", numeric=False),
            Column("reason", numeric=False, prose=True),
        )
        cells = tuple((row["log"], row["robot"], row["status"], _cut(row["reason"] or "")) for row in lost[:most])
        more = f", the first {most} of {len(lost)}" if len(lost) > most else ""
        yield PageTable(heads, cells, f"Logs without a result{more}")


def _cut(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= LONGEST else f"{line[:LONGEST]}..."


def robot_table(rows: Sequence[Row], changes: Mapping[str, int], most: int) -> PageTable:
    """Return the table of robots, those with most changes first: logs, failures, the last log and its error."""
    logs = _by_robot(rows)
    order = sorted(logs, key=lambda robot: (-changes.get(robot, 0), -len(failed(logs[robot]))))
    heads = [Column("robot", numeric=False), Column("type", numeric=False), Column("changes"), Column("logs")]
    heads += [Column("failed"), Column("last log", numeric=False), Column("its error, %")]
    cells = []
    for robot in order[:most]:
        good = [row for row in logs[robot] if row["status"] == Status.OK]
        last = good[-1] if good else {}
        counts = map(str, (changes.get(robot, 0), len(logs[robot]), len(logs[robot]) - len(good)))
        cells.append((robot, logs[robot][0]["type"] or "", *counts, _date(last), number(last.get("error"), 3)))
    more = f", {most} of {len(order)}" if len(order) > most else ""
    return PageTable(tuple(heads), tuple(cells), f"Robots{more}")


def log_section(found: FleetResult) -> PageSection:
    """Return the section of all logs, by robot: the last ones of each, as many as a page can hold."""
    rows = rows_of(found)
    logs = _by_robot(rows)
    each = max(LEAST, IN_TABLES // max(min(len(logs), ROBOTS), 1))
    blocks: list[PageBlock] = [_lead(rows, len(logs), each), *failed_table(rows)]
    joints = [joint.name for joint in found.base.joints]
    order = list(logs)[:ROBOTS]
    blocks += [Fold(_title(robot, logs[robot]), (_log_table(logs[robot], joints, each),)) for robot in order]
    return PageSection("Logs", tuple(blocks))


def _lead(rows: Sequence[Row], robots: int, each: int) -> str:
    lead = "Errors are relative torque errors, those held out on another log. "
    if any(row["folder"] for row in rows):
        lead += "Each log leads to its own report. "
    if robots > ROBOTS or any(times > each for times in Counter(row["robot"] for row in rows).values()):
        lead += f"Of {len(rows)} logs of {count(robots, 'robot')}, the last {each} of each robot are here, "
        lead += f"of the first {ROBOTS} robots" if robots > ROBOTS else "of all robots"
        lead += "; `fleet.parquet` has all."
    return lead


def _title(robot: str, rows: Sequence[Row]) -> str:
    lost = len(failed(rows))
    return f"{robot}: {count(len(rows), 'log')}{f', {lost} without a result' if lost else ''}"


def _log_table(rows: Sequence[Row], joints: Sequence[str], most: int) -> PageTable:
    shown = rows[-most:]
    held = any(row["held_out"] for row in shown)
    heads = [Column(title, numeric=False) for title in ("log", "date", "status")]
    heads += [Column("error, %"), Column("worst joint, %"), *[Column("held out, %")] * held]
    heads += [Column("samples"), Column("time, s"), Column("reason", numeric=False, prose=True)]
    cells = []
    for row in shown:
        errors = [number(row["error"], 3), _worst(row["errors"], joints)]
        errors += [number(max(row["held_out"]), 3) if row["held_out"] else "-"] if held else []
        cost = [str(row["samples"]) if row["samples"] else "-", number(row["seconds"], 2)]
        cells.append((row["log"], _date(row), _status(row), *errors, *cost, _cut(row["reason"] or "")))
    more = f"The last {most} of {len(rows)} logs" if len(rows) > most else ""
    return PageTable(tuple(heads), tuple(cells), more, tuple(map(_link, shown)))


def _by_robot(rows: Sequence[Row]) -> dict[str, list[Row]]:
    logs: dict[str, list[Row]] = {}
    for row in rows:
        logs.setdefault(row["robot"], []).append(row)
    return logs


def _link(row: Row) -> str:
    return relative(f"{row['folder']}/{REPORT}") if row["folder"] else ""


def _status(row: Row) -> str:
    return Use(row["verdict"]).value if row["status"] == Status.OK and row["verdict"] else str(row["status"])


def _date(row: Row) -> str:
    return row["date"].strftime("%Y-%m-%d %H:%M").removesuffix(" 00:00") if row.get("date") else "-"


def _worst(errors: Sequence[float] | None, joints: Sequence[str]) -> str:
    if not errors:
        return "-"
    k = max(range(len(errors)), key=lambda k: errors[k])
    return f"{number(errors[k], 3)} ({joints[k]})" if len(joints) == len(errors) else number(errors[k], 3)
