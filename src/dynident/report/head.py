"""The numbers at the head of an identification's report: the error over what the sensors allow, and what it weighs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident.report.page import number
from dynident.report.wording import words
from dynident.report.words import logs_of
from dynident.validation import FloorOrigin

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.validation import LogValidation

__all__ = ["head_numbers", "worst_joint"]


def head_numbers(identification: Identification) -> Iterator[tuple[str, ...]]:
    """Yield the numbers: the error over what the sensors allow where that is known, held-out error, its worst joint,
    and the free simulation or what the error weighs.

    Of a single joint the third is what the error weighs.
    """
    held, train = logs_of(identification, "validation"), logs_of(identification, "train")
    logs, said = (held, "held out") if held else (train, "training")
    log = max(logs, key=_error)
    yield from _over_floor(log)
    *rest, note = _whole(held, train)
    yield *rest, note + "; what the sensors allow is not known" * (log.over_floor is None)
    worst = worst_joint(identification)
    if worst is None:
        return
    log, joint = worst
    size = _joints(log)[joint]
    weight = _weight(identification, logs, said)
    if len(identification.model.joints) > 1:
        rms = f"{joint}, rms {_rms(identification, log, joint)}{' as measured' * bool(log.errors.per_joint_filtered)}"
        yield f"{number(size, 3)} %", f"worst joint, {said}", rms
        yield _run(identification) if identification.runs else weight
    else:
        yield weight
        if identification.runs:
            yield _run(identification)


def worst_joint(identification: Identification) -> tuple[LogValidation, str] | None:
    """Return the joint with the largest relative error, and its log: one held out, where there is one."""
    logs = logs_of(identification, "validation") or logs_of(identification, "train")
    worst = _worst([((log, joint), size) for log in logs for joint, size in _joints(log).items()])
    return None if worst is None else worst[0]


def _over_floor(log: LogValidation) -> Iterator[tuple[str, ...]]:
    """Yield the error on a log over what the sensors allow, with how that is known."""
    if log.over_floor is None:
        return
    white = any(one.origin is FloorOrigin.WHITE for one in log.floors.values())
    known = f"; {len(log.floors)} of {len(log.errors.rmse)} joints" * (len(log.floors) < len(log.errors.rmse))
    how = "at most, by white noise alone" if white else "by motion that repeats"
    yield (
        f"{number(log.over_floor, 3 if log.over_floor < 1.5 else 2)} ×",
        "error over what sensors allow",
        "at the noise floor" if log.at_floor else f"{how}{known}",
    )


def _whole(held: list[LogValidation], train: list[LogValidation]) -> tuple[str, ...]:
    trained = max(map(_error, train))
    if not held:
        return "-", "torque error, held out", f"no log was held out; training {number(trained, 3)} %"
    log = max(held, key=_error)
    note = f"training {number(trained, 3)} %"
    if log.errors.relative_error_filtered is not None:
        note = f"after the low-pass of the fit; {note}; as measured {number(log.errors.relative_error, 3)} %"
    return f"{number(_error(log), 3)} %", "torque error, held out", note


def _run(identification: Identification) -> tuple[str, ...]:
    what = "position error, free simulation"
    if failed := [run for run in identification.runs if run.failure]:
        return "fails", what, f"{failed[0].name}: {words(failed[0].failure)}"
    errors = [((run, joint), size) for run in identification.runs for joint, size in run.motion_error.items()]
    found = _worst(errors)
    if found is None:
        return "-", what, "nothing moved"
    (run, joint), size = found
    how = "in the controller's loop" if run.restart is None else f"within {run.restart:g} s of the measured torque"
    return f"{number(size, 2)} %", what, f"of the way of {joint} ({run.name}), {how}"


def _weight(identification: Identification, logs: list[LogValidation], said: str) -> tuple[str, ...]:
    """Return the largest rms error in % of what a joint may exert, or, where no limit is known, in its unit."""
    worst = _worst([((log, joint), size) for log in logs for joint, size in log.errors.effort_share.items()])
    if worst is not None:
        (log, joint), size = worst
        limit = number(identification.model.limits[joint].effort, 3)
        return (
            f"{number(size, 2)} %",
            f"rms of effort limit, {said}",
            f"{joint}: {_rms(identification, log, joint)} of {limit}",
        )
    worst = _worst([((log, joint), size) for log in logs for joint, size in log.errors.rmse.items()])
    if worst is None:
        return "-", f"largest rms error, {said}"
    (log, joint), _ = worst
    return _rms(identification, log, joint), f"largest rms error, {said}", f"{joint}, {log.name}"


def _worst(sizes: list[tuple[Any, float]]) -> tuple[Any, float] | None:
    """Return what has the largest size, and the size; None where there is none."""
    known = [pair for pair in sizes if not np.isnan(pair[1])]
    return max(known, key=lambda pair: pair[1]) if known else None


def _rms(identification: Identification, log: LogValidation, joint: str) -> str:
    unit = next(one.effort for one in identification.model.joints if one.name == joint)
    return f"{number(log.errors.rmse[joint], 3)} {unit}"


def _error(log: LogValidation) -> float:
    """Return the error that the verdict judges: after the low-pass of the fit, where one is used."""
    return (
        log.errors.relative_error if log.errors.relative_error_filtered is None else log.errors.relative_error_filtered
    )


def _joints(log: LogValidation) -> dict[str, float]:
    return dict(log.errors.per_joint_filtered or log.errors.per_joint)
