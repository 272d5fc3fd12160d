"""Draft of a configuration from a robot file and logs: commented YAML with a reason for each proposal."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import numpy as np

from dynident.apps.init.column_mapping import ChannelProposal, ColumnMapping, widths
from dynident.apps.init.match import MovableJoint
from dynident.apps.init.servo_draft import GAIN_QUESTION, TORQUE_ADVICE, servo_section, servos_of_file
from dynident.files.opener import relative
from dynident.files.ros import BAGS
from dynident.files.tables import DataTable, read_columns
from dynident.files.xml_text import SUFFIXES
from dynident.files.yaml_text import UNPRINTABLE, yaml_name
from dynident.identification import moving_span
from dynident.motion.log import Log
from dynident.project.arms import find_arm
from dynident.project.columns import is_commanded, read_name
from dynident.project.fields import unit_factor
from dynident.project.logs import read_recording
from dynident.project.settings import LogSpec
from dynident.runtime import InputError, choices, count, join_names
from dynident.runtime.arrays import Array

_TRAINING_SHARE = 0.7  # of a single log
_MAX_MEASURED_VALUE = 1e100  # of values that can have been measured
_RATE_QUESTION = (
    "no stamps were found; at {} Hz other columns are the velocities, in rad/s if the positions are in rad: is this "
    "the sampling rate?"
)


@dataclass(frozen=True)
class LogSource:
    """A recording: its file, or files by short name, the widths of text files by short name, and its table."""

    files: Mapping[str, Path]
    widths: Mapping[str, int]
    table: DataTable

    @property
    def ros(self) -> bool:
        """Whether it is a bag, whose units are those of ROS."""
        return all(path.suffix.lower() in BAGS or path.is_dir() for path in self.files.values())


def read_source(log: str) -> LogSource:
    """Read a recording: a file, the folder of a ROS 2 bag, or files joined by a plus sign (``q.csv+tau.csv``).

    Several files get short names, from the parts in which their stems differ. Raises InputError where one cannot be
    read.
    """
    parts = [log] if os.path.exists(log) else log.split("+")
    if len(parts) == 1:
        return LogSource({"": Path(log)}, {}, read_columns(log))
    paths = [Path(part.strip()) for part in parts]
    files = dict(zip(_short_names([path.stem for path in paths]), paths, strict=True))
    if len(files) < len(paths):
        raise InputError(f"{log}: two of the files have the same name; rename one, or write the configuration by hand.")
    column_widths = widths({key: read_columns(path) for key, path in files.items()})
    spec = {"file": {key: str(path) for key, path in files.items()}, "width": column_widths or None}
    table = read_recording(LogSpec.model_validate(spec))
    rows = {key: {len(x) for name, x in table.columns.items() if name.startswith(f"{key}.")} for key in files}
    rows = {key: lengths for key, lengths in rows.items() if lengths}
    if rows and not set.intersection(*rows.values()):
        counts = join_names(f"{files[key]} has {count(max(lengths), 'row')}" for key, lengths in rows.items())
        raise InputError(f"{counts}; all files of a log need as many: interpolate to the stamps of the positions.")
    return LogSource(files, column_widths, table)


def _short_names(stems: Sequence[str]) -> list[str]:
    """Return the stems without the words that all of them share at the start and the end."""
    words = [re.split(r"[\W_]+", stem) for stem in stems]
    for _ in range(2):  # twice reversed, so that the common end goes, too
        shared = takewhile(lambda parts: len(set(parts)) == 1, zip(*words, strict=False))
        start = len(list(shared))
        words = [stem[start:][::-1] for stem in words]
    short = ["_".join(stem) for stem in words]
    return short if all(short) and len(set(short)) == len(short) else list(stems)


@dataclass(frozen=True)
class ConfigDraft:
    """The text of a configuration draft.

    ``notes`` say what it leaves out; ``questions`` are to be confirmed and ``blanks`` to be filled in. ``servos``:
    commands stand for the torques.
    """

    text: str
    notes: tuple[str, ...]
    questions: tuple[str, ...]
    blanks: tuple[str, ...]
    servos: bool = False


def check_same_columns(mapping: ColumnMapping, sources: Sequence[LogSource]) -> None:
    """Raise InputError where a later recording lacks a column that was mapped in the first."""
    sections = (mapping.position, mapping.torque, mapping.command)
    channels = [channel for section in sections for channel in section.values()]
    for source in sources[1:]:
        for name in filter(None, (mapping.time.column, *(channel.column for channel in channels))):
            if name not in source.table.columns:
                raise InputError(
                    f"{source.table.source}: has no column {name!r}, unlike {sources[0].table.source}; "
                    f"{choices(name, source.table.columns)} All logs of a configuration have the same columns: rename "
                    "those of one. Files that make one log together are joined by a plus: q.csv+tau.csv."
                )


def draft_config(
    robot: str, joints: Sequence[MovableJoint], mapping: ColumnMapping, sources: Sequence[LogSource], folder: Path
) -> ConfigDraft:
    """Draft the configuration; ``robot`` is the file as the user named it, files are relative to ``folder``.

    The last log is held out for validation; a single one is cut into two windows.
    """
    page = _Page([], [], [])
    start = "# For `dynident identify`. Every proposal has its reason beside it"
    page.line(f"{start}; confirm or correct those marked `# ?`.")
    _write_model(page, robot, joints, mapping, folder)
    for guess in dict.fromkeys(guess for source in sources for guess in source.table.guesses):
        page.ask("file", f"{guess} Is this right?")
    _write_time(page, mapping)
    _write_channels(page, "position", mapping.position, mapping)
    if mapping.command:
        lines, asked = servo_section(servos_of_file(robot, joints), mapping.command)
        page.lines.extend(lines)
        if asked:
            page.ask("simulation.joints", f"{join_names(asked)}: {GAIN_QUESTION}")
        joint_names = [joint.name for joint in joints]
        if torques := [column for column in mapping.unused if read_name(column, joint_names).role == "torque"]:
            page.ask("simulation", f"{join_names(map(repr, torques), 3)}: {TORQUE_ADVICE}")
    else:
        _write_channels(page, "torque", mapping.torque, mapping)
    _write_unused(page, mapping, sources[0].table)
    _write_logs(page, mapping, sources, folder)
    if mapping.gaps:
        page.line("gaps: split  # the stamps have gaps, or rows are empty; each piece is smoothed separately")
    if not mapping.command:
        page.line("")
        page.line(
            "estimator: { kind: consistent }  # physically consistent bodies, no negative friction; or least_squares"
        )
    _write_usual_limits(page, joints, mapping)
    notes = []
    if mapping.still_joints:
        notes.append(
            "no motion in the logs, or next to none, so locked where they stand (`model.lock`): "
            f"{join_names(map(repr, mapping.still_joints))}; what they carry is part of the body before them, and they "
            "have no friction of their own."
        )
    if mapping.unknown_joints:
        names = join_names(map(repr, mapping.unknown_joints))
        notes.append(f"recorded, but no joint of the robot file, or one that follows another, so left out: {names}.")
    table = sources[0].table
    # a column of text that is named as one of numbers may be what another was taken for
    faults = {name: fault for name, fault in table.faults.items() if name not in table.texts}
    notes += [f"{name!r} {faults[name]}" for name in faults if page.blanks or read_name(name, ()).role]
    # names and reasons come from files: a control character must not start a new line or hide text
    text = "\n".join(UNPRINTABLE.sub("?", line) for line in page.lines) + "\n"
    return ConfigDraft(text, tuple(notes), tuple(page.questions), tuple(page.blanks), bool(mapping.command))


@dataclass(frozen=True)
class _Page:
    """Lines written so far, with their open questions."""

    lines: list[str]
    questions: list[str]
    blanks: list[str]

    def line(self, text: str, where: str = "", question: str = "") -> None:
        """Write a line with its question as a comment, and add the question to the list."""
        self.lines.append(f"{text}  # ? {question}" if question else text)
        if question:
            self.questions.append(f"{where}: {question}")

    def ask(self, where: str, question: str) -> None:
        """Write a question on all lines of a section."""
        self.lines.append(f"  # ? {question}")
        self.questions.append(f"{where}: {question}")

    def request_entry(self, where: str, description: str, indent: str = "  ") -> None:
        """Ask the user to fill in the lines below, which are comments until then."""
        self.lines.append(f"{indent}# ? fill in, and delete the # before the lines: {description}")
        self.blanks.append(f"{where}: {description}")


def _write_model(page: _Page, robot: str, joints: Sequence[MovableJoint], mapping: ColumnMapping, folder: Path) -> None:
    if Path(robot).suffix.lower() not in SUFFIXES:
        place, _, name = robot.rpartition(":")
        page.line(f"model: {yaml_name(robot if place == 'gallery' else f'{relative(Path(place), folder)}:{name}')}")
        return
    page.line("model:")
    page.line(f"  file: {yaml_name(relative(Path(robot), folder))}")
    page.line(f"  joints: [{', '.join(map(yaml_name, mapping.position))}]")
    coupled = [joint for joint in joints if joint.name not in mapping.position and joint.name not in mapping.lock]
    if coupled:
        page.lines[-1] += f"  # {join_names(map(repr, [joint.name for joint in coupled]))}: coupled to a fixed joint"
    if mapping.lock:
        page.line("  lock:  # joints that are not identified, and their positions")
    for name, (value, question) in mapping.lock.items():
        why = "  # does not move in the logs" if name in mapping.still_joints else ""
        page.line(f"    {yaml_name(name)}: {value:.12g}{why}", f"model.lock.{name}", question)
    if mapping.command:
        return
    if mapping.gravity is not None:
        question = (
            "it fits the torques, that of the robot file does not. Is the robot on a wall or ceiling, or is a sign or "
            "zero of a joint wrong?"
        )
        page.line(f"  gravity: [{', '.join(f'{g:.4g}' for g in mapping.gravity)}]", "model.gravity", question)
    page.line("  terms: auto  # friction, rotor inertia and other terms of each joint, chosen on the training logs")
    page.line(
        "  # to fix them: a list such as [rotor, viscous, coulomb, offset], or what `dynident identify CONFIG "
        "--write-config FILE` writes"
    )


def _write_usual_limits(page: _Page, joints: Sequence[MovableJoint], mapping: ColumnMapping) -> None:
    """Offer the usual limits of a well-known arm, as comments, for the motions that `excite` designs."""
    limits = {joint.name: joint.limits for joint in joints}
    if arm := find_arm({name: limits[name] for name in mapping.position if name in limits}):
        page.lines.extend(["", f"# for `dynident excite`, usual limits of a {arm.name}, from {arm.source};"])
        page.lines.extend(["# delete the # before the lines to use them", "# excitation:", "#   limits:"])
        for name, values in arm.limits.items():
            page.line(f"#     {yaml_name(name)}: {{ {', '.join(f'{kind}: {x:g}' for kind, x in values.items())} }}")


def _write_time(page: _Page, mapping: ColumnMapping) -> None:
    page.line("")
    time = mapping.time
    if time.column is None and time.step > 0:
        rate = f"{1 / time.step:.4g}"
        page.line(f"time: {{ rate: {rate} }}", "time", time.question or _RATE_QUESTION.format(rate))
        return
    if time.column is None:
        page.request_entry(
            "time", "the sampling rate in Hz, or the column of the stamps and its unit; none was found", ""
        )
        page.line("# time: { rate: }")
        return
    text = f"time: {{ column: {yaml_name(time.column)}, unit: {time.unit} }}"
    rate = f"  # about {1 / time.step:.4g} Hz" if time.step > 0 and not time.question else ""
    page.line(text + rate, "time", time.question)


def _write_channels(page: _Page, section: str, signals: Mapping[str, ChannelProposal], mapping: ColumnMapping) -> None:
    reason = mapping.reasons.get(section, "")
    page.line("")
    page.line(f"{section}:  # {reason}" if reason else f"{section}:")
    # what is to be asked of all joints is asked once
    common = set.intersection(*(set(signal.questions) for signal in signals.values())) if len(signals) > 1 else set()
    if common:
        page.ask(section, "; ".join(text for text in next(iter(signals.values())).questions if text in common))
    _request_missing(page, section, signals)
    for name, channel in signals.items():
        complete = channel.column is not None and not channel.needs_gain
        question = "; ".join(text for text in channel.questions if text not in common)
        page.line(_channel_line(name, channel), f"{section}.{name}", question if complete else "")


def _request_missing(page: _Page, section: str, signals: Mapping[str, ChannelProposal]) -> None:
    """Ask for the gains and columns of a section that are missing."""
    gains = sorted({signal.gain for signal in signals.values() if signal.needs_gain})
    if gains:
        page.request_entry(section, f"the gains: {' or '.join(gains)}")
    missing = [name for name, signal in signals.items() if signal.column is None]
    if missing:
        page.request_entry(section, f"the columns of {join_names(map(repr, missing))}, which were not found")


def _channel_line(name: str, signal: ChannelProposal) -> str:
    """Return the line of a channel; it is a comment where something is to be filled in."""
    if signal.column is None:
        return f"  # {yaml_name(name)}: {{ column: , unit: {signal.unit} }}"
    gain = f" gain: {signal.factor:.4g}," if signal.factor else " gain: ," if signal.gain else ""
    gain += f" wraps: {signal.wraps!r}," if signal.wraps else ""
    start = "  # " if signal.needs_gain else "  "
    return f"{start}{yaml_name(name)}: {{ column: {yaml_name(signal.column)},{gain} unit: {signal.unit} }}"


def _write_unused(page: _Page, mapping: ColumnMapping, table: DataTable) -> None:
    """List the unused columns, those that differ in a number as one, and the scalars that may be gains."""
    rows = {len(table.columns[channel.column]) for channel in mapping.position.values() if channel.column}
    others = dict.fromkeys(
        re.sub(r"\d+", "#", name) for name, x in table.columns.items() if rows and len(x) not in rows
    )
    if others:
        page.line(f"# of another length, so in a file of its own to use it: {join_names(map(repr, list(others)))}")
    if mapping.unknown_joints:
        page.line(
            f"# of no joint of the robot file, or one that follows: {join_names(map(repr, mapping.unknown_joints))}"
        )
    kinds = dict.fromkeys(re.sub(r"\d+", "#", name) for name in mapping.unused)
    if kinds:
        page.line(f"# not used: {join_names(map(repr, list(kinds)))}")
    if any(map(is_commanded, mapping.unused)):
        page.line("# reference positions, with the gains of the drives, let more estimators apply: see `simulation` in")
        page.line("# docs/configuration.md, and `dynident compare`")
    if table.constants and page.blanks:
        page.line(f"# numbers that a gain may name: {join_names(map(repr, list(table.constants)))}")


def _write_logs(page: _Page, mapping: ColumnMapping, sources: Sequence[LogSource], folder: Path) -> None:
    page.line("")
    if len(sources) > 1:
        # the last log is the validation, as another motion is the better test
        *train, last = sources
        page.line("train:")
        page.lines.extend(line for source in train for line in _log_lines(source, folder))
        page.line("validation:  # held out, to judge the fit; best on another motion")
        page.lines.extend(_log_lines(last, folder))
        return
    cut = _cut_time(mapping, sources[0].table)
    for role, head, window in (
        ("train", f"the first {100 * _TRAINING_SHARE:.0f} % of the only log", f"[null, {cut}]"),
        ("validation", "its rest; another motion is a better test", f"[{cut}, null]"),
    ):
        page.line(f"{role}:  # {head}")
        page.lines.extend(_log_lines(sources[0], folder))
        if cut:
            page.line(f"    window: {window}  # s")
        else:
            page.request_entry(f"{role}[0].window", "start and stop in s, because the times are not known", "    ")
            page.line("    # window: [ , ]")


def _log_lines(source: LogSource, folder: Path) -> Iterator[str]:
    if list(source.files) == [""]:
        yield f"  - file: {yaml_name(relative(source.files[''], folder))}"
    else:
        yield "  - file:"
        yield from (
            f"      {yaml_name(key)}: {yaml_name(relative(path, folder))}" for key, path in source.files.items()
        )
    if source.widths:
        widths = ", ".join(f"{yaml_name(key)}: {width}" for key, width in source.widths.items())
        yield f"    width: {{ {widths} }}  # one number per line; this many form a row"


def _cut_time(mapping: ColumnMapping, table: DataTable) -> str:
    """Return the time (s) at which the motion of a single log is cut, rounded; empty where the times are not known."""
    rows = _times_and_positions(mapping, table)
    if len(rows) < 2 or not rows[-1, 0] > rows[0, 0]:
        return ""
    t, q = rows[:, 0], rows[:, 1:]
    start, stop = float(t[0]), float(t[-1])
    # the span of the motion is known only with increasing stamps
    if q.size and (np.diff(t) > 0).all():
        start, stop = moving_span(Log(t, q, np.zeros(q.shape), tuple(map(str, range(q.shape[1])))))
    # digits for a resolution of 1 % of the motion or better
    digits = max(0, 2 - math.floor(math.log10(stop - start)))
    return f"{start + _TRAINING_SHARE * (stop - start):.{digits}f}"


def _times_and_positions(mapping: ColumnMapping, table: DataTable) -> Array:
    """Return the stamps (s) and the matched positions, (N, 1 + n), without impossible values; empty without stamps."""
    columns = [table.columns[channel.column] for channel in mapping.position.values() if channel.column]
    if mapping.time.column is not None:
        columns = [table.columns[mapping.time.column], *columns]
    elif mapping.time.step > 0:
        columns = [np.arange(len(columns[0]), dtype=float) * mapping.time.step, *columns]
    else:
        return np.empty((0, 1))
    if len({len(column) for column in columns}) != 1:
        return np.empty((0, 1))
    rows = np.column_stack(columns)
    # a single impossible value would dominate the range
    rows = rows[(np.abs(rows) < _MAX_MEASURED_VALUE).all(axis=1)]
    rows[:, 0] *= unit_factor(mapping.time.unit, "time", "")
    return rows
