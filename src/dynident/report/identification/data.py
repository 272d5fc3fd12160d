"""What a report says of its data: joints and their limits, logs, excitation, smoothing, and the files to repeat it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from dynident.checks import Excitation
from dynident.checks.motion import excitation
from dynident.identification import Identification
from dynident.models import Joint
from dynident.motion.log import Motion
from dynident.report.check import excitation_cells
from dynident.report.figures import clock
from dynident.report.identification.figures import motion_figure, pieces_figure
from dynident.report.page import (
    UNIT,
    Code,
    Column,
    Figure,
    Fold,
    Head,
    PageBlock,
    PageSection,
    PageTable,
    pair_table,
    typeset,
)
from dynident.report.words import ROLES, day, figure_gallery, points, settings_of
from dynident.runtime import count, join_names, number, percent, short
from dynident.validation import MAX_LOST_ACCELERATION, FollowTest, LogValidation, follow_tests

MIN_FOLDED_ROWS = 24  # rows from which on a table is folded
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
_FOLLOW_NOTE = (
    "Follows: the share of the power taken away that smoothing once more would take of the motion, beyond what noise "
    "leaves there. Flagged where it is above 5 % with 99 % confidence. Lost: the acceleration that went with it, in % "
    "of the rms acceleration; it matters from about 2 % on. Noise that is slow, such as encoder steps, counts "
    "as motion."
)
_SETTINGS = {
    "base tilt": "tilt of the base", "time offset": "time offset", "estimator": "estimator",
    "low-pass": "low-pass of the fit", "smoother used": "smoother",
}  # fmt: skip
_HEADS = {
    "sigma": "sigma, rad or m",
    "noise": "noise left, rad or m",
    "intensity": "intensity, SI",
    "bandwidth": "bandwidth, s",
    "cutoff": "cut-off, Hz",
    "window": "window, s",
    "whiteness": "p-value of white noise",
}

_PIECES = (
    "The recordings are longer than the memory: their pieces were smoothed and fitted one after the other, and the "
    "parameters are those of all samples. Smoother, time offset, terms and whatever else was chosen come from "
    "excerpts; so do errors and figures of the training elsewhere on this page. Here is what is left of the torque in "
    "each piece: a residual that rises or falls shows friction, load or a sensor that changes, which one set of "
    "parameters cannot follow. Standard errors allow for any correlation within a piece."
)


_LEAD = (
    "The same files, configuration and versions give the same result but for its date: apart from the seed below, "
    "nothing is drawn."
)


def data_section(identification: Identification) -> PageSection:
    """Return the section of the robot and the logs: settings found before the fit, joints, recordings."""
    facts = pair_table("", [(name, typeset(text)) for name, text in _robot_facts(identification)], "Robot")
    return PageSection("Robot and data", (facts, _joint_table(identification), _log_table(identification)))


def _robot_facts(identification: Identification) -> Iterator[tuple[str, str]]:
    settings, model = settings_of(identification), identification.model
    if file := identification.provenance.model:
        yield "file", file.path.replace("\\", "/").rpartition("/")[2]
    kinds = [joint.kind for joint in model.joints]
    yield "joints", ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    yield "parameters", str(len(identification.estimate.names))
    for term in model.terms:
        if gravity := getattr(term, "gravity", None):
            yield "gravity in the base frame", f"({', '.join(short(float(x), 4) for x in gravity)}) m/s²"
    yield from ((meaning, settings[key]) for key, meaning in _SETTINGS.items() if key in settings)


def _joint_table(identification: Identification) -> PageTable:
    limits = identification.model.limits
    heads = [(title, "limits of the file") for title in ("from", "to", "velocity", "torque")] if limits else []
    rows = []
    for joint in identification.model.joints:
        limit, unit = limits.get(joint.name), joint.unit
        cells = [joint.name, joint.kind]
        if limits:
            quantities = ("lower", unit), ("upper", unit), ("velocity", f"{unit}/s"), ("effort", joint.effort)
            limited = [(getattr(limit, key, None), unit) for key, unit in quantities]
            cells += ["-" if value is None else f"{number(value)} {unit}" for value, unit in limited]
        rows.append(cells)
    return PageTable.of(("joint", "kind"), heads, rows, "Joints")


def _log_table(identification: Identification) -> PageTable:
    heads: list[Head] = ["rate, Hz", "jitter, %", "length, s", "samples"]
    heads += ["used", "used, %", "start left out, s", "end left out, s"]
    excluded = {validation.name: _excluded_time(validation) for validation in identification.validations}
    heads += ["excluded, s"] * any(excluded.values())
    days = [clock(float(log.motion.t[0])) for log in identification.validations]
    heads += [Column("recorded", numeric=False)] * any(days)
    rows = []
    for log, recorded in zip(identification.validations, days, strict=True):
        t, mask = log.motion.t, log.motion.mask
        steps, used_times = np.diff(t), t[mask]
        # Steps that differ by rounding alone have no jitter
        jitter = 100.0 * float(np.std(steps) / np.mean(steps)) if np.ptp(steps) > 1e-6 * steps.mean() else 0.0
        cells = [number(1.0 / float(np.median(steps))), number(jitter, 2), number(float(t[-1] - t[0])), str(len(t))]
        cells += [str(len(used_times)), number(100.0 * float(mask.mean()), 3)]
        cells += [number(float(left_out), 2) for left_out in (used_times[0] - t[0], t[-1] - used_times[-1])]
        cells += [number(excluded[log.name], 3)] * any(excluded.values()) + [recorded or "-"] * any(days)
        rows.append((log.name, ROLES.get(log.role, log.role), *cells))
    return PageTable.of(("log", "role"), heads, rows, "Recordings")


def _excluded_time(log: LogValidation) -> float:
    """Return the time (s) of a log that the configuration excludes from fit and judgement."""
    mask = None if log.recorded_log is None else log.recorded_log.excluded
    return 0.0 if mask is None else float(mask.mean() * (log.motion.t[-1] - log.motion.t[0]))


def excitation_table(identification: Identification) -> tuple[PageBlock, ...]:
    """Return the text and the table of how the joints move in training, and how far held-out motion exceeds it."""
    train, held_out = ([log.motion for log in identification.of_role(role)] for role in ("train", "validation"))
    limits = identification.model.limits
    groups = [
        *[("from", "position"), ("to", "position")],
        *[("range, %", "position")] * bool(limits),
        *[("peak", "velocity"), ("rms", "velocity"), ("peak", "acceleration"), ("rms", "acceleration")],
        *[("turns", ""), ("slow, %", ""), ("peak", "torque")],
        *[("limit, %", "torque")] * bool(limits),
        *[("peak vel.", "held out / training"), ("acc.", "held out / training")] * bool(held_out),
    ]
    rows = []
    for joint in identification.model.joints:
        training = excitation(train, joint.name)
        cells = _excitation_cells(training, limits.get(joint.name), bool(limits))
        if held_out:
            validation = excitation(held_out, joint.name)
            for key in ("peak_speed", "peak_acceleration"):
                peak = getattr(training, key)
                cells.append(number(getattr(validation, key) / peak if peak > 0 else None, 2))
        rows.append((joint.name, *cells))
    joints = identification.model.joints
    lengths, efforts = (dict.fromkeys(getattr(joint, key) for joint in joints) for key in ("unit", "effort"))
    caption = f"Motion in training; {' or '.join(lengths)}, s, {' or '.join(efforts)}"
    return _EXCITATION, PageTable.of(("joint",), groups, rows, caption)


def _excitation_cells(motion: Excitation, limit: Any, limited: bool) -> list[str]:
    cells, motion_cells = excitation_cells(motion)
    if limited:
        range_share = None
        if limit is not None and limit.lower is not None and limit.upper is not None and limit.lower < limit.upper:
            range_share = 100.0 * (motion.upper - motion.lower) / (limit.upper - limit.lower)
        cells.append(number(range_share, 2))
    cells += motion_cells
    if limited:
        cells.append(number(100.0 * motion.torque / limit.effort if limit is not None and limit.effort else None, 2))
    return cells


def smoothing_section(identification: Identification) -> PageSection:
    """Return the section of the smoothing: a table, and the motion of one log and joint at a time."""
    curve_points = points(identification)

    def draw_motion(log: LogValidation, joint: Joint) -> Figure:
        drawing = motion_figure(log.motion, joint.name, joint.unit, curve_points, log.recorded_log)
        return Figure(drawing, f"{joint.name}: position and its derivatives, samples that were used.")

    blocks = *_follow_blocks(identification), *_smoothing_blocks(identification)
    return PageSection("Smoothing", (_SMOOTHING, *blocks, *figure_gallery(identification, draw_motion)))


def _follow_blocks(identification: Identification) -> Iterator[PageBlock]:
    """Yield a sentence and a table on how far the positions that the smoothing took away follow the motion."""
    tests = [
        (log.name, joint, test)
        for log in identification.validations
        if log.recorded_log is not None
        for joint, test in follow_tests(log.motion, log.recorded_log).items()
    ]
    if not tests:
        return
    yield _follow_sentence(tests, len(identification.model.joints))
    rows = [
        (name, joint, number(test.share, 2), number(test.lost, 2), "follows the motion" if test.is_following else "-")
        for name, joint, test in tests
    ]
    heads = ("follows, %", "lost, %", Column("flag", numeric=False))
    table = PageTable.of(("log", "joint"), heads, rows, "Taken away")
    yield Fold("What of the positions taken away follows the motion, joint by joint", (_FOLLOW_NOTE, table))


def _follow_sentence(tests: Sequence[tuple[str, str, FollowTest]], joints: int) -> str:
    """Return one sentence on whether what was taken away follows the motion on any log and joint."""
    flagged = [entry for entry in tests if entry[2].is_following]
    if not flagged:
        return "At no joint does what was taken away follow the motion."
    names = list(dict.fromkeys(joint for _, joint, _ in flagged))
    where = f"all {joints} joints" if 1 < len(names) == joints else join_names(names)
    log, joint, worst = max(flagged, key=lambda entry: entry[2].share)
    lost = max(test.lost for _, _, test in flagged)
    matters = "enough to matter" if lost > MAX_LOST_ACCELERATION else "too little to matter"
    return (
        f"Flagged: what was taken away follows the motion at {where}, up to {percent(worst.share, 2)} of it ({joint}, "
        f"{log}). At most {percent(lost, 2)} of an acceleration went with it, {matters}."
    )


def _smoothing_blocks(identification: Identification) -> Iterator[PageBlock]:
    """Yield one table of the numbers that the smoothers give per joint, and their descriptions below it."""
    motions = [(log.name, log.motion) for log in identification.validations]
    yield from _smoothing_table(motions)
    descriptions = {
        name: ", ".join(f"{key} {value}" for key, value in motion.smoothing.items() if isinstance(value, str))
        for name, motion in motions
    }
    # Where all logs were smoothed alike, say it once
    if len(set(descriptions.values())) == 1:
        yield from filter(None, (f"{words[:1].upper()}{words[1:]}." for words in set(descriptions.values()) if words))
    else:
        yield tuple(f"{name}: {words}" for name, words in descriptions.items())


def _smoothing_table(motions: Sequence[tuple[str, Motion]]) -> Iterator[PageBlock]:
    keys = list(dict.fromkeys(key for _, motion in motions for key in motion.smoothing if _per_joint(motion, key)))
    rows = []
    for name, motion in motions:
        for j, joint in enumerate(motion.joints):
            cells = (number(float(motion.smoothing[key][j])) if _per_joint(motion, key) else "-" for key in keys)
            rows.append((name, joint, *cells))
    if keys:
        heads = (_HEADS.get(key, key) for key in keys)
        table = PageTable.of(("log", "joint"), heads, rows, "Smoothing per log and joint")
        title = f"Smoothing of {count(len(motions), 'log')}, joint by joint"
        yield table if len(rows) < MIN_FOLDED_ROWS else Fold(title, (table,))


def _per_joint(motion: Motion, key: str) -> bool:
    value = motion.smoothing.get(key)
    return value is not None and not isinstance(value, str) and np.shape(value) == (len(motion.joints),)


def pieces_section(identification: Identification) -> Iterator[PageSection]:
    """Yield the section of the pieces, where there are any."""
    pieces = identification.estimate.residual.pieces
    if pieces is None:
        return
    joints = identification.model.joints
    caption = "Residual of each joint in each piece, relative to its torque over all of them."
    figure = Figure(pieces_figure(pieces, [joint.name for joint in joints]), caption)
    heads = ("torque equations", "error, %", "rmse", "least rmse of a piece", "largest rmse of a piece")
    rows = []
    for j, (joint, error) in enumerate(zip(joints, pieces.relative_error, strict=True)):
        count, rmse = pieces.rows[:, j], pieces.residual[:, j]
        # Pieces without rows have no error; the total weighs the others by their number of rows
        nonempty = rmse[count > 0]
        total_rmse = float(np.sqrt((count * rmse**2).sum() / max(int(count.sum()), 1)))
        ends = (float(nonempty.min()), float(nonempty.max())) if len(nonempty) else (np.nan, np.nan)
        cells = (str(int(count.sum())), number(float(error), 3), *(number(x, 3) for x in (total_rmse, *ends)))
        rows.append((joint.name, *cells, joint.effort))
    caption = "Torque error over all samples, unfiltered where the fit has no low-pass"
    table = PageTable.of(("joint",), (*heads, UNIT), rows, caption)
    yield PageSection("The whole recording", (_PIECES, table, figure))


def repeat_section(identification: Identification) -> PageSection:
    """Return the section with everything needed to repeat the run."""
    sources, blocks = identification.provenance, list[PageBlock]([_LEAD])
    if sources.configuration is not None:
        blocks.append(Fold(f"Configuration: {sources.configuration.path}", (Code(sources.configuration.text),)))
    read_files = [source for source in (sources.model, *sources.logs) if source is not None]
    if files := [(source.path, day(source.modified), source.sha256) for source in read_files]:
        caption = "Files that were read, with the dates of the recordings' files"
        blocks.append(PageTable.of(("file", "of", "SHA-256"), (), files, caption))
    blocks.append(pair_table("package", list(sources.versions.items()), "Versions"))
    settings = [(name, typeset(text)) for name, text in settings_of(identification).items()]
    blocks.append(Fold("All settings", (pair_table("setting", settings),)))
    return PageSection("To repeat the run", tuple(blocks))
