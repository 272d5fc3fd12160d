"""Chooses among smoothers by the cross-validated torque error on the training logs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, Step, brief
from dynident.identification.cross_validation import predicted, stretch
from dynident.jobs import run_jobs
from dynident.log import Log, Motion, pieces, subsample
from dynident.models import Model
from dynident.regression import Regression
from dynident.smoothers import Smoother, TimeShifted, motion_of

__all__ = ["Choice", "choose_smoother", "cross_validated_error", "excerpts"]

SAMPLES, PIECES = 40_000, 5  # of all logs together, and of each of them, that are smoothed to choose
ROWS = 10_000  # samples of the regression on which the choice rests
TIE = 0.005  # relative difference below which errors count as equal; the first candidate is then taken


@dataclass(frozen=True)
class Choice:
    """The first smoother with nearly the least cross-validated torque error, and the ``errors`` (%) of all candidates.

    The error of a candidate that cannot smooth these logs is infinite.
    """

    smoother: Smoother
    candidates: tuple[Smoother, ...]
    errors: tuple[float, ...]

    __repr__ = brief


def choose_smoother(
    model: Model,
    logs: Sequence[Log],
    candidates: Sequence[Smoother],
    *,
    folds: int = 5,
    progress: Callable[[str], None] = lambda _: None,
    known: dict[int, tuple[Motion, ...]] | None = None,
    executor: Executor | None = None,
) -> Choice:
    """Return the candidate whose motion lets least squares predict the torque of left-out stretches of time best.

    The position noise determines the best smoothing of the position, not of its derivatives, and only if it is white;
    the torque error measures the derivatives. Every log is divided into ``folds`` stretches; each is predicted from all
    others, over the samples that are reliable for every candidate, against the unfiltered torque. Of candidates within
    0.5 % of the least error the first is taken: list them from the least smoothing to the most. ``known`` has the
    motions of the logs' ``excerpts`` by the ``id`` of a smoother, and keeps new ones. The candidates smooth on the
    ``executor`` side by side, by default in this process, with the same result. Raises the first error where no
    candidate can smooth the logs, InputError where all torques are zero, ConfigError where there is no candidate.
    """
    if not candidates:
        raise ConfigError("no smoother is given to choose from.")
    some, motions_of = excerpts(logs), {} if known is None else known
    if executor is not None:
        progress(Step("choosing the smoother"))
        _smooth_ahead(some, candidates, motions_of, executor)
    tried = _tried(some, candidates, progress, motions_of)
    masks = _common([motions for motions in tried if not isinstance(motions, InputError)], 10 * folds)
    errors = []
    for k, motions in enumerate(tried):
        progress(Step("choosing the smoother", len(tried) + k, 2 * len(tried)))
        if isinstance(motions, InputError):
            errors.append(np.inf)
            continue
        common = _thinned([model.remembering(one) for one in motions], masks)
        errors.append(cross_validated_error(model, common, folds))
    good = np.flatnonzero(np.array(errors) <= min(errors) * (1 + TIE))
    if not len(good):
        raise InputError(
            f"{logs[0].source}: the torque is zero in every sample of every log, so that no smoother can be chosen by "
            "it; look whether the right torque column is named, and was recorded."
        )
    return Choice(candidates[int(good[0])], tuple(candidates), tuple(errors))


@dataclass(frozen=True, eq=False)
class _Smoothing:
    """What workers do: the motions of the logs by the smoother of a number."""

    smoothers: tuple[Smoother, ...]
    logs: tuple[Log, ...]

    def __call__(self, k: int) -> tuple[Motion, ...]:
        return tuple(motion_of(self.smoothers[k], log) for log in self.logs)


def _smooth_ahead(
    logs: Sequence[Log], candidates: Sequence[Smoother], known: dict[int, tuple[Motion, ...]], executor: Executor
) -> None:
    """Keep the motions of the logs by each candidate, as workers make them; one that fails is left for this process,
    where its error is raised."""
    new = tuple({id(one): one for one in map(_bare, candidates) if id(one) not in known}.values())
    for done in run_jobs(_Smoothing(new, tuple(logs)), range(len(new)), executor):
        if done.value is not None:
            known[id(new[done.job])] = done.value


def _bare(smoother: Smoother) -> Smoother:
    """Return a smoother without its time offset."""
    return smoother.smoother if isinstance(smoother, TimeShifted) else smoother


def _tried(
    logs: Sequence[Log],
    candidates: Sequence[Smoother],
    progress: Callable[[str], None],
    known: dict[int, tuple[Motion, ...]],
) -> list[tuple[Motion, ...] | InputError]:
    """Return the motions of the logs by each candidate, or why it has none; raises the first error where all fail."""
    tried: list[tuple[Motion, ...] | InputError] = []
    for k, smoother in enumerate(candidates):
        progress(Step("choosing the smoother", k, 2 * len(candidates)))  # the errors come after
        try:
            tried.append(_motions(smoother, logs, known))
        except InputError as error:
            tried.append(error)
    failed = [error for error in tried if isinstance(error, InputError)]
    if len(failed) == len(tried):
        raise failed[0]
    return tried


def _motions(smoother: Smoother, logs: Sequence[Log], known: dict[int, tuple[Motion, ...]]) -> tuple[Motion, ...]:
    """Return the motions of the logs; a smoother with a time offset shifts those without it, where they are known."""
    bare = _bare(smoother)
    if id(bare) not in known:
        known[id(bare)] = tuple(motion_of(bare, log) for log in logs)
    found = known[id(bare)]
    return tuple(map(smoother.shifted, found)) if isinstance(smoother, TimeShifted) else found


def _common(made: Sequence[tuple[Motion, ...]], least: int) -> list[NDArray[np.bool_]]:
    """Return the samples of each log that are reliable for every candidate; for any of them where too few are left."""
    masks = [np.logical_and.reduce([one.mask for one in motions]) for motions in zip(*made, strict=True)]
    if not all(mask.sum() >= least for mask in masks):  # the widest kernels leave too little in common
        masks = [np.logical_or.reduce([one.mask for one in motions]) for motions in zip(*made, strict=True)]
    return masks


def excerpts(logs: Sequence[Log]) -> list[Log]:
    """Return five pieces of each log, evenly spread, where the logs are long: enough to compare the smoothers."""
    share = min(1.0, SAMPLES / max(sum(map(len, logs)), 1))
    if share == 1.0:
        return list(logs)
    found = []
    for log in logs:
        if int(share * len(log) / PIECES) < 1000:  # too short to smooth well
            found.append(log)
            continue
        parts = pieces(slice(0, len(log)), PIECES, share)
        found += [log.rows(part, f"{log.source} piece {k}") for k, part in enumerate(parts, start=1)]
    return found


def cross_validated_error(model: Model, motions: Sequence[Motion], folds: int = 5) -> float:
    """Return the relative torque error (%) of stretches of time predicted from the others, from triangular factors."""
    parts = [
        Regression(model, tuple(stretch(motion, k, folds) for motion in motions)).triangular_factors
        for k in range(folds)
    ]
    total = sum(float(np.square(part.factors[:, :, -1]).sum()) for part in parts)
    wrong = predicted(parts, parts, model.parameters, relative=False).sum()
    return 100.0 * float(np.sqrt(wrong / total)) if total > 0 else float("nan")


def _thinned(motions: Sequence[Motion], masks: Sequence[NDArray[np.bool_]]) -> tuple[Motion, ...]:
    """Return motions of a few of the samples in the masks, all of them to be used."""
    masked = [replace(motion, mask=mask) for motion, mask in zip(motions, masks, strict=True)]
    return tuple(one.shifted(0.0, rows) for one, rows in zip(masked, subsample(masked, ROWS), strict=True))
