"""The report of a fleet: what changed where and when, all robots side by side, what they share, and every log."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from dynident.apps.fleets.changes import Change, Changes
from dynident.apps.fleets.changes_report import (
    RobotTrends,
    change_table,
    change_words,
    clear_directions,
    group_words,
    pooled_sections,
    sort_by_severity,
)
from dynident.apps.fleets.components import History
from dynident.apps.fleets.doubts import residual_groups
from dynident.apps.fleets.figures import robots_figure, trend_figure
from dynident.apps.fleets.result import FleetResult
from dynident.regression import GroupKind, ParameterGroup
from dynident.report.page import (
    Badge,
    Beside,
    Column,
    Facts,
    Figure,
    Fold,
    Gallery,
    Head,
    PageBlock,
    PageSection,
    PageTable,
    pair_table,
    render,
)
from dynident.runtime import Use, count, join_names, number, percent
from dynident.runtime.jobs import Status

REPORT = "report.html"  # of a log, in its folder
# logs, those of a robot at least, robots, failed logs
MAX_LOGS, MIN_ROBOT_LOGS, MAX_ROBOTS, MAX_FAILED = 2000, 5, 300, 200
MAX_REASON_LENGTH = 200  # letters of a reason
Row = Mapping[str, Any]
LOG_KEYS, REASON = ("log", "robot", "status"), Column("reason", numeric=False, prose=True)
MAX_SENTENCES, MAX_TABLE_ROWS = 6, 200  # changes in sentences, and in the table
# robots whose changes are drawn, those of them that are not folded, panels of a change
MAX_DRAWN_ROBOTS, MAX_OPEN_ROBOTS, MAX_PANELS = 40, 8, 4
MAX_SIDE_BY_SIDE, MAX_GROUP_PARAMETERS = 48, 4  # robots, and parameters of a group, that are drawn side by side
MAX_TERMINAL_ROWS = 20  # rows of a table in a terminal
_CHANGES = (
    "A change is reported where it is larger than what standard errors and the scatter from log to log explain. Of "
    "{tested} without a change, {expected} would be listed here by chance ({rate}). A step is sudden, a drift "
    "gradual; +- is one standard error. The p-value is the share of robots without a change that would show as much."
)
_COURSES = (
    "Each point is one log with its 95 % interval, which includes the scatter from log to log; all other parameters "
    "are at the mean of the robot's logs. A residual is the root mean square of the torque that the model leaves. The "
    "solid line is the change that was found, the dashed line its start, a pale strip the 95 % interval of the start. "
    "Of very many logs some are drawn, spread evenly over their number."
)


def log_rows(fleet: FleetResult) -> Sequence[Row]:
    """Return the rows of the logs, without the columns that only computations need."""
    return fleet.rows.drop("value", "information").to_dicts()


def failed_rows(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of logs that have no result."""
    return [row for row in rows if row["status"] != Status.OK]


def failure_words(rows: Sequence[Row]) -> str:
    """Return how many logs have no result, by status, as a sentence; an empty text where all have one."""
    lost = Counter(row["status"] for row in failed_rows(rows))
    parts = [f"{times} {status}" for status, times in lost.most_common()]
    have = "has" if lost.total() == 1 else "have"
    return f"{lost.total()} of {count(len(rows), 'log')} {have} no result: {', '.join(parts)}." if lost else ""


def failed_table(rows: Sequence[Row], max_rows: int = MAX_FAILED) -> Iterator[PageTable]:
    """Yield the table of logs without a result, where there is one, with the reasons."""
    lost = failed_rows(rows)
    if lost:
        cells = ((*(row[key] for key in LOG_KEYS), _shorten_reason(row["reason"] or "")) for row in lost[:max_rows])
        suffix = f", the first {max_rows} of {len(lost)}" if len(lost) > max_rows else ""
        yield PageTable.of(LOG_KEYS, (REASON,), cells, f"Logs without a result{suffix}")


def _shorten_reason(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= MAX_REASON_LENGTH else f"{line[:MAX_REASON_LENGTH]}..."


def robot_table(rows: Sequence[Row], changes: Mapping[str, int], max_rows: int) -> PageTable:
    """Return the table of robots: logs, failures, last log and its error; robots with most changes come first."""
    logs = _rows_by_robot(rows)
    order = sorted(logs, key=lambda robot: (-changes.get(robot, 0), -len(failed_rows(logs[robot]))))
    heads = ("changes", "logs", "failed", Column("last log", numeric=False), "its error, %")
    cells = []
    for robot in order[:max_rows]:
        good = [row for row in logs[robot] if row["status"] == Status.OK]
        last = good[-1] if good else {}
        counts = map(str, (changes.get(robot, 0), len(logs[robot]), len(logs[robot]) - len(good)))
        cells.append((robot, logs[robot][0]["type"] or "", *counts, _date_text(last), number(last.get("error"), 3)))
    suffix = f", {max_rows} of {len(order)}" if len(order) > max_rows else ""
    return PageTable.of(("robot", "type"), heads, cells, f"Robots{suffix}")


def log_section(fleet: FleetResult) -> PageSection:
    """Return the section of all logs, by robot: the last ones of each, as many as fit on a page."""
    rows = log_rows(fleet)
    logs = _rows_by_robot(rows)
    # Robots share the room of the page, but each shows a few logs
    logs_per_robot = max(MIN_ROBOT_LOGS, MAX_LOGS // max(min(len(logs), MAX_ROBOTS), 1))
    blocks: list[PageBlock] = [_lead_text(rows, len(logs), logs_per_robot), *failed_table(rows)]
    joints = [joint.name for joint in fleet.base.joints]
    for robot in list(logs)[:MAX_ROBOTS]:
        lost = len(failed_rows(logs[robot]))
        title = f"{robot}: {count(len(logs[robot]), 'log')}" + (f", {lost} without a result" if lost else "")
        blocks.append(Fold(title, (_log_table(logs[robot], joints, logs_per_robot),)))
    return PageSection("Logs", tuple(blocks))


def _lead_text(rows: Sequence[Row], robots: int, logs_per_robot: int) -> str:
    lead = "Errors are relative torque errors, those held out on another log. "
    if any(row["folder"] for row in rows):
        lead += "Each log leads to its own report. "
    if robots > MAX_ROBOTS or any(times > logs_per_robot for times in Counter(row["robot"] for row in rows).values()):
        lead += f"Of {len(rows)} logs of {count(robots, 'robot')}, the last {logs_per_robot} of each robot are here, "
        lead += f"of the first {MAX_ROBOTS} robots" if robots > MAX_ROBOTS else "of all robots"
        lead += "; `fleet.parquet` has all."
    return lead


def _log_table(rows: Sequence[Row], joints: Sequence[str], max_rows: int) -> PageTable:
    last_rows = rows[-max_rows:]
    has_held_out = any(row["held_out"] for row in last_rows)
    heads: list[Head] = ["error, %", "worst joint, %", *["held out, %"] * has_held_out, "samples", "time, s", REASON]
    cells = []
    for row in last_rows:
        errors = [number(row["error"], 3), _worst_joint_text(row["errors"], joints)]
        errors += [number(max(row["held_out"]), 3) if row["held_out"] else "-"] if has_held_out else []
        cost = [str(row["samples"]) if row["samples"] else "-", number(row["seconds"], 2)]
        is_judged = row["status"] == Status.OK and row["verdict"]
        status = Use(row["verdict"]).value if is_judged else str(row["status"])
        cells.append((row["log"], _date_text(row), status, *errors, *cost, _shorten_reason(row["reason"] or "")))
    caption = f"The last {max_rows} of {len(rows)} logs" if len(rows) > max_rows else ""
    reports = [f"{row['folder']}/{REPORT}" if row["folder"] else "" for row in last_rows]
    return PageTable.of(("log", "date", "status"), heads, cells, caption, reports)


def _rows_by_robot(rows: Sequence[Row]) -> dict[str, list[Row]]:
    logs: dict[str, list[Row]] = {}
    for row in rows:
        logs.setdefault(row["robot"], []).append(row)
    return logs


def _date_text(row: Row) -> str:
    return row["date"].strftime("%Y-%m-%d %H:%M").removesuffix(" 00:00") if row.get("date") else "-"


def _worst_joint_text(errors: Sequence[float] | None, joints: Sequence[str]) -> str:
    if not errors:
        return "-"
    k = max(range(len(errors)), key=lambda k: errors[k])
    return f"{number(errors[k], 3)} ({joints[k]})" if len(joints) == len(errors) else number(errors[k], 3)


def fleet_page(fleet: FleetResult) -> str:
    """Return the fleet as one HTML page, which links the report of each log by its folder, relative to the page."""
    changes = sort_by_severity(_all_changes(fleet))
    robots = _trends_by_robot(fleet, changes)
    sections = [
        PageSection("What changed", tuple(_summary(fleet, changes, robots)), _badge(fleet, changes)),
        *_changed_section(fleet, robots),
        *_all_section(fleet, robots),
        *pooled_sections(fleet),
        log_section(fleet),
        PageSection("What was done", tuple(_method(fleet))),
    ]
    return render(f"Fleet: {fleet.name}", fleet_heading(fleet), sections)


def fleet_findings(fleet: FleetResult) -> list[str]:
    """Return plain sentences: each change, the worst first, robots with too few logs, and logs without a result."""
    changes = sort_by_severity(_all_changes(fleet))
    tested = sum(len(type_changes.p_values) for type_changes in fleet.changes)
    quiet = [f"No change is found on {count(tested, 'robot')}."] if tested else []
    robots = _trends_by_robot(fleet, changes)
    reported = changes[:MAX_SENTENCES]
    lines = [change_words(x, fleet.start, robots[x.robot].mean_values(x.group)) for x in reported] or quiet
    if len(changes) > MAX_SENTENCES:
        lines.append(f"The table of the report has {count(len(changes) - MAX_SENTENCES, 'more change')}.")
    if silent := [robot for type_changes in fleet.changes for robot in type_changes.silent]:
        lines.append(f"Too few logs to find changes: {join_names(silent)}.")
    rows = log_rows(fleet)
    for row in failed_rows(rows)[:1]:
        reason = _shorten_reason(row["reason"] or "no reason").removesuffix(".")
        lines.append(f"{failure_words(rows)} For example {row['log']}: {reason}.")
    return lines


def fleet_tables(fleet: FleetResult) -> list[PageTable]:
    """Return the tables for a terminal: the changes, the robots, and the logs without a result."""
    changes = sort_by_severity(_all_changes(fleet))
    rows, times = log_rows(fleet), Counter(change.robot for change in changes)
    tables = [change_table(fleet, changes, MAX_TERMINAL_ROWS)] if changes else []
    return [*tables, robot_table(rows, times, MAX_TERMINAL_ROWS), *failed_table(rows, MAX_TERMINAL_ROWS)]


def fleet_heading(fleet: FleetResult) -> str:
    """Return one sentence on the size and the dates of the fleet."""
    rows = log_rows(fleet)
    dates = sorted(row["date"] for row in rows if row["date"])
    span = f", {dates[0]:%Y-%m-%d} to {dates[-1]:%Y-%m-%d}" if dates else ""
    return f"{count(len(rows), 'log')} of {count(len({row['robot'] for row in rows}), 'robot')}{span}."


def _all_changes(fleet: FleetResult) -> list[Change]:
    return [change for type_changes in fleet.changes for change in type_changes.changes]


def _badge(fleet: FleetResult, changes: Sequence[Change]) -> Badge:
    if not any(type_changes.p_values for type_changes in fleet.changes):
        return Badge("too few logs to say", "fair")
    robots = len({change.robot for change in changes})
    return Badge(f"{count(robots, 'robot')} changed", "bad") if robots else Badge("no change", "good")


def _summary(fleet: FleetResult, changes: Sequence[Change], trends: Mapping[str, RobotTrends]) -> Iterator[PageBlock]:
    rows = log_rows(fleet)
    robots, lost = len({row["robot"] for row in rows}), len(failed_rows(rows))
    tested = sum(len(type_changes.p_values) for type_changes in fleet.changes)
    facts: list[tuple[str, ...]] = [
        (f"{len({change.robot for change in changes})} of {robots}", "robots that changed"),
        (f"{len(rows) - lost} of {len(rows)}", "logs with a result"),
    ]
    if fleet.changes:
        facts.append((percent(100 * fleet.changes[0].rate), "false alarms", "of robots in which nothing changes"))
    yield Facts(tuple(facts))
    findings = tuple(fleet_findings(fleet))
    worst = next((robot for robot in trends.values() if robot.all_changes), None)
    yield findings if worst is None else Beside((findings,), (next(_change_figures(worst, fleet)),), "left")
    if fleet.warnings:
        yield fleet.warnings
    if changes:
        table = change_table(fleet, changes, MAX_TABLE_ROWS, with_times=True)
        # Only the page typesets the signs; a terminal shows them as they are
        table = replace(table, rows=tuple(tuple(map(_typeset_plus_minus, row)) for row in table.rows))
        yield table if len(changes) > MAX_SENTENCES else Fold("With p-values and logs", (table,))
    if tested:
        rate = fleet.changes[0].rate
        expected, words = number(tested * rate, 2), percent(100 * rate)
        yield _CHANGES.format(tested=count(tested, "robot"), expected=expected, rate=words)


def _typeset_plus_minus(text: str) -> str:
    return text.replace(" +- ", " ± ")


def _trends_by_robot(fleet: FleetResult, changes: Sequence[Change]) -> dict[str, RobotTrends]:
    """Return the trends of all robots, those with the worst change first."""
    robot_changes: dict[str, list[Change]] = {}
    for change in changes:
        robot_changes.setdefault(change.robot, []).append(change)
    statistics = {robot: type_changes for type_changes in fleet.changes for robot in type_changes.p_values}
    residuals = {history.robot: history for history in fleet.residuals}
    histories = {history.robot: history for history in fleet.histories}
    return {
        robot: _robot_trends(
            histories[robot], residuals.get(robot), robot_changes.get(robot, []), statistics.get(robot)
        )
        for robot in dict.fromkeys((*robot_changes, *histories))
        if robot in histories
    }


def _robot_trends(
    history: History, residuals: History | None, changes: Sequence[Change], statistics: Changes | None
) -> RobotTrends:
    """Return the trends of one robot, with those of the residual beside its parameters."""
    residual_changes = [change for change in changes if change.group.kind is GroupKind.RESIDUAL]
    scatter, residual_scatter = (statistics.scatter, statistics.residual_scatter) if statistics else (None, None)
    residual_trends = RobotTrends(residuals, residual_changes, residual_scatter) if residuals else None
    parameter_changes = [change for change in changes if change not in residual_changes]
    return RobotTrends(history, parameter_changes, scatter, residual_trends)


def _changed_section(fleet: FleetResult, robots: Mapping[str, RobotTrends]) -> Iterator[PageSection]:
    """Yield the section with the figures of the robots that changed."""
    changed = [trends for trends in robots.values() if trends.all_changes]
    if changed:
        blocks: list[PageBlock] = [_COURSES]
        for k, trends in enumerate(changed[:MAX_DRAWN_ROBOTS]):
            figures_of = tuple(_change_figures(trends, fleet))
            blocks.append((PageSection if k < MAX_OPEN_ROBOTS else Fold)(trends.history.robot, figures_of))
        if (hidden := len(changed) - MAX_DRAWN_ROBOTS) > 0:
            blocks.append(f"The changes of {count(hidden, 'more robot')} are in the table above only.")
        yield PageSection("Robots that changed", tuple(blocks))


def _change_figures(trends: RobotTrends, fleet: FleetResult) -> Iterator[Figure]:
    """Yield a figure for each group that changed, with the parameters that did."""
    groups: dict[str, list[Change]] = {}
    for change in trends.all_changes:
        groups.setdefault(group_words(change.group), []).append(change)
    for changes in groups.values():
        parameter_trends = trends.group_trends(changes[0].group)
        indices = list(dict.fromkeys(k for change in changes for k in clear_directions(change)))[:MAX_PANELS]
        words = (change_words(change, fleet.start, trends.mean_values(change.group)) for change in changes)
        figure = trend_figure([parameter_trends[k] for k in sorted(indices)], fleet.start)
        yield Figure(figure, _typeset_plus_minus(" ".join(words)))


def _all_section(fleet: FleetResult, robots: Mapping[str, RobotTrends]) -> Iterator[PageSection]:
    """Yield the section with robots side by side, one view per type and group, the largest changes first."""
    types = {kind: [trends for name, trends in robots.items() if name in names] for kind, names in fleet.types.items()}
    types = {kind: members for kind, members in types.items() if members}
    # Types share the room for robots side by side
    max_robots = max(MAX_SIDE_BY_SIDE // max(len(types), 1), 1)
    drawn = {kind: members[:max_robots] for kind, members in list(types.items())[:MAX_SIDE_BY_SIDE]}
    words = list(dict.fromkeys([group_words(change.group) for change in sort_by_severity(_all_changes(fleet))]))
    groups = sorted(
        (*fleet.groups, *(residual_groups(fleet.base.joints) if fleet.residuals else ())),
        key=lambda candidate: words.index(word) if (word := group_words(candidate)) in words else len(words),
    )
    views = tuple(
        ((kind, group_words(group)), tuple(_side_by_side(group, members, fleet)))
        for kind, members in drawn.items()
        for group in groups
    )
    if not views:
        return
    lead = f"All have the same axes; robots that changed in this are red. {_COURSES}"
    if (drawn_count := sum(map(len, drawn.values()))) < len(robots):
        lead += f" Drawn are {drawn_count} of {len(robots)} robots, those that changed first."
    yield PageSection("All robots", (lead, Gallery(("type", "group"), views)))


def _side_by_side(group: ParameterGroup, robots: Sequence[RobotTrends], fleet: FleetResult) -> Iterator[PageBlock]:
    """Yield a figure of each of the first parameters of a group, for all robots."""
    trends_by_robot = [trends.group_trends(group) for trends in robots]
    for k in range(min(len(group.names), MAX_GROUP_PARAMETERS)):
        caption = f"{trends_by_robot[0][k].name}, {group.units[k]}"
        yield Figure(robots_figure([trends[k] for trends in trends_by_robot], fleet.start), caption)
    if len(group.names) > MAX_GROUP_PARAMETERS:
        yield f"Not drawn: {join_names(group.names[MAX_GROUP_PARAMETERS:])}."


def _method(fleet: FleetResult) -> Iterator[PageBlock]:
    rows = log_rows(fleet)
    versions = Counter(row["version"] for row in rows if row["version"])
    recipes = Counter(row["recipe"] for row in rows)
    facts = [
        ("logs identified by this run", str(fleet.identified_count)),
        ("versions of dynident", ", ".join(f"{version} ({times} logs)" for version, times in versions.most_common())),
        ("recipes", ", ".join(f"{recipe} ({times} logs)" for recipe, times in recipes.most_common(12))),
        ("time of all fits", f"{number(sum(row['seconds'] or 0.0 for row in rows), 3)} s"),
        ("base parameters", str(len(fleet.base.names))),
    ]
    yield pair_table("", facts)
    meaning = zip(fleet.base.names, fleet.base.units, fleet.base.groupings, strict=True)
    yield Fold("Base parameters", (PageTable.of(("parameter", "unit", "sum of"), (), meaning),))
