"""Tables of ``dynident check``: findings grouped by kind, and the facts behind them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from dynident.checks import ChannelFacts, CheckResult, Excitation, RobotJointFacts, Timing
from dynident.report.page import Column, PageTable
from dynident.runtime import Finding, Severity, Use, count, number, place_and_text

TITLES = {Severity.ERROR: "Errors", Severity.WARNING: "Warnings", Severity.INFO: "Good to know"}
USE_ORDER = {Use.CONTROL: 0, Use.SIMULATION: 1, None: 2}  # what forbids a use comes first


def check_summary(check: CheckResult) -> str:
    """Return the outcome in one sentence."""
    counts = Counter(finding.severity for finding in (group[0] for group in finding_groups(check.findings)))
    parts = [count(counts[severity], severity) for severity in (Severity.ERROR, Severity.WARNING) if counts[severity]]
    return f"{' and '.join(parts) or 'No errors and no warnings'}."


def check_tables(check: CheckResult) -> list[PageTable]:
    """Return all tables: errors, warnings, what is good to know, then the facts."""
    return [*finding_tables(check).values(), *fact_tables(check)]


def finding_tables(check: CheckResult) -> dict[Severity, PageTable]:
    """Return the tables of errors, warnings, and what is good to know, as far as there are any."""
    groups = sorted(finding_groups(check.findings), key=lambda group: USE_ORDER[group[0].forbids])
    return {
        severity: finding_table(matching, title)
        for severity, title in TITLES.items()
        if (matching := [group for group in groups if group[0].severity == severity])
    }


def fact_tables(check: CheckResult) -> list[PageTable]:
    """Return the tables of the facts on logs and robot file."""
    tables: list[PageTable] = []
    if check.timings:
        tables.append(_time_table(check.timings))
    if check.excitations:
        tables += [_motion_table(check), _rank_table(check)]
    if check.channels:
        tables.append(_channel_table(*next(iter(check.channels.items()))))
    elif check.links:
        tables += _joint_tables(check.joints) if check.joints else ()
        tables.append(_link_table(check))
    return tables


def check_dict(check: CheckResult) -> dict[str, Any]:
    """Return everything as plain values: findings, and facts on logs, joints, rank and links."""
    return {
        "findings": [
            {**vars(x), "severity": x.severity.value, "topic": x.topic, "message": x.text} for x in check.findings
        ],
        "logs": {
            name: {**asdict(timing), "channels": [asdict(x) for x in check.channels.get(name, ())]}
            for name, timing in check.timings.items()
        },
        "joints": [
            {**asdict(excitation), "nominal": asdict(agreement)}
            for excitation, agreement in zip(check.excitations, check.agreements, strict=True)
        ],
        "rank": {**asdict(rank), "missing": [{**asdict(note), "words": str(note)} for note in rank.missing]}
        if (rank := check.rank)
        else None,
        "links": [asdict(link) for link in check.links],
        "robot_joints": [asdict(joint) for joint in check.joints],
    }


def finding_groups(findings: Sequence[Finding]) -> list[list[Finding]]:
    """Group findings of one kind across joints, links and logs.

    Two findings at the same place go into different groups.
    """
    groups: dict[tuple[object, ...], list[Finding]] = {}
    place_counts: Counter[tuple[object, ...]] = Counter()
    for finding in findings:
        # A second finding at the same place starts a group of its own
        place = (*finding.kind, finding.source, finding.joint, finding.link)
        groups.setdefault((*finding.kind, place_counts[place]), []).append(finding)
        place_counts[place] += 1
    return list(groups.values())


def finding_table(groups: Sequence[Sequence[Finding]], title: str) -> PageTable:
    """Return groups of findings as a table of places and messages."""
    message = Column("what, and what to do", numeric=False, prose=True)
    return PageTable.of(("where",), [message], map(place_and_text, groups), title)


def _time_table(timings: Mapping[str, Timing]) -> PageTable:
    heads = ("samples", "length, s", "rate, Hz", "jitter, %", "longest step, ms", "lost", "noise if even")
    rows = []
    for name, timing in timings.items():
        # Jitter below 1 ppm is rounding of the stamps
        jitter = number(100 * timing.jitter if timing.jitter > 1e-6 else 0.0, 2)
        sizes = str(timing.samples), number(timing.length), number(timing.rate)
        steps = number(1000 * timing.longest, 3), str(timing.missing), f"x {timing.even:.3g}"
        rows.append((name, *sizes, jitter, *steps))
    return PageTable.of(("log",), heads, rows, "Time")


def _motion_table(check: CheckResult) -> PageTable:
    heads = (
        ("from", "position"), ("to", "position"), ("peak", "speed"), ("rms", "speed"), ("peak", "acceleration"),
        ("rms", "acceleration"), ("turns", ""), ("slow, %", ""), ("peak", "torque"), ("follows file", "torque"),
    )  # fmt: skip
    rows = []
    for excitation, agreement in zip(check.excitations, check.agreements, strict=True):
        lengths, motion = excitation_cells(excitation)
        follows = "-" if np.isnan(agreement.correlation) else f"{agreement.correlation:z.2f}"
        rows.append((excitation.joint, *lengths, *motion, follows))
    caption = "Motion in training, SI (peak: 99.9 %; slow: below 2 % of the peak speed)"
    return PageTable.of(("joint",), heads, rows, caption)


def excitation_cells(motion: Excitation) -> tuple[list[str], list[str]]:
    """Return the cells of a joint's range, and those of its speed, acceleration, turns, slowness and torque."""
    sizes = (motion.peak_speed, motion.rms_speed, motion.peak_acceleration, motion.rms_acceleration)
    turns = [str(motion.reversals), number(100 * motion.slow, 2), number(motion.torque, 3)]
    return [number(motion.lower, 3), number(motion.upper, 3)], [*(number(size, 3) for size in sizes), *turns]


def _rank_table(check: CheckResult) -> PageTable:
    rank = check.rank
    assert rank is not None  # noqa: S101 -- made together with the excitations
    row = (str(rank.count), str(rank.structural), str(rank.on_data), number(rank.condition, 3))
    heads = ("parameters", "maximum rank", "rank in training", "condition")
    return PageTable.of((), heads, [row], "Identifiability on the training logs")


def _channel_table(name: str, channels: Sequence[ChannelFacts]) -> PageTable:
    heads = (
        ("noise", "position"), ("step", "position"), ("noise/step", "position"),
        ("repeats, %", "position"), ("still, %", "position"),
        ("rms", "torque"), ("noise", "torque"), ("step", "torque"),
    )  # fmt: skip
    caption = f"Channels of {name}, SI{_left_out_words(channels)}"
    return PageTable.of(("joint",), heads, map(_channel_cells, channels), caption)


def _channel_cells(channel: ChannelFacts) -> Iterator[str]:
    yield channel.joint
    yield from (number(channel.noise, 2), number(channel.resolution, 3), number(channel.noise / channel.resolution, 2))
    yield from (number(100 * channel.repeats, 2), number(100 * channel.still, 2))
    yield from (number(channel.rms, 3), number(channel.torque_noise, 2), number(channel.torque_resolution, 3))


def _left_out_words(channels: Sequence[ChannelFacts]) -> str:
    """Return how many samples of the channels are left out of their figures, as the fit leaves them out."""
    counts = (("positions", sum(x.left_out for x in channels)), ("torques", sum(x.torque_left_out for x in channels)))
    excluded = " and ".join(f"{count} {quantity}" for quantity, count in counts if count)
    return f"; without {excluded} that the fit leaves out" if excluded else ""


def _joint_tables(joints: Sequence[RobotJointFacts]) -> Iterator[PageTable]:
    """Yield the joints of a robot file, then those that do not move by themselves; m and N for prismatic ones."""
    heads = ("from", "position"), ("to", "position"), ("velocity", "limits"), ("effort", "limits"), ("body, kg", "")
    rows = []
    for joint in joints:
        limits = joint.limits.lower, joint.limits.upper, joint.limits.velocity, joint.limits.effort
        is_continuous = joint.kind == "revolute" and joint.limits.lower is None and joint.limits.upper is None
        kind = "held fixed" if joint.held else "continuous" if is_continuous else joint.kind
        cells = ("-" if value is None or np.isnan(value) else f"{value:.4g}" for value in (*limits, joint.mass))
        rows.append((joint.joint, kind, *cells))
    caption = "Joints, SI (body: the link that it moves and those fixed to it)"
    yield PageTable.of(("joint", "type"), heads, rows, caption)
    if dependent := [(joint.joint, words) for joint in joints if (words := _coupling_words(joint))]:
        how = Column("how", numeric=False, prose=True)
        yield PageTable.of(("joint",), (how,), dependent, "Joints that do not move by themselves")


def _coupling_words(joint: RobotJointFacts) -> str:
    """Return how a dependent joint moves, an empty text for one that moves by itself."""
    if joint.held:
        return f"held fixed: {joint.held}"
    if joint.follows is None:
        return ""
    master, factor, offset = joint.follows
    return f"mimics {master}, times {factor:.4g}" + (f", plus {offset:.4g}" if offset else "")


def _link_table(check: CheckResult) -> PageTable:
    moments = ((title, "moments") for title in ("smallest", "middle", "largest"))
    rows = [
        (x.link, number(x.mass), number(float(np.linalg.norm(x.centre)), 3), *(number(float(m), 3) for m in x.moments))
        for x in check.links
    ]
    rows.append(("all", number(sum(x.mass for x in check.links)), *[""] * 4))
    caption = "Links (principal moments about the centre of mass, kg m^2)"
    return PageTable.of(("link",), ("mass, kg", "centre at, m", *moments), rows, caption)
