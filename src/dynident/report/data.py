"""The robot and the recordings in a report: joints and their limits, logs, excitation, smoothing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident.checks import Excitation
from dynident.checks.motion import excitation
from dynident.report import figures
from dynident.report.calibration_words import settings_of
from dynident.report.page import Column, Figure, Fold, Gallery, PageBlock, PageSection, PageTable, number, pairs
from dynident.report.typography import said
from dynident.report.words import ROLES, count, labelled, listed, logs_of, percent, points, short
from dynident.validation import HARMFUL, FollowTest, follow_tests

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.log import Motion
    from dynident.validation import LogValidation

__all__ = ["data_section", "excitation_table", "smoothing_section"]

MANY = 24  # rows from which on a table is folded
_EXCITATION = (
    "What the training motions do: the range they use (in % of what the robot file allows), and velocity and "
    "acceleration, whose peaks are those of 99.9 % of the samples. Slow: the share of samples below 2 % of the peak "
    "velocity. Held out over training: a peak well above 1 asks the model for more than it was fitted to."
)
_SMOOTHING = (
    "How the positions were smoothed, and the motion that the fit has seen. What the smoothing took away should look "
    "like noise: a pattern that follows the motion means too much smoothing, accelerations full of spikes too little. "
    "Cut-off: the frequency of which 71 % of the amplitude pass."
)
_FOLLOWED = (
    "Follows: the share of the power taken away that smoothing once more would take of the motion, beyond what noise "
    "leaves there. Flagged where it is above 5 % with 99 % confidence. Lost: the acceleration that went with it, in % "
    "of the rms acceleration; it matters from about 2 % on. Noise that is slow, such as encoder steps, counts "
    "as motion."
)
_HEADS = {
    "sigma": "sigma, rad or m",
    "noise": "noise left, rad or m",
    "intensity": "intensity, SI",
    "bandwidth": "bandwidth, s",
    "cutoff": "cut-off, Hz",
    "window": "window, s",
    "whiteness": "p-value of white noise",
}


def data_section(identification: Identification) -> PageSection:
    """Return the section of the robot and the logs: what was found before the fit, joints, recordings."""
    blocks: list[PageBlock] = [pairs("", [(name, said(text)) for name, text in _facts(identification)], "Robot")]
    return PageSection("Robot and data", (*blocks, _joint_table(identification), _log_table(identification)))


def _facts(identification: Identification) -> Iterator[tuple[str, str]]:
    settings, model = settings_of(identification), identification.model
    if file := identification.provenance.model:
        yield "file", file.path.replace("\\", "/").rpartition("/")[2]
    kinds = [joint.kind for joint in model.joints]
    yield "joints", ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    yield "parameters", str(len(identification.estimate.names))
    for term in model.terms:
        if gravity := getattr(term, "gravity", None):
            yield "gravity in the base frame", f"({', '.join(short(float(x), 4) for x in gravity)}) m/s²"
    for key, meaning in (("base tilt", "tilt of the base"), ("time offset", "time offset")):
        if key in settings:
            yield meaning, settings[key]
    for key, meaning in (
        ("estimator", "estimator"),
        ("low-pass", "low-pass of the fit"),
        ("smoother used", "smoother"),
    ):
        if key in settings:
            yield meaning, settings[key]


def _joint_table(identification: Identification) -> PageTable:
    limits = identification.model.limits
    heads = [Column("joint", numeric=False), Column("kind", numeric=False)]
    if limits:
        heads += [Column(title, "limits of the file") for title in ("from", "to", "velocity", "torque")]
    rows = []
    for joint in identification.model.joints:
        limit, unit = limits.get(joint.name), joint.unit
        cells = [joint.name, joint.kind]
        if limits:
            named = ("lower", unit), ("upper", unit), ("velocity", f"{unit}/s"), ("effort", joint.effort)
            cells += [_with_unit(getattr(limit, key, None), unit) for key, unit in named]
        rows.append(tuple(cells))
    return PageTable(tuple(heads), tuple(rows), "Joints")


def _with_unit(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{number(value)} {unit}"


def _log_table(identification: Identification) -> PageTable:
    heads = ["rate, Hz", "jitter, %", "length, s", "samples", "used", "used, %", "start left out, s", "end left out, s"]
    excluded = {one.name: _excluded(one) for one in identification.validations}
    if any(excluded.values()):
        heads.append("excluded, s")
    days = [figures.clock(float(log.motion.t[0])) for log in identification.validations]
    columns = (Column("log", numeric=False), Column("role", numeric=False), *map(Column, heads))
    columns += (Column("recorded", numeric=False),) * any(days)
    rows = []
    for log, recorded in zip(identification.validations, days, strict=True):
        t, mask = log.motion.t, log.motion.mask
        steps, used = np.diff(t), t[mask]
        cells = [
            number(1.0 / float(np.median(steps))),
            number(100.0 * float(np.std(steps) / np.mean(steps)) if np.ptp(steps) > 1e-6 * steps.mean() else 0.0, 2),
            number(float(t[-1] - t[0])),
            str(len(t)),
            str(len(used)),
            number(100.0 * float(mask.mean()), 3),
            number(float(used[0] - t[0]), 2),
            number(float(t[-1] - used[-1]), 2),
            *([number(excluded[log.name], 3)] * any(excluded.values())),
        ]
        cells += [recorded or "-"] * any(days)
        rows.append((log.name, ROLES.get(log.role, log.role), *cells))
    return PageTable(columns, tuple(rows), "Recordings")


def _excluded(log: LogValidation) -> float:
    """Return how long (s) a log is that is neither fitted nor judged because the configuration excludes it."""
    gone = None if log.recorded is None else log.recorded.excluded
    return 0.0 if gone is None else float(gone.mean() * (log.motion.t[-1] - log.motion.t[0]))


def excitation_table(identification: Identification) -> tuple[PageBlock, ...]:
    """Return how the joints move in training, how far they go beyond it when held out, and the words for it."""
    train, held = ([log.motion for log in logs_of(identification, role)] for role in ("train", "validation"))
    limits = identification.model.limits
    groups = [
        *[("from", "position"), ("to", "position")],
        *[("range, %", "position")] * bool(limits),
        *[("peak", "velocity"), ("rms", "velocity"), ("peak", "acceleration"), ("rms", "acceleration")],
        *[("turns", ""), ("slow, %", ""), ("peak", "torque")],
        *[("limit, %", "torque")] * bool(limits),
        *[("peak vel.", "held out / training"), ("acc.", "held out / training")] * bool(held),
    ]
    rows = []
    for joint in identification.model.joints:
        moved = excitation(train, joint.name)
        cells = _excited(moved, limits.get(joint.name), bool(limits))
        if held:
            other = excitation(held, joint.name)
            cells += [_ratio(getattr(other, key), getattr(moved, key)) for key in ("peak_speed", "peak_acceleration")]
        rows.append((joint.name, *cells))
    columns = (Column("joint", numeric=False), *(Column(*group) for group in groups))
    lengths, efforts = (
        {getattr(joint, key): None for joint in identification.model.joints} for key in ("unit", "effort")
    )
    caption = f"Motion in training; {' or '.join(lengths)}, s, {' or '.join(efforts)}"
    return _EXCITATION, PageTable(columns, tuple(rows), caption)


def _excited(moved: Excitation, limit: Any, limited: bool) -> list[str]:
    cells = [number(moved.lower, 3), number(moved.upper, 3)]
    if limited:
        whole = None
        if limit is not None and limit.lower is not None and limit.upper is not None and limit.lower < limit.upper:
            whole = 100.0 * (moved.upper - moved.lower) / (limit.upper - limit.lower)
        cells.append(number(whole, 2))
    sizes = (moved.peak_speed, moved.rms_speed, moved.peak_acceleration, moved.rms_acceleration)
    cells += [number(size, 3) for size in sizes]
    cells += [str(moved.reversals), number(100 * moved.slow, 2), number(moved.torque, 3)]
    if limited:
        cells.append(number(100.0 * moved.torque / limit.effort if limit is not None and limit.effort else None, 2))
    return cells


def _ratio(one: float, other: float) -> str:
    return number(one / other if other > 0 else None, 2)


def smoothing_section(identification: Identification) -> PageSection:
    """Return the section of the smoothing: a table, and the motion of one log and joint at a time."""
    fine, views = points(identification), []
    for label, k in labelled(identification):
        log = identification.validations[k]
        for joint in identification.model.joints:
            figure = figures.motion_figure(
                log.motion, joint.name, joint.unit, fine, log.recorded, log.motion.time_offset
            )
            caption = f"{joint.name}: position and its derivatives, samples that were used."
            views.append(((label, joint.name), (Figure(figure.of(label), caption),)))
    gallery = Gallery(("log", "joint"), tuple(views))
    return PageSection("Smoothing", (_SMOOTHING, *_followed(identification), *_smoothing(identification), gallery))


def _followed(identification: Identification) -> Iterator[PageBlock]:
    """Yield what of the positions taken away follows the motion: a sentence that flags it, and the table."""
    tests = [
        (log.name, joint, one)
        for log in identification.validations
        if log.recorded is not None
        for joint, one in follow_tests(log.motion, log.recorded).items()
    ]
    if not tests:
        return
    yield _flag(tests, len(identification.model.joints))
    rows = [
        (name, joint, number(one.share, 2), number(one.lost, 2), "follows the motion" if one.follows else "-")
        for name, joint, one in tests
    ]
    columns = (Column("log", numeric=False), Column("joint", numeric=False), Column("follows, %"))
    table = PageTable((*columns, Column("lost, %"), Column("flag", numeric=False)), tuple(rows), "Taken away")
    yield Fold("What of the positions taken away follows the motion, joint by joint", (_FOLLOWED, table))


def _flag(tests: Sequence[tuple[str, str, FollowTest]], joints: int) -> str:
    """Return one sentence on what was taken away of all logs and joints."""
    flagged = [one for one in tests if one[2].follows]
    if not flagged:
        return "At no joint does what was taken away follow the motion."
    names = list(dict.fromkeys(joint for _, joint, _ in flagged))
    where = f"all {joints} joints" if 1 < len(names) == joints else listed(names)
    log, joint, worst = max(flagged, key=lambda one: one[2].share)
    lost = max(one.lost for _, _, one in flagged)
    matters = "enough to matter" if lost > HARMFUL else "too little to matter"
    return (
        f"Flagged: what was taken away follows the motion at {where}, up to {percent(worst.share, 2)} of it ({joint}, "
        f"{log}). At most {percent(lost, 2)} of an acceleration went with it, {matters}."
    )


def _smoothing(identification: Identification) -> Iterator[PageBlock]:
    """Yield one table of what the smoothers say in one number per joint, and their words below it."""
    motions = [(log.name, log.motion) for log in identification.validations]
    yield from _smoothing_table(motions)
    said = {
        name: ", ".join(f"{key} {value}" for key, value in motion.smoothing.items() if isinstance(value, str))
        for name, motion in motions
    }
    if len(set(said.values())) == 1:
        yield from filter(None, (f"{words[:1].upper()}{words[1:]}." for words in set(said.values()) if words))
    else:
        yield tuple(f"{name}: {words}" for name, words in said.items())


def _smoothing_table(motions: Sequence[tuple[str, Motion]]) -> Iterator[PageBlock]:
    keys = list(dict.fromkeys(key for _, motion in motions for key in motion.smoothing if _per_joint(motion, key)))
    rows = [
        (name, joint, *(_smoothing_cell(motion, key, j) for key in keys))
        for name, motion in motions
        for j, joint in enumerate(motion.joints)
    ]
    if keys:
        words = (Column("log", numeric=False), Column("joint", numeric=False))
        columns = (*words, *(Column(_HEADS.get(key, key)) for key in keys))
        table = PageTable(columns, tuple(rows), "Smoothing per log and joint")
        title = f"Smoothing of {count(len(motions), 'log')}, joint by joint"
        yield table if len(rows) < MANY else Fold(title, (table,))


def _per_joint(motion: Motion, key: str) -> bool:
    value = motion.smoothing.get(key)
    return value is not None and not isinstance(value, str) and np.shape(value) == (len(motion.joints),)


def _smoothing_cell(motion: Motion, key: str, j: int) -> str:
    return number(float(motion.smoothing[key][j])) if _per_joint(motion, key) else "-"
