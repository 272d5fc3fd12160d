"""Kalman smoothing: the position as an integrated Wiener process, noise and process by maximum likelihood."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, choices
from dynident.log import Log, Motion
from dynident.smoothers.rest import at_rest, with_rest
from dynident.smoothers.smoother import BY_JOINT, ends_mask
from dynident.splines import Order, WienerFit, posterior_errors, wiener

__all__ = ["KalmanSmoother"]

Array = NDArray[np.float64]
Known = float | Mapping[str, float] | None


@dataclass(frozen=True)
class KalmanSmoother:
    """The most probable motion of joints whose jerk (order 3) or acceleration (order 2) is white noise.

    Each joint's position is an integrated Wiener process of ``order`` m, whose derivative of order m is white noise of
    spectral density ``intensity`` (rad^2 s^(1 - 2 m)), measured with white noise of standard deviation ``sigma`` (rad,
    m); nothing is known of its start. Either is one number or a mapping by joint name; None, and a joint that a mapping
    lacks, takes the value of the largest restricted likelihood. The posterior mean, which a Kalman filter and the
    smoother of Rauch, Tung and Striebel (1965) would give, is found as the smoothing spline that it is: cubic for order
    2, as ``Spline(REML())``, quintic for order 3. With order 3 the acceleration is a state; with order 2 it is the mean
    of white noise.

    The mask leaves out, at both ends, ``ends`` bandwidths of the widest kernel of a joint that moves, plus one step,
    but at most a quarter of the log: a joint that is smoothed over all of it is nearly a polynomial, which has no ends.
    After k bandwidths exp(-k / 2) is left of a wrong jerk at the end with order 3, and with order 2 exp(-k / sqrt 2)
    of a wrong acceleration.

    The likelihood takes the noise as white. That of a filtered encoder is not, and is followed: give sigma then.

    Calling it returns a ``Motion``. Raises ConfigError for bad settings or unknown joints, and InputError where the log
    is too short or cannot be smoothed.

    >>> import numpy as np
    >>> import dynident as dy
    >>> t = np.arange(1001) * 0.01
    >>> q = np.sin(t) + 1e-3 * np.random.default_rng(0).standard_normal(1001)
    >>> log = dy.Log(t, q[:, None], tau=np.cos(t)[:, None], joints=("hinge",))
    >>> motion = dy.KalmanSmoother()(log)
    >>> print(f"noise found {motion.smoothing['sigma'][0]:.2g} rad")
    noise found 0.00097 rad
    >>> print(f"error of the acceleration {np.abs(motion.ddq[:, 0] + np.sin(t))[motion.mask].max():.3f} rad/s^2")
    error of the acceleration 0.075 rad/s^2
    """

    order: Order = 3
    sigma: Annotated[Annotated[float, Gt(0)] | Mapping[str, Annotated[float, Gt(0)]] | None, BY_JOINT] = None
    intensity: Annotated[Annotated[float, Ge(0)] | Mapping[str, Annotated[float, Ge(0)]] | None, BY_JOINT] = None
    ends: Annotated[float, Ge(0)] = 4.0

    def __post_init__(self) -> None:
        if self.order not in (2, 3):
            raise ConfigError(f"order is {self.order!r}: give 2 (white acceleration) or 3 (white jerk).")
        if not (np.isfinite(self.ends) and self.ends >= 0):
            raise ConfigError(f"ends is {self.ends}: give a number of bandwidths >= 0.")
        for name, least in (("sigma", "positive"), ("intensity", ">= 0")):
            given = getattr(self, name)
            for one in given.values() if isinstance(given, Mapping) else (given,):
                if one is not None and not (np.isfinite(one) and (one > 0 or (one == 0 and name == "intensity"))):
                    raise ConfigError(f"{name} is {one}: give a number {least}, or none to have the likeliest.")
        if self.intensity is not None and self.sigma is None:
            raise ConfigError("intensity is given without sigma: give both, or sigma alone, or none.")

    @property
    def method(self) -> str:
        """The method in words."""
        name = "acceleration" if self.order == 2 else "jerk"
        return f"Kalman smoother of order {self.order} (white {name}), {self._known}"

    @property
    def _known(self) -> str:
        if self.intensity is not None:
            return "noise and intensity as given"
        return "maximum likelihood" if self.sigma is None else "noise as given, intensity of maximum likelihood"

    def __call__(self, log: Log) -> Motion:
        """Smooth; ``smoothing`` holds per joint sigma, the noise left, intensity, bandwidth (s), cut-off (Hz)."""
        fit = self._fit(log)
        rests = at_rest(log.q, fit.values, fit.left)
        widths = fit.bandwidth[np.isfinite(fit.bandwidth) & ~rests]
        length = float(log.t[-1] - log.t[0])
        step = length / (len(log) - 1)
        reach = max(step, min(self.ends * float(widths.max(initial=0.0)) + step, length / 4))
        mask = ends_mask(log, reach, reach)
        q, dq, ddq = with_rest(rests, log.q, (fit.values, fit.first, fit.second))
        for x in (q, dq, ddq):
            x.flags.writeable = False  # no copy is made then
        return Motion(log.t, q, dq, ddq, log.tau, log.joints, mask, log.source, self._said(fit))

    def standard_errors(self, motion: Motion) -> Array:
        """Return those (order, N, n) of q, dq and, with order 3, ddq of a motion that this smoother has made.

        They hold where the joints move like the process. White noise, which the acceleration of order 2 is, has none.
        """
        sigma, intensity = (np.array(motion.smoothing[name]) for name in ("sigma", "intensity"))
        return posterior_errors(motion.t, self.order, sigma, intensity)

    def as_used(self, motion: Motion) -> KalmanSmoother:
        """Return the smoother with the noise and the intensity, for each joint, that it has used for a motion."""
        sigma, intensity = (
            dict(zip(motion.joints, map(float, motion.smoothing[name]), strict=True)) for name in ("sigma", "intensity")
        )
        return KalmanSmoother(self.order, sigma, intensity, self.ends)

    def _said(self, fit: WienerFit) -> dict[str, object]:
        """Return what the motion says of its smoothing: that of order 2 as a spline does."""
        power = 0.5 / self.order
        with np.errstate(divide="ignore"):
            cutoff = (np.sqrt(2.0) - 1.0) ** power / (2.0 * np.pi * fit.bandwidth)
            found = {"sigma": fit.sigma, "noise": fit.left, "intensity": fit.intensity}
            found |= {"lam": 1.0 / fit.intensity} if self.order == 2 else {}
        found |= {"bandwidth": fit.bandwidth, "cutoff": cutoff}
        said: dict[str, object] = {name: tuple(map(float, value)) for name, value in found.items()}
        return said | {"order": self.order, "method": self.method}

    def _fit(self, log: Log) -> WienerFit:
        names = [f"joint {name!r}" for name in log.joints]
        sigma, intensity = self._given("sigma", log), self._given("intensity", log)
        for name, noise, other in zip(log.joints, sigma, intensity, strict=True):
            if noise is None and other is not None:
                raise ConfigError(f"intensity of joint {name!r} is given without its sigma: give both.")
        try:
            return wiener(log.t, log.q, self.order, sigma, intensity, names)
        except InputError as error:
            raise InputError(f"{log.source}: {error}") from error

    def _given(self, key: str, log: Log) -> list[float | None]:
        given: Known = getattr(self, key)
        if not isinstance(given, Mapping):
            return [given] * len(log.joints)
        for name in given:
            if name not in log.joints:
                raise ConfigError(f"{key} names the joint {name!r}; the log has others; {choices(name, log.joints)}")
        return [given.get(name) for name in log.joints]
