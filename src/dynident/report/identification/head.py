"""The numbers of an identification: at the head of its report, and in a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TypeVar

import numpy as np

from dynident.identification import Identification
from dynident.report.words import ROLES
from dynident.runtime import join_names, number
from dynident.validation import FloorOrigin, FreeRun, LogValidation

MAX_LISTED = 3  # logs in a line
Part = TypeVar("Part", LogValidation, FreeRun)


def head_numbers(identification: Identification) -> Iterator[tuple[str, ...]]:
    """Yield the numbers at the head of the report.

    They are the error over what the sensors allow where that is known, the held-out error, its worst joint, and
    the free simulation or the error relative to the effort limit. Of a single joint the latter is the third.
    """
    held_out, train = identification.of_role("validation"), identification.of_role("train")
    logs, role_word = (held_out, "held out") if held_out else (train, "training")
    log = max(logs, key=lambda log: log.errors.in_fit)
    yield from _floor_ratio(log)
    *numbers, note = _torque_error(held_out, train)
    yield *numbers, note + "; the noise of the sensors is not known" * (log.over_floor is None)
    worst = worst_joint(identification)
    if worst is None:
        return
    log, joint = worst
    size = log.errors.joints_in_fit[joint]
    weight = _effort_share(identification, logs, role_word)
    # A single joint is not named as the worst: the error relative to its effort limit takes the place
    if len(identification.model.joints) > 1:
        # the rms belongs to the error as measured, where another one is judged
        measured = f"as measured {number(log.errors.per_joint[joint], 3)} %, " * bool(log.errors.per_joint_filtered)
        rms = f"{measured}rms {_rms(identification, log, joint)}"
        yield f"{number(size, 3)} %", f"worst joint{_low_pass_words(log)}, {role_word}", f"{joint}, {rms}"
        yield _simulation_error(identification) if identification.runs else weight
    else:
        yield weight
        if identification.runs:
            yield _simulation_error(identification)


def worst_joint(identification: Identification) -> tuple[LogValidation, str] | None:
    """Return the joint with the largest relative error and its log, a held-out one where there is any."""
    logs = identification.of_role("validation") or identification.of_role("train")
    worst = _worst(logs, lambda log: log.errors.joints_in_fit)
    return None if worst is None else worst[:2]


def _floor_ratio(log: LogValidation) -> Iterator[tuple[str, ...]]:
    """Yield the error on a log over what the sensors allow, and how that is known."""
    if log.over_floor is None:
        return
    white = any(floor.origin is FloorOrigin.WHITE for floor in log.floors.values())
    coverage = f"; {len(log.floors)} of {len(log.errors.rmse)} joints" * (len(log.floors) < len(log.errors.rmse))
    how = "at most, by white noise alone" if white else "noise from repeated motion"
    note = "at the noise floor" if log.at_floor else f"{how}{coverage}"
    yield f"{number(log.over_floor, 3 if log.over_floor < 1.5 else 2)} ×", "torque error relative to noise", note


def _torque_error(held_out: Sequence[LogValidation], train: Sequence[LogValidation]) -> tuple[str, ...]:
    trained = max(log.errors.in_fit for log in train)
    if not held_out:
        return "-", "torque error, held out", f"no log was held out; training {number(trained, 3)} %"
    log = max(held_out, key=lambda log: log.errors.in_fit)
    low_pass, note = _low_pass_words(log), f"training {number(trained, 3)} %"
    note += f"; as measured {number(log.errors.relative_error, 3)} %" * bool(low_pass)
    return f"{number(log.errors.in_fit, 3)} %", f"torque error{low_pass}, held out", note


def _simulation_error(identification: Identification) -> tuple[str, ...]:
    title = "position error, free simulation"
    if failed := [run for run in identification.runs if run.failure]:
        return "fails", title, f"{failed[0].name}: {failed[0].failure}"
    if (worst := _worst(identification.runs, lambda run: run.motion_error)) is None:
        return "-", title, "nothing moved"
    run, joint, size = worst
    how = "in the controller's loop" if run.restart is None else f"within {run.restart:g} s of the measured torque"
    return f"{number(size, 2)} %", title, f"of the motion of {joint} ({run.name}), {how}"


def _effort_share(identification: Identification, logs: Sequence[LogValidation], role_word: str) -> tuple[str, ...]:
    """Return the largest rms error in % of the joint's effort limit, or in its unit where no limit is known."""
    if (worst := _worst(logs, lambda log: log.errors.effort_share)) is not None:
        log, joint, size = worst
        note = f"{joint}: {_rms(identification, log, joint)} of {number(identification.model.limits[joint].effort, 3)}"
        return f"{number(size, 2)} %", f"rms of effort limit, {role_word}", note
    if (worst := _worst(logs, lambda log: log.errors.rmse)) is None:
        return "-", f"largest rms error, {role_word}"
    log, joint, _ = worst
    return _rms(identification, log, joint), f"largest rms error, {role_word}", f"{joint}, {log.name}"


def _worst(parts: Iterable[Part], sizes: Callable[[Part], Mapping[str, float]]) -> tuple[Part, str, float] | None:
    """Return the log or run and the joint with the largest of their sizes, and that; None where there is none."""
    entries = [(part, joint, size) for part in parts for joint, size in sizes(part).items() if not np.isnan(size)]
    return max(entries, key=lambda entry: entry[2], default=None)


def _rms(identification: Identification, log: LogValidation, joint: str) -> str:
    unit = next(candidate.effort for candidate in identification.model.joints if candidate.name == joint)
    return f"{number(log.errors.rmse[joint], 3)} {unit}"


def _low_pass_words(log: LogValidation) -> str:
    """Return where the errors that are judged are taken: a title says it, as other numbers are as measured."""
    return "" if log.errors.relative_error_filtered is None else " after the low-pass"


def error_lines(identification: Identification) -> Iterator[str]:
    """Yield the torque errors of training and held-out logs, unfiltered."""
    for role, word in ROLES.items():
        if logs := identification.of_role(role):
            errors = (f"{log.name} {number(log.errors.relative_error, 3)} %" for log in logs)
            yield f"Torque error, {word}: {join_names(errors, MAX_LISTED)}"


def summary_lines(identification: Identification) -> Iterator[str]:
    """Yield the torque errors, and the worst joint."""
    yield from error_lines(identification)
    if len(identification.model.joints) > 1 and (worst := worst_joint(identification)) is not None:
        log, joint = worst
        errors = log.errors
        low_passed = f" ({number(errors.joints_in_fit[joint], 3)} % after the low-pass)" * bool(
            errors.per_joint_filtered
        )
        size = f"{number(errors.per_joint[joint], 3)} % on {log.name}{low_passed}"
        yield f"Worst joint: {joint}, {size}, rms {_rms(identification, log, joint)}"
