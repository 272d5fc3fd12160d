"""The words and tables of ``dynident check``: findings gathered by what they are about, and the facts behind them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident.errors import Note, Severity, Use
from dynident.report.finding_words import finding_words
from dynident.report.log_words import figures_words
from dynident.report.page import Column, PageTable, number
from dynident.report.wording import words
from dynident.report.words import count

if TYPE_CHECKING:
    from dynident.checks import (
        Agreement,
        ChannelFacts,
        CheckResult,
        Excitation,
        ExcitedRank,
        Finding,
        JointFacts,
        Timing,
    )

__all__ = ["check_dict", "check_summary", "check_tables", "finding_groups", "finding_row", "finding_table"]

TITLES = {Severity.ERROR: "Errors", Severity.WARNING: "Warnings", Severity.INFO: "Good to know"}
MOST_NAMES = 8
FIRST = {Use.CONTROL: 0, Use.SIMULATION: 1, None: 2}  # what forbids a use comes first


def check_summary(examination: CheckResult) -> str:
    """Return the outcome in one sentence."""
    counts = Counter(finding.severity for finding in (group[0] for group in finding_groups(examination.findings)))
    shown = [count(counts[severity], severity) for severity in (Severity.ERROR, Severity.WARNING) if counts[severity]]
    return f"{' and '.join(shown) or 'No errors and no warnings'}."


def check_tables(examination: CheckResult) -> list[PageTable]:
    """Return the tables for a terminal: errors, warnings, what is good to know, then the facts."""
    groups = sorted(finding_groups(examination.findings), key=lambda group: FIRST[group[0].forbids])
    tables = [
        finding_table(chosen, title)
        for severity, title in TITLES.items()
        if (chosen := [group for group in groups if group[0].severity == severity])
    ]
    if examination.timings:
        tables.append(_time_table(examination.timings))
    if examination.excitations:
        tables += [_motion_table(examination), _rank_table(examination)]
    if examination.channels:
        tables.append(_channel_table(*next(iter(examination.channels.items()))))
    elif examination.links:
        tables += _joint_tables(examination.joints) if examination.joints else ()
        tables.append(_link_table(examination))
    return tables


def check_dict(examination: CheckResult) -> dict[str, Any]:
    """Return everything as plain values: findings, and facts on logs, joints, rank and links."""
    return {
        "findings": [_plain(finding) for finding in examination.findings],
        "logs": {
            name: {
                **asdict(timing),
                "channels": [asdict(x) for x in examination.channels.get(name, ())],
            }
            for name, timing in examination.timings.items()
        },
        "joints": [
            {**asdict(moved), "nominal": asdict(torque)}
            for moved, torque in zip(examination.excitations, examination.agreements, strict=True)
        ],
        "rank": _rank(examination.rank) if examination.rank else None,
        "links": [asdict(link) for link in examination.links],
        "robot_joints": [asdict(joint) for joint in examination.joints],
    }


def _plain(finding: Finding) -> dict[str, Any]:
    return {
        **vars(finding),
        "severity": finding.severity.value,
        "topic": finding.topic.value if finding.topic else "",
        "message": finding_words(finding),
    }


def _rank(rank: ExcitedRank) -> dict[str, Any]:
    return {**asdict(rank), "missing": [{**asdict(one), "words": words(one)} for one in rank.missing]}


def finding_groups(findings: Sequence[Finding]) -> list[list[Finding]]:
    """Gather findings of one topic over joints, links and logs; two on the same place stay apart."""
    groups: dict[tuple[object, ...], list[Finding]] = {}
    seen: Counter[tuple[object, ...]] = Counter()
    for one in findings:
        kind = (one.severity, one.topic, type(one.message), _flags(one.message))
        place = (*kind, one.source, one.joint, one.link)
        key = (*kind, seen[place], finding_words(one) if not one.topic else "")
        seen[place] += 1
        groups.setdefault(key, []).append(one)
    return list(groups.values())


def finding_table(groups: Sequence[Sequence[Finding]], title: str) -> PageTable:
    """Return groups of findings as a table of places and what to do."""
    columns = Column("where", numeric=False), Column("what, and what to do", numeric=False, prose=True)
    return PageTable(columns, tuple(map(finding_row, groups)), title)


def finding_row(group: Sequence[Finding]) -> tuple[str, str]:
    """Return where the first finding of a group is and what it says, with the places of the others named."""
    first, *others = group
    part = first.link or first.joint or ""
    here = [_of(one.link or one.joint or "", one) for one in others if one.source == first.source]
    there = list(dict.fromkeys(_of(one.source, one, one.joint) for one in others if one.source != first.source))
    message = finding_words(first)
    if here:
        message += f" Likewise {_listed(here)}."
    if there:
        message += f" Also in {_listed(there)}."
    return " ".join(filter(None, (f"{first.source}:" if first.source and part else first.source, part))), message


def _flags(message: str | Note) -> tuple[bool, ...]:
    """Return what a note says by yes or no, such as what was done about it: notes that differ are not alike."""
    said = vars(message).values() if isinstance(message, Note) else ()
    return tuple(value for value in said if isinstance(value, bool))


def _of(name: str, finding: Finding, joint: str | None = None) -> str:
    """Return a name, with the rows and sizes that differ from one finding to the next."""
    figures = figures_words(finding.message)
    return f"{name} ({': '.join(filter(None, (joint, figures)))})" if figures else name


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return ", ".join(names[:MOST_NAMES]) + more


def _time_table(timings: Mapping[str, Timing]) -> PageTable:
    heads = ("samples", "length, s", "rate, Hz", "jitter, %", "longest step, ms", "lost", "noise if even")
    rows = tuple(
        (
            name,
            str(one.samples),
            number(one.length),
            number(one.rate),
            number(100 * one.jitter if one.jitter > 1e-6 else 0.0, 2),
            number(1000 * one.longest, 3),
            str(one.missing),
            f"x {one.even:.3g}",
        )
        for name, one in timings.items()
    )
    return PageTable((Column("log", numeric=False), *map(Column, heads)), rows, "Time")


def _motion_table(examination: CheckResult) -> PageTable:
    heads = (
        ("from", "position"), ("to", "position"), ("peak", "speed"), ("rms", "speed"), ("peak", "acceleration"),
        ("rms", "acceleration"), ("turns", ""), ("slow, %", ""), ("peak", "torque"), ("follows file", "torque"),
    )  # fmt: skip
    rows = tuple(map(_motion_row, examination.excitations, examination.agreements))
    columns = (Column("joint", numeric=False), *(Column(title, group) for title, group in heads))
    return PageTable(columns, rows, "Motion in training, SI (peak: 99.9 %; slow: below 2 % of the peak speed)")


def _motion_row(moved: Excitation, torque: Agreement) -> tuple[str, ...]:
    sizes = (
        moved.lower,
        moved.upper,
        moved.peak_speed,
        moved.rms_speed,
        moved.peak_acceleration,
        moved.rms_acceleration,
    )
    cells = [number(value, 3) for value in sizes]
    follows = "-" if np.isnan(torque.correlation) else f"{torque.correlation:z.2f}"
    slow = number(100 * moved.slow, 2)
    return (moved.joint, *cells, str(moved.reversals), slow, number(moved.torque, 3), follows)


def _rank_table(examination: CheckResult) -> PageTable:
    found = examination.rank
    assert found is not None  # noqa: S101 -- made together with the excitations
    row = (str(found.count), str(found.structural), str(found.on_data), number(found.condition, 3))
    heads = ("parameters", "rank any motion shows", "rank of these motions", "condition")
    return PageTable(tuple(map(Column, heads)), (row,), "What the training shows of the model")


def _channel_table(name: str, channels: Sequence[ChannelFacts]) -> PageTable:
    heads = (
        ("noise", "position"), ("step", "position"), ("noise/step", "position"),
        ("repeats, %", "position"), ("still, %", "position"),
        ("rms", "torque"), ("noise", "torque"), ("step", "torque"),
    )  # fmt: skip
    rows = tuple(tuple(_channel_row(one)) for one in channels)
    columns = (Column("joint", numeric=False), *(Column(title, group) for title, group in heads))
    return PageTable(columns, rows, f"Channels of {name}, SI{_left_out(channels)}")


def _channel_row(one: ChannelFacts) -> Iterator[str]:
    yield one.joint
    yield from (number(one.noise, 2), number(one.resolution, 3), number(one.noise / one.resolution, 2))
    yield from (number(100 * one.repeats, 2), number(100 * one.still, 2))
    yield from (number(one.rms, 3), number(one.torque_noise, 2), number(one.torque_resolution, 3))


def _left_out(channels: Sequence[ChannelFacts]) -> str:
    """Return what of the channels their figures leave out, as the fit does."""
    counts = (("positions", sum(x.left_out for x in channels)), ("torques", sum(x.torque_left_out for x in channels)))
    named = " and ".join(f"{count} {what}" for what, count in counts if count)
    return f"; without {named} that the fit leaves out" if named else ""


def _joint_tables(joints: Sequence[JointFacts]) -> Iterator[PageTable]:
    """Yield the joints of a robot file, and those that do not move by themselves; in m and N where prismatic."""
    heads = ("from", "position"), ("to", "position"), ("velocity", "limits"), ("effort", "limits"), ("body, kg", "")
    columns = Column("joint", numeric=False), Column("type", numeric=False), *(Column(*one) for one in heads)
    rows = []
    for one in joints:
        limits = one.limits.lower, one.limits.upper, one.limits.velocity, one.limits.effort
        kind = "held fixed" if one.held else "continuous" if _turns(one) else one.kind
        cells = ("-" if value is None or np.isnan(value) else f"{value:.4g}" for value in (*limits, one.mass))
        rows.append((one.joint, kind, *cells))
    yield PageTable(columns, tuple(rows), "Joints, SI (body: the link that it moves and those fixed to it)")
    if others := [(one.joint, how) for one in joints if (how := _moved(one))]:
        columns = Column("joint", numeric=False), Column("how", numeric=False, prose=True)
        yield PageTable(columns, tuple(others), "Joints that do not move by themselves")


def _turns(one: JointFacts) -> bool:
    return one.kind == "revolute" and one.limits.lower is None and one.limits.upper is None


def _moved(one: JointFacts) -> str:
    """Return how a joint moves, where it does not by itself."""
    if one.held:
        return f"held fixed: {one.held}"
    if one.follows is None:
        return ""
    master, factor, offset = one.follows
    return f"mimics {master}, times {factor:.4g}" + (f", plus {offset:.4g}" if offset else "")


def _link_table(examination: CheckResult) -> PageTable:
    heads = ("mass, kg", "centre at, m", "smallest", "middle", "largest")
    groups = ("", "", *["moments"] * 3)
    rows = [
        (x.link, number(x.mass), number(float(np.linalg.norm(x.centre)), 3), *(number(float(m), 3) for m in x.moments))
        for x in examination.links
    ]
    rows.append(("all", number(sum(x.mass for x in examination.links)), *[""] * 4))
    columns = (Column("link", numeric=False), *(Column(head, group) for head, group in zip(heads, groups, strict=True)))
    return PageTable(columns, tuple(rows), "Links (principal moments about the centre of mass, kg m^2)")
