"""A configuration drafted from a robot file and logs: commented YAML, with a reason for each proposal."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from yaml.reader import Reader

from dynident.errors import InputError, choices
from dynident.identification import moving_span
from dynident.io.column_mapping import ColumnMapping, Signal
from dynident.io.columns import is_commanded
from dynident.io.fields import UNITS
from dynident.io.match import JointFacts
from dynident.io.robot import SUFFIXES
from dynident.io.sources import Source
from dynident.io.tables import DataTable
from dynident.log import Log

__all__ = ["BREAKING", "ConfigDraft", "draft_config", "relative", "same_columns"]

Array = NDArray[np.float64]
# names that YAML takes as they are, but for words such as yes
_PLAIN = re.compile(r"(?!\.+$)[A-Za-z_./][A-Za-z0-9_./-]*")
# what no line may hold: names in quotes are escaped by then, so that this is left in comments only
BREAKING = re.compile(f"{Reader.NON_PRINTABLE.pattern}|[\n\r\x85\u2028\u2029]")
_TRAIN = 0.7  # of a single log
_LARGEST = 1e100  # of values that can have been measured
_ASSUMED = (
    "the gains are those with which gravity and inertia of the robot file explain the motion: are its masses right? "
    "Errors in % do not depend on a factor that all gains share, but masses, inertias and friction do; data sheets or "
    "a known payload tell it"
)
_STILL = "; outside, the arm is at rest, where friction is not determined"


@dataclass(frozen=True)
class ConfigDraft:
    """The text of a configuration; ``notes`` on what it leaves out, ``questions`` to confirm, ``blanks`` to fill in."""

    text: str
    notes: tuple[str, ...]
    questions: tuple[str, ...]
    blanks: tuple[str, ...]


def same_columns(mapping: ColumnMapping, sources: Sequence[Source]) -> None:
    """Raise InputError where a later recording lacks a column that was chosen in the first."""
    chosen = [mapping.time.column, *(one.column for one in (*mapping.position.values(), *mapping.torque.values()))]
    for source in sources[1:]:
        for name in filter(None, chosen):
            if name not in source.table.columns:
                raise InputError(
                    f"{source.table.source}: has no column {name!r}, unlike {sources[0].table.source}; "
                    f"{choices(name, source.table.columns)} All logs of a configuration have the same columns. "
                    "Files that make one log together are joined by a plus: q.csv+tau.csv."
                )


def draft_config(
    robot: str, joints: Sequence[JointFacts], mapping: ColumnMapping, sources: Sequence[Source], folder: Path
) -> ConfigDraft:
    """Write the configuration: ``robot`` as the user named it, files relative to ``folder``.

    The first log is fitted, the last held out; a single one is cut in two windows.
    """
    page = _Page([], [], [])
    page.line(
        "# For `dynident identify`. Every proposal has its reason beside it; confirm or correct those marked `# ?`."
    )
    _model(page, robot, joints, mapping, folder)
    for guess in dict.fromkeys(guess for source in sources for guess in source.table.guesses):
        page.ask("file", f"{guess} Is this right?")
    _time(page, mapping)
    for section, signals in (("position", mapping.position), ("torque", mapping.torque)):
        _channels(page, section, signals, mapping)
    _unused(page, mapping, sources[0].table)
    _logs(page, mapping, sources, folder)
    if mapping.gaps:
        page.line("gaps: split  # the stamps have gaps; each piece is smoothed separately")
    page.line("")
    page.line("estimator: { kind: consistent }  # physically consistent bodies, no negative friction; or least_squares")
    strange = f"recorded, but not in the robot file, so left out: {_listed(mapping.strangers)}."
    table = sources[0].table
    faults = [f"{name!r} {fault}" for name, fault in table.faults.items() if page.blanks and name not in table.texts]
    still = (
        "no motion in the logs, or next to none, so locked where they stand (`model.lock`): "
        f"{_listed(mapping.still)}; what they carry is part of the body before them, and they have no "
        "friction of their own."
    )
    notes = (*((still,) if mapping.still else ()), *((strange,) if mapping.strangers else ()), *faults)
    text = "\n".join(BREAKING.sub("?", line) for line in page.lines) + "\n"
    return ConfigDraft(text, notes, tuple(page.questions), tuple(page.blanks))


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

    def want(self, where: str, wanted: str, indent: str = "  ") -> None:
        """Write what the user must fill in below, in lines that are comments until then."""
        self.lines.append(f"{indent}# ? fill in, and delete the # before the lines: {wanted}")
        self.blanks.append(f"{where}: {wanted}")


def _model(page: _Page, robot: str, joints: Sequence[JointFacts], mapping: ColumnMapping, folder: Path) -> None:
    if Path(robot).suffix.lower() not in SUFFIXES:
        place, _, name = robot.rpartition(":")
        page.line(f"model: {_scalar(robot if place == 'gallery' else f'{relative(Path(place), folder)}:{name}')}")
        return
    page.line("model:")
    page.line(f"  file: {_scalar(relative(Path(robot), folder))}")
    page.line(f"  joints: [{', '.join(map(_scalar, mapping.position))}]")
    left = [joint for joint in joints if joint.name not in mapping.position and joint.name not in mapping.lock]
    if left:
        page.lines[-1] += f"  # {_listed([joint.name for joint in left])}: coupled to a fixed joint"
    if mapping.lock:
        page.line("  lock:  # joints that are not identified, and their positions")
    for name, (value, question) in mapping.lock.items():
        why = "  # does not move in the logs" if name in mapping.still else ""
        page.line(f"    {_scalar(name)}: {value:.12g}{why}", f"model.lock.{name}", question)
    page.line("  terms: auto  # friction, rotor inertia and other terms of each joint, chosen on the training logs")
    page.line(
        "  # to fix them: a list such as [rotor, viscous, coulomb, offset], or what `dynident identify CONFIG "
        "--write-config FILE` writes"
    )


def _time(page: _Page, mapping: ColumnMapping) -> None:
    page.line("")
    time = mapping.time
    if time.column is None:
        page.want("time", "the sampling rate in Hz, or the column of the stamps and its unit; none was found", "")
        page.line("# time: { rate: }")
        return
    text = f"time: {{ column: {_scalar(time.column)}, unit: {time.unit} }}"
    rate = f"  # about {1 / time.step:.4g} Hz" if time.step > 0 and not time.question else ""
    page.line(text + rate, "time", time.question)


def _channels(page: _Page, section: str, signals: Mapping[str, Signal], mapping: ColumnMapping) -> None:
    reason = mapping.reasons.get(section, "")
    page.line("")
    page.line(f"{section}:  # {reason}" if reason else f"{section}:")
    asked = {signal.question for signal in signals.values()}
    common = asked.pop() if len(asked) == 1 and len(signals) > 1 else ""  # asked once, not joint by joint
    if common:
        page.ask(section, common)
    if any(signal.factor for signal in signals.values()):
        page.ask(section, _ASSUMED)
    _wanted(page, section, signals)
    for name, one in signals.items():
        complete = one.column is not None and not _blank(one)
        asked_of = _factor_question(one) if one.factor else "" if common else one.question
        page.line(_channel(name, one), f"{section}.{name}", asked_of if complete else "")


def _blank(signal: Signal) -> bool:
    """Whether a gain is to be filled in."""
    return bool(signal.gain) and signal.factor is None


def _factor_question(signal: Signal) -> str:
    value, std = signal.factor or (math.nan, math.nan)
    return f"{value:.4g} +- {std:.2g} from the robot file: {signal.gain}?"


def _wanted(page: _Page, section: str, signals: Mapping[str, Signal]) -> None:
    """Say what is to be filled in of a section's channels."""
    gains = sorted({signal.gain for signal in signals.values() if _blank(signal)})
    if gains:
        page.want(section, f"the gains: {' or '.join(gains)}")
    missing = [name for name, signal in signals.items() if signal.column is None]
    if missing:
        page.want(section, f"the columns of {_listed(missing)}, which were not found")


def _channel(name: str, signal: Signal) -> str:
    """Return the line of a channel, a comment where something in it is to be filled in."""
    if signal.column is None:
        return f"  # {_scalar(name)}: {{ column: , unit: {signal.unit} }}"
    gain = f" gain: {signal.factor[0]:.4g}," if signal.factor else " gain: ," if signal.gain else ""
    gain += f" wraps: {signal.wraps!r}," if signal.wraps else ""
    start = "  # " if _blank(signal) else "  "
    return f"{start}{_scalar(name)}: {{ column: {_scalar(signal.column)},{gain} unit: {signal.unit} }}"


def _unused(page: _Page, mapping: ColumnMapping, table: DataTable) -> None:
    """List the other columns, those that differ in a number as one, and the numbers that a gain may name."""
    if mapping.strangers:
        page.line(f"# of joints that the robot file does not have: {_listed(mapping.strangers)}")
    kinds = dict.fromkeys(re.sub(r"\d+", "#", name) for name in mapping.left)
    if kinds:
        page.line(f"# not used: {_listed(list(kinds))}")
    if any(map(is_commanded, mapping.left)):
        page.line("# reference positions, with the gains of the drives, let more estimators apply: see `simulation` in")
        page.line("# docs/configuration.md, and `dynident compare`")
    if table.constants and page.blanks:
        page.line(f"# numbers that a gain may name: {_listed(list(table.constants))}")


def _logs(page: _Page, mapping: ColumnMapping, sources: Sequence[Source], folder: Path) -> None:
    page.line("")
    if len(sources) > 1:
        *train, last = sources
        page.line("train:")
        page.lines.extend(line for source in train for line in (*_log(source, folder), *_moving(mapping, source.table)))
        page.line("validation:  # held out, to judge the fit; best on another motion")
        page.lines.extend((*_log(last, folder), *_moving(mapping, last.table)))
        return
    start, stop, cut = _span(mapping, sources[0].table)
    page.line(f"train:  # the first {100 * _TRAIN:.0f} % of the only log")
    for role, window in (("train", f"[{start}, {cut}]"), ("validation", f"[{cut}, {stop}]")):
        if role == "validation":
            page.line("validation:  # its rest; another motion is a better test")
        page.lines.extend(_log(sources[0], folder))
        if cut != "null":
            page.line(f"    window: {window}  # s{_STILL if window.count('null') == 0 else ''}")
        else:
            page.want(f"{role}[0].window", "start and stop in s, because the times are not known", "    ")
            page.line("    # window: [ , ]")


def _moving(mapping: ColumnMapping, table: DataTable) -> Iterator[str]:
    """Yield the window in which the arm moves, where it rests for long before or after."""
    start, stop, _ = _span(mapping, table)
    if (start, stop) != ("null", "null"):
        yield f"    window: [{start}, {stop}]  # s{_STILL}"


def _log(source: Source, folder: Path) -> Iterator[str]:
    if list(source.files) == [""]:
        yield f"  - file: {_scalar(relative(source.files[''], folder))}"
    else:
        yield "  - file:"
        yield from (f"      {_scalar(key)}: {_scalar(relative(path, folder))}" for key, path in source.files.items())
    if source.widths:
        widths = ", ".join(f"{_scalar(key)}: {width}" for key, width in source.widths.items())
        yield f"    width: {{ {widths} }}  # one number per line; this many form a row"


def _span(mapping: ColumnMapping, table: DataTable) -> tuple[str, str, str]:
    """Return start and end of the motion, and the time at which a single log is divided, in s, rounded.

    The first two are "null" where the arm moves from the start, or to the end; all are where the times are not known.
    """
    rows = _times_and_positions(mapping, table)
    if len(rows) < 2 or not rows[-1, 0] > rows[0, 0]:
        return "null", "null", "null"
    t, q = rows[:, 0], rows[:, 1:]
    start, stop = float(t[0]), float(t[-1])
    if q.size and (np.diff(t) > 0).all():
        start, stop = moving_span(Log(t, q, np.zeros(q.shape), tuple(map(str, range(q.shape[1])))))
    digits = max(0, 2 - math.floor(math.log10(stop - start)))
    first, last = (f"{x:.{digits}f}" if x != end else "null" for x, end in ((start, t[0]), (stop, t[-1])))
    return (first, last, f"{start + _TRAIN * (stop - start):.{digits}f}")


def _times_and_positions(mapping: ColumnMapping, table: DataTable) -> Array:
    """Return the stamps (s) and the positions found (N, 1 + n) that can have been measured; none without stamps."""
    names = [mapping.time.column, *(one.column for one in mapping.position.values() if one.column)]
    columns = [table.columns[name] for name in names if name is not None]
    if mapping.time.column is None or len({len(column) for column in columns}) != 1:
        return np.empty((0, 1))
    rows = np.column_stack(columns)
    rows = rows[(np.abs(rows) < _LARGEST).all(axis=1)]
    rows[:, 0] *= UNITS["time"][mapping.time.unit]
    return rows


def relative(path: Path, folder: Path) -> str:
    """Return the path relative to a folder, with forward slashes; unchanged on another drive."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return path.resolve().as_posix()


def _scalar(name: str) -> str:
    """Return a name as YAML, quoted where YAML would read it as another type."""
    if _PLAIN.fullmatch(name) and isinstance(yaml.safe_load(name), str):
        return name
    return yaml.safe_dump(name, default_style='"', allow_unicode=True, width=math.inf).strip()


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(map(repr, names[:12]))
    return shown + (f" and {len(names) - 12} more" if len(names) > 12 else "")
