"""The cross-validated torque error over the degree of smoothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.identification import cross_validated_error
from dynident.identification.smoother_choice import MAX_TIE_DIFFERENCE
from dynident.models import Model
from dynident.motion.filters import autocorrelation, welch
from dynident.motion.log import Log, Motion, thin_motions
from dynident.motion.smoothers import Smoother, Spline, smooth_log
from dynident.motion.smoothers.spline import NOISE_FACTORS
from dynident.motion.splines import GCV, NORMAL_95, REML, stretches
from dynident.runtime import InputError, Noun
from dynident.runtime.arrays import Array

Mask = NDArray[np.bool_]
MIN_DEGREE = -6.0  # log10(S/n) of a spline through the data
MAX_LAGS = 400  # of the autocorrelation, at most
MAX_BINS = 600  # frequencies of a spectrum, at most
MIN_SAMPLES = 8  # samples of a residual that is looked at
DEGREES = (-2.0, -1.2, -0.6, -0.3, *(2.0 * np.log10(factor) for factor in NOISE_FACTORS), 3.4)
ROWS = 6000  # samples of the regression on which the curve rests
MIN_USABLE_SHARE = 0.5  # share of the samples that a degree must leave usable to be on the curve
NOISE_MARK, GCV_MARK, REML_MARK, TORQUE_MARK = "S = n", "GCV", "REML", "torque"


class SmoothedJoint(Noun):
    """The motion of a ``joint`` in a ``log``: positions ``measured`` and smoothed, ``q`` (N), at ``t`` (N) in s.

    ``dq`` and ``ddq`` are the derivatives, in rad or m, and seconds. ``mask`` (N) is where derivatives of this
    joint are reliable and not excluded; a fit uses the samples at which those of all joints are. The ``residual``
    (N) is measured less smoothed position, with outliers replaced as in the fit. ``degree`` is log10(S/n) as reached,
    in terms of the ``noise`` (rad, m). ``cutoff`` (Hz) and ``edf``, the effective degrees of freedom, are nan for
    smoothers other than the spline.
    """

    log: str
    joint: str
    t: Array
    measured: Array
    q: Array
    dq: Array
    ddq: Array
    residual: Array
    mask: Mask
    noise: float
    degree: float
    cutoff: float
    edf: float

    def spectrum(self) -> tuple[Array, Array]:
        """Return frequencies (Hz, F) and the power spectral density (F; rad^2/Hz, m^2/Hz) of the residual.

        That of white noise is flat; motion that smoothing removed rises towards low frequencies, up to the cut-off.
        It is Welch's average over windows that overlap by half, in the longest stretch of usable samples.
        """
        x, step = self._longest_stretch(), float(np.diff(self.t).mean())
        if len(x) < MIN_SAMPLES:
            return np.zeros(0), np.zeros(0)
        f, power = welch(x, step, min(2 * MAX_BINS, len(x)))
        return f[1:], power[1:]

    def autocorrelation(self) -> tuple[Array, Array, float]:
        """Return lags (s, L), the autocorrelation (L) of the residual, and the 95 % bound of that of white noise.

        They are from the longest stretch of usable samples.
        """
        x, step = self._longest_stretch(), float(np.diff(self.t).mean())
        if len(x) < MIN_SAMPLES or not np.ptp(x) > 0:
            return np.zeros(0), np.zeros(0), float("nan")
        lags = np.arange(1, min(MAX_LAGS, len(x) // 2) + 1)
        return np.asarray(step * lags, dtype=float), autocorrelation(x)[lags], NORMAL_95 / float(np.sqrt(len(x)))

    def _longest_stretch(self) -> Array:
        parts = stretches(self.mask)
        return self.residual[max(parts, key=lambda part: part.stop - part.start)] if parts else np.zeros(0)


def degree_of(residual: Array, noise: float) -> float:
    """Return log10(S/n) of the residual (N) of smoothing, for noise of this standard deviation."""
    ratio = float(np.mean(np.square(residual))) / noise**2 if noise > 0 else 0.0
    return max(float(np.log10(ratio)), MIN_DEGREE) if ratio > 0 else MIN_DEGREE


def smoothed_joint(recorded: Log, repaired: Log, motion: Motion, joint: str, noise: float) -> SmoothedJoint:
    """Return a joint of a log as recorded and repaired, with its motion without time offset.

    The motion may have other joints as well.
    """
    j, k = motion.joints.index(joint), recorded.joints.index(joint)
    residual = repaired.q[:, k] - motion.q[:, j]

    def smoothing_figure(name: str) -> float:
        return float(motion.smoothing[name][j]) if name in motion.smoothing else float("nan")

    states = recorded.q[:, k], motion.q[:, j], motion.dq[:, j], motion.ddq[:, j]
    figures = noise, degree_of(residual, noise), smoothing_figure("cutoff"), smoothing_figure("edf")
    return SmoothedJoint(motion.source, joint, motion.t, *states, residual, motion.mask, *figures)


class DegreeCurve(Noun):
    """Cross-validated torque errors (K, %) of ``degrees`` (K), log10(S/n), of all joints together, or of ``joint``
    alone with the others as they are tuned.

    All are on the same samples, those that are reliable for every degree: fewer than in a fit, unfiltered and at every
    speed, so that only differences along the curve count. ``marks`` are degrees (n) by name: "S = n", what "GCV" and
    "REML" choose by the positions alone, and what the "torque" chooses: the least smoothing, from S = n on, within
    0.5 % of the least error.
    """

    degrees: Array
    errors: Array
    joint: str | None
    marks: Mapping[str, tuple[float, ...]]


def degree_curve(
    model: Model,
    logs: Sequence[Log],
    spline: Callable[[tuple[float, ...]], Smoother],
    tuned: tuple[float, ...],
    joint: int | None,
) -> DegreeCurve:
    """Return the curve of a model on training logs, with a mark at the best degree.

    ``spline`` makes a smoother of degrees (n), ``tuned`` are the current ones. Raises InputError where no degree
    leaves samples that can be judged.
    """
    motions_by_degree = [_motions(model, logs, spline(_set_degree(tuned, degree, joint))) for degree in DEGREES]
    usable = [sum(int(motion.mask.sum()) for motion in motions) for motions in motions_by_degree]
    # Wide smoothing loses the ends of the logs: drop degrees that would leave too few common samples.
    usable_degrees = [k for k, count in enumerate(usable) if count > MIN_USABLE_SHARE * max(usable)]
    if not usable_degrees:
        raise InputError(f"{logs[0].source}: no degree of smoothing leaves samples to judge it by; exclude less.")
    usable_motions = [motions_by_degree[k] for k in usable_degrees]
    # Every degree is judged on the same samples, those that are reliable for all.
    masks = [np.logical_and.reduce([motion.mask for motion in of_log]) for of_log in zip(*usable_motions, strict=True)]
    errors = np.zeros(len(usable_degrees))
    for k, motions in enumerate(usable_motions):
        masked = [replace(motion, mask=mask) for motion, mask in zip(motions, masks, strict=True)]
        errors[k] = cross_validated_error(model, thin_motions(masked, ROWS))
    degrees = np.array([DEGREES[k] for k in usable_degrees])
    marks = {TORQUE_MARK: _set_degree(tuned, _best_degree(degrees, errors), joint)}
    return DegreeCurve(degrees, errors, None if joint is None else model.joints[joint].name, marks)


def _best_degree(degrees: Array, errors: Array) -> float:
    """Return the least degree with nearly the least error, not below S = n, by the rule for choosing a smoother."""
    allowed = degrees >= 0
    degrees, errors = (degrees[allowed], errors[allowed]) if allowed.any() else (degrees, errors)
    return float(degrees[np.flatnonzero(errors <= errors.min() * (1 + MAX_TIE_DIFFERENCE))[0]])


def _set_degree(tuned: tuple[float, ...], degree: float, joint: int | None) -> tuple[float, ...]:
    return tuple(degree if joint in (None, j) else previous for j, previous in enumerate(tuned))


def _motions(model: Model, logs: Sequence[Log], smoother: Smoother) -> tuple[Motion, ...]:
    """Return the motions of the logs, none where one cannot be smoothed."""
    try:
        return tuple(model.remembering(smooth_log(smoother, log)) for log in logs)
    except InputError:
        return ()


def rule_degrees(logs: Sequence[Log], noise: Sequence[Array], ends: float) -> dict[str, tuple[float, ...]]:
    """Return the degrees (n), as mean over the logs, that rules choose by the positions alone.

    ``noise`` is that (n) of each log. A rule that cannot smooth a log is left out.
    """
    degrees = {NOISE_MARK: (0.0,) * logs[0].q.shape[1]}
    for name, rule in ((GCV_MARK, GCV()), (REML_MARK, REML())):
        try:
            motions = [Spline(rule, ends=ends)(log) for log in logs]
        except InputError:
            continue
        log_degrees = [
            [degree_of(log.q[:, j] - motion.q[:, j], float(size)) for j, size in enumerate(sizes)]
            for log, motion, sizes in zip(logs, motions, noise, strict=True)
        ]
        degrees[name] = tuple(np.mean(log_degrees, axis=0).tolist())
    return degrees
