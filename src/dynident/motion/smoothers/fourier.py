"""Fourier series for motions that repeat: averaged over their periods, and differentiated exactly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.motion.filters import autocorrelation, ljung_box
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers.harmonics import periods_in
from dynident.motion.smoothers.periodic_fit import (
    MAX_HARMONICS,
    Period,
    PeriodicFit,
    PeriodicFitRequest,
    fit_periodic,
    likely_periods,
    misfit,
    scatter,
)
from dynident.motion.smoothers.smoother import BY_JOINT, Smoother, at_rest, ends_mask, make_motion, position_noise
from dynident.motion.smoothers.spline import Spline
from dynident.runtime import InputError, MissingInputError, settings_text
from dynident.runtime.arrays import Array

Count = Annotated[int, Ge(0), Le(MAX_HARMONICS)]
Seconds = Annotated[float, Ge(0)]
MIN_MOTION_RATIO = 20.0  # times the noise (rms) from which on a joint counts as moving
# of the motion and of its acceleration (rms) that a series may leave, beyond the noise
MAX_MISFIT, MAX_ACCELERATION_MISFIT = 0.02, 0.1
MIN_PERIODS_TO_FIND = 1.99  # periods that a log must hold for its period to be found
MIN_PERIODS_TO_COMPARE = 1.5  # periods from which on they can be compared
MIN_SERIES_SAMPLES = 6  # samples
MIN_SAMPLES_PER_PERIOD = 5.0  # samples of a period


@dataclass(frozen=True)
class FourierSeries(Smoother):
    """Fit a Fourier series to each joint of a motion that repeats, and differentiate it; Swevers et al. (1997).

    ``period`` (s) is that of all joints; None finds it, where the log holds two periods or more. ``harmonics`` is their
    number, or a mapping by joint name; None takes those of the least Bayesian information criterion, with the noise
    between the harmonics. ``settle`` is the time (s) at start and end that is not fitted and masked out; None finds
    transients there by their residual. Least squares over all samples is the average over the periods where these are
    whole; broken ones, uneven times and gaps are no harm. The last sample is masked out.

    Calling it returns a ``Motion``; its ``smoothing`` has the ``period`` and its standard error, and by joint the
    harmonics, sigma from how periods differ, and the p-value of white noise. Raises ConfigError for bad settings or
    unknown joints, MissingInputError where no period is found or the one given does not fit, and InputError where the
    log is too short. A log that is only judged and does not repeat is smoothed by ``Spline()``.

    >>> import numpy as np
    >>> import dynident as dy
    >>> t = np.arange(2000) * 0.01
    >>> q = np.sin(1.5 * t) + 0.2 * np.cos(3 * t) + 1e-3 * np.random.default_rng(0).standard_normal(2000)
    >>> log = dy.Log(t, q[:, None], tau=np.cos(t)[:, None], joints=("hinge",))
    >>> motion = dy.FourierSeries()(log)
    >>> how = motion.smoothing
    >>> print(f"period {how['period']:.3f} s, {how['harmonics'][0]} harmonics, noise {how['sigma'][0]:.1g} rad")
    period 4.189 s, 2 harmonics, noise 0.001 rad
    """

    period: Annotated[float, Gt(0)] | None = None
    harmonics: Annotated[Count | Mapping[str, Count] | None, BY_JOINT] = None
    settle: tuple[Seconds, Seconds] | None = None

    @property
    def method(self) -> str:
        """The method in words."""
        return "Fourier series" if self.period is None else f"Fourier series of period {self.period:.6g} s"

    def __call__(self, log: Log) -> Motion:
        """Fit; ``smoothing`` holds period and error, start, stop (s), by joint harmonics, sigma, noise, whiteness."""
        fit = self._fit(log)
        q, dq, ddq = fit.series(log.t)
        # degrees of freedom of the residual: a sine and a cosine for each harmonic, and the mean
        degrees = len(fit.residual) - 2 * fit.harmonics - 1
        noise = np.sqrt(np.square(fit.residual).sum(axis=0) / np.maximum(degrees, 1))
        start, stop = float(log.t[fit.rows][0] - log.t[0]), float(log.t[-1] - log.t[fit.rows][-1])
        mask = ends_mask(log, start, stop)
        mask[-1] = False
        t, value = log.t[fit.rows], fit.period.value
        periods = periods_in(t, value)
        error_text = f" +- {fit.period.std:.1g}" if fit.period.std else ""
        smoothing = {
            "method": f"Fourier series over {periods:.4g} periods of {value:.6g}{error_text} s",
            "period": value,
            "period error": fit.period.std,
            "start": start,
            "stop": stop,
            "harmonics": tuple(fit.harmonics.tolist()),
            "sigma": tuple((scatter(t, fit.residual, value) if periods >= MIN_PERIODS_TO_COMPARE else noise).tolist()),
            "noise": tuple(noise.tolist()),
            "whiteness": tuple(
                ljung_box(autocorrelation(x), len(x)) if len(x) >= 50 and np.ptp(x) > 0 else float("nan")
                for x in fit.residual.T
            ),
        }
        return make_motion(log, (q, dq, ddq), mask, smoothing, at_rest(log.q, q, noise))

    def as_used(self, motion: Motion) -> FourierSeries:
        """Return the series with period, harmonics of each joint and ends that it has used for a motion."""
        smoothing = motion.smoothing
        harmonics = dict(zip(motion.joints, smoothing["harmonics"], strict=True))
        return FourierSeries(smoothing["period"], harmonics, (smoothing["start"], smoothing["stop"]))

    def of_period(self, motion: Motion) -> FourierSeries:
        """Return the series with the period that it has found for all joints of a motion."""
        return replace(self, period=motion.smoothing["period"])

    def substitute(self) -> Spline:
        """Return the default spline, which smooths a log that does not repeat where that is only judged."""
        return Spline()

    def _fit(self, log: Log) -> PeriodicFit:
        rows, joint_harmonics = self._settled_rows(log), self.by_joint("harmonics", log)
        t, q, sigma = log.t[rows], log.q[rows], position_noise(log)
        moves = (q - q[0]).std(axis=0) > MIN_MOTION_RATIO * sigma  # of a constant that is exactly zero
        request = PeriodicFitRequest(joint_harmonics, self.settle is not None, moves, sigma)
        period = self._likely_period(log, t, q, request.moves) if self.period is None else Period(self.period, 0.0)
        step = float(np.median(np.diff(t)))
        if not period.value > MIN_SAMPLES_PER_PERIOD * step:
            raise InputError(
                f"{log.source}: a period of {period.value:g} s is shorter than {MIN_SAMPLES_PER_PERIOD:g} samples, "
                f"{MIN_SAMPLES_PER_PERIOD * step:.3g} s; correct `period`, which is in s, or leave it out."
            )
        # a period that is to be found must be seen twice, a given one only once
        if periods_in(t, period.value) < (1.0 if self.period else MIN_PERIODS_TO_FIND):
            if self.period is None:
                raise MissingInputError(f"{log.source}: {_no_period(t)}")
            reason = f"less than one period of {period.value:g} s; record longer, or use a spline"
            raise MissingInputError(f"{log.source}: {t[-1] - t[0]:.4g} s are {reason}.")
        try:
            fit = fit_periodic(log, rows, period, request)
        except np.linalg.LinAlgError as error:
            raise InputError(
                f"{log.source}: its {len(t)} samples do not determine a series of period {period.value:.4g} s; give "
                "fewer `harmonics`, or use a spline."
            ) from error
        self._check(log, fit, request)
        return fit

    def _settled_rows(self, log: Log) -> slice:
        """Return the rows of a log without what settles."""
        inside = np.flatnonzero(ends_mask(log, *(self.settle or (0.0, 0.0))))
        if len(inside) < MIN_SERIES_SAMPLES:
            raise InputError(
                f"{log.source}: {len(inside)} samples are too few for a series; it needs {MIN_SERIES_SAMPLES}."
            )
        return slice(int(inside[0]), int(inside[-1]) + 1)

    def _likely_period(self, log: Log, t: Array, q: Array, moves: NDArray[np.bool_]) -> Period:
        """Return the likely period, of which no error is known yet."""
        if not moves.any():
            raise MissingInputError(f"{log.source}: no joint moves, so that no period can be found; give `period`.")
        candidates = likely_periods(t, q[:, moves])
        if not candidates:
            raise MissingInputError(f"{log.source}: {_no_period(t)}")
        return Period(candidates[0], np.inf)

    def _check(self, log: Log, fit: PeriodicFit, request: PeriodicFitRequest) -> None:
        """Raise MissingInputError where the motion does not repeat with the period."""
        t, q, period = log.t[fit.rows], log.q[fit.rows], fit.period.value
        share, bend = misfit(t, fit, request)
        # joints at rest have no motion that could repeat
        worst = np.where(request.moves, np.maximum(share / MAX_MISFIT, bend / MAX_ACCELERATION_MISFIT), 0.0)
        if (worst <= 1.0).all():
            return
        j = int(np.argmax(worst))
        description = (
            f"joint {log.joints[j]!r} differs from its Fourier series of period {period:.6g} s by "
            f"{100 * share[j]:.3g} % of its motion and {100 * bend[j]:.3g} % of its acceleration, beyond the noise"
        )
        if self.period is None:
            raise MissingInputError(
                f"{log.source}: the motion does not repeat: {description}. Use a spline, or a part that repeats."
            )
        candidates = likely_periods(t, q[:, request.moves])
        hint = f"the motion is most like itself after {candidates[0]:.6g} s. " if candidates else ""
        raise MissingInputError(
            f"{log.source}: the period of {period:.6g} s does not fit: {description}; {hint}Correct `period`, or leave "
            "it out to have it found."
        )

    def __str__(self) -> str:
        return settings_text(self.method, self, ("period",))


def _no_period(t: Array) -> str:
    return (
        f"no two periods of one motion are found in its {t[-1] - t[0]:.4g} s. A Fourier series is for motion that "
        "repeats: record two periods, give `period` where it is known, or use a spline."
    )
