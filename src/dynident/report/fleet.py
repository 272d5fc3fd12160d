"""The report of a fleet: what changed where and when, all robots side by side, what they share, and every log."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from dynident.errors import listed
from dynident.fleets import residual_groups
from dynident.regression import GroupKind
from dynident.report import figures
from dynident.report.fleet_courses import RobotCourses
from dynident.report.fleet_logs import failed, failed_table, failure_words, log_section, robot_table, rows_of
from dynident.report.fleet_pooled import pooled_sections
from dynident.report.fleet_words import change_table, change_words, changed_in, group_words, with_times, worst_first
from dynident.report.page import (
    Badge,
    Column,
    Facts,
    Figure,
    Fold,
    Gallery,
    PageBlock,
    PageSection,
    PageTable,
    number,
    pairs,
    render,
)
from dynident.report.words import count, percent

if TYPE_CHECKING:
    from dynident.fleets import Change, Changes, FleetResult, History
    from dynident.regression import Group

__all__ = ["fleet_findings", "fleet_heading", "fleet_page", "fleet_tables"]

IN_WORDS, IN_TABLE = 8, 200  # changes in sentences, and in the table
DRAWN, OPEN, PANELS = 40, 8, 4  # robots whose changes are drawn, those of them that are not folded, panels of a change
SIDE_BY_SIDE, SMALL = 48, 4  # robots, and parameters of a group, that are drawn side by side
IN_TERMINAL = 20  # rows of a table in a terminal
_CHANGES = (
    "A change is reported where it is larger than what standard errors and the scatter from log to log explain. Of "
    "{tested}, in which nothing changes, {expected} would be listed here by chance ({rate}). A step comes at once, "
    "a drift with time; +- is one standard error, and a p-value the share of robots without a change that would "
    "show as much."
)
_COURSES = (
    "Each point is one log with its 95 % interval, which counts the scatter from log to log; all else is as in the "
    "mean of the robot's logs. A residual is the root mean square of the torque that the model leaves. The line is "
    "what was found, dashed where it begins; where there is a pale strip, it may have begun anywhere in it (95 %)."
)


def fleet_page(found: FleetResult) -> str:
    """Return the fleet as one HTML page, which links the report of each log by its folder, relative to the page."""
    changes = worst_first(_changes(found))
    robots = _robots(found, changes)
    sections = [
        PageSection("What changed", tuple(_summary(found, changes)), _badge(found, changes)),
        *_changed_section(found, robots),
        *_all_section(found, robots),
        *pooled_sections(found),
        log_section(found),
        PageSection("What was done", tuple(_method(found))),
    ]
    return render(f"Fleet: {found.name}", fleet_heading(found), sections)


def fleet_findings(found: FleetResult) -> list[str]:
    """Return plain sentences: each change, the worst first, what could not be said, and which logs have no result."""
    changes = worst_first(_changes(found))
    tested = sum(len(one.p_values) for one in found.changes)
    quiet = [f"No change is found on {count(tested, 'robot')}."] if tested else []
    robots = _robots(found, changes)
    some = changes[:IN_WORDS]
    lines = [change_words(one, found.start, robots[one.robot].before(one.group)) for one in some] or quiet
    if len(changes) > IN_WORDS:
        lines.append(f"There are {count(len(changes) - IN_WORDS, 'more change')}; the table has them.")
    if silent := [robot for one in found.changes for robot in one.silent]:
        lines.append(f"Too few logs to find changes: {listed(silent)}.")
    return [*lines, *filter(None, [failure_words(rows_of(found))])]


def fleet_tables(found: FleetResult) -> list[PageTable]:
    """Return for a terminal: the changes, the robots, and the logs without a result."""
    changes = worst_first(_changes(found))
    rows, times = rows_of(found), Counter(one.robot for one in changes)
    tables = [change_table(found, changes, IN_TERMINAL)] if changes else []
    return [*tables, robot_table(rows, times, IN_TERMINAL), *failed_table(rows, IN_TERMINAL)]


def fleet_heading(found: FleetResult) -> str:
    """Return what the fleet is, in a line."""
    rows = rows_of(found)
    dates = sorted(row["date"] for row in rows if row["date"])
    span = f", {dates[0]:%Y-%m-%d} to {dates[-1]:%Y-%m-%d}" if dates else ""
    return f"{count(len(rows), 'log')} of {count(len({row['robot'] for row in rows}), 'robot')}{span}."


def _changes(found: FleetResult) -> list[Change]:
    return [change for one in found.changes for change in one.found]


def _badge(found: FleetResult, changes: Sequence[Change]) -> Badge:
    if not any(one.p_values for one in found.changes):
        return Badge("too few logs to say", "fair")
    robots = len({one.robot for one in changes})
    return Badge(f"{count(robots, 'robot')} changed", "bad") if robots else Badge("no change", "good")


def _summary(found: FleetResult, changes: Sequence[Change]) -> Iterator[PageBlock]:
    rows = rows_of(found)
    robots, lost = len({row["robot"] for row in rows}), len(failed(rows))
    tested = sum(len(one.p_values) for one in found.changes)
    facts: list[tuple[str, ...]] = [
        (f"{len({one.robot for one in changes})} of {robots}", "robots that changed"),
        (f"{len(rows) - lost} of {len(rows)}", "logs with a result"),
    ]
    if found.changes:
        facts.append((percent(100 * found.changes[0].rate), "false alarms", "of robots in which nothing changes"))
    yield Facts(tuple(facts))
    yield tuple(fleet_findings(found))
    if found.warnings:
        yield found.warnings
    if changes:
        table = with_times(change_table(found, changes, IN_TABLE), found, changes)
        table = replace(table, rows=tuple(tuple(map(_typeset, row)) for row in table.rows))
        yield table if len(changes) > IN_WORDS else Fold("With p-values and logs", (table,))
    if tested:
        rate = found.changes[0].rate
        expected, words = number(tested * rate, 2), percent(100 * rate)
        yield _CHANGES.format(tested=count(tested, "robot"), expected=expected, rate=words)


def _typeset(text: str) -> str:
    return text.replace(" +- ", " ± ")


def _robots(found: FleetResult, changes: Sequence[Change]) -> dict[str, RobotCourses]:
    """Return the courses of all robots, those with the worst change first."""
    own: dict[str, list[Change]] = {}
    for one in changes:
        own.setdefault(one.robot, []).append(one)
    of = {robot: one for one in found.changes for robot in one.p_values}
    left = {history.robot: history for history in found.residuals}
    histories = {history.robot: history for history in found.histories}
    order = [*(robot for robot in own if robot in histories), *(robot for robot in histories if robot not in own)]
    return {robot: _courses(histories[robot], left.get(robot), own.get(robot, []), of.get(robot)) for robot in order}


def _courses(history: History, left: History | None, own: Sequence[Change], of: Changes | None) -> RobotCourses:
    """Return those of one robot, what the model leaves beside its parameters."""
    residual = [one for one in own if one.group.kind is GroupKind.RESIDUAL]
    scatter, beside = (of.scatter, of.residual_scatter) if of else (None, None)
    drawn = RobotCourses(left, residual, beside) if left else None
    return RobotCourses(history, [one for one in own if one not in residual], scatter, drawn)


def _changed_section(found: FleetResult, robots: Mapping[str, RobotCourses]) -> Iterator[PageSection]:
    """Yield the section with the figures of the robots that changed."""
    changed = [one for one in robots.values() if one.changed]
    if changed:
        blocks: list[PageBlock] = [_COURSES]
        for k, one in enumerate(changed[:DRAWN]):
            figures_of = tuple(_drawn(one, found))
            blocks.append((PageSection if k < OPEN else Fold)(one.history.robot, figures_of))
        if len(changed) > DRAWN:
            blocks.append(f"The changes of {count(len(changed) - DRAWN, 'more robot')} are in the table above only.")
        yield PageSection("Robots that changed", tuple(blocks))


def _drawn(one: RobotCourses, found: FleetResult) -> Iterator[PageBlock]:
    """Yield a figure for each group that changed, with the parameters that did."""
    groups: dict[str, list[Change]] = {}
    for change in one.changed:
        groups.setdefault(group_words(change.group), []).append(change)
    for changes in groups.values():
        courses = one.of(changes[0].group)
        shown = list(dict.fromkeys(k for change in changes for k in changed_in(change)))[:PANELS]
        caption = _typeset(" ".join(change_words(change, found.start, one.before(change.group)) for change in changes))
        yield Figure(figures.course_figure([courses[k] for k in sorted(shown)], found.start), caption)


def _all_section(found: FleetResult, robots: Mapping[str, RobotCourses]) -> Iterator[PageSection]:
    """Yield the section with robots side by side, a view for each type and group, what changed most first."""
    types = {kind: [robots[name] for name in robots if name in names] for kind, names in _types(found).items()}
    types = {kind: some for kind, some in types.items() if some}
    each = max(SIDE_BY_SIDE // max(len(types), 1), 1)
    drawn = {kind: some[:each] for kind, some in list(types.items())[:SIDE_BY_SIDE]}
    words = list(dict.fromkeys([group_words(one.group) for one in worst_first(_changes(found))]))
    groups = sorted(
        (*found.groups, *(residual_groups(found.base.joints) if found.residuals else ())),
        key=lambda one: words.index(word) if (word := group_words(one)) in words else len(words),
    )
    views = tuple(
        ((kind, group_words(group)), tuple(_side_by_side(group, some, found)))
        for kind, some in drawn.items()
        for group in groups
    )
    if not views:
        return
    lead = f"All have the same axes; robots that changed in this are red. {_COURSES}"
    if (number_of := sum(map(len, drawn.values()))) < len(robots):
        lead += f" Drawn are {number_of} of {len(robots)} robots, those that changed first."
    yield PageSection("All robots", (lead, Gallery(("type", "group"), views)))


def _types(found: FleetResult) -> dict[str, frozenset[str]]:
    return {kind: frozenset(names) for kind, names in found.types.items()}


def _side_by_side(group: Group, robots: Sequence[RobotCourses], found: FleetResult) -> Iterator[PageBlock]:
    """Yield a figure of each parameter of a group, as far as there are few."""
    courses = [one.of(group) for one in robots]
    for k in range(min(len(group.names), SMALL)):
        caption = f"{courses[0][k].name}, {group.units[k]}"
        yield Figure(figures.robots_figure([one[k] for one in courses], found.start), caption)
    if len(group.names) > SMALL:
        yield f"Not drawn: {listed(group.names[SMALL:])}."


def _method(found: FleetResult) -> Iterator[PageBlock]:
    rows = rows_of(found)
    versions = Counter(row["version"] for row in rows if row["version"])
    recipes = Counter(row["recipe"] for row in rows)
    facts = [
        ("logs identified by this run", str(found.fitted)),
        ("versions of dynident", ", ".join(f"{one} ({times} logs)" for one, times in versions.most_common())),
        ("recipes", ", ".join(f"{one} ({times} logs)" for one, times in recipes.most_common(12))),
        ("time of all fits", f"{number(sum(row['seconds'] or 0.0 for row in rows), 3)} s"),
        ("base parameters", str(len(found.base.names))),
    ]
    yield pairs("", facts)
    meaning = tuple(zip(found.base.names, found.base.units, found.base.groupings, strict=True))
    heads = tuple(Column(title, numeric=False) for title in ("parameter", "unit", "sum of"))
    yield Fold("Base parameters", (PageTable(heads, meaning),))
