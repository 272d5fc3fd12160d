"""The article's method: a Reinsch smoothing spline per joint, differentiated analytically."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt

from dynident.motion.log import Log, Motion
from dynident.motion.smoothers.smoother import BY_JOINT, Smoother, at_rest, ends_mask, make_motion, position_noise
from dynident.motion.splines import GCV, REML, RULES, Constraint, Fixed, Interpolation, Rule, smooth
from dynident.runtime import ConfigError, InputError, setting_text, settings_text, short

# multiples of the noise estimate that "torque" chooses from
NOISE_FACTORS = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0)
RuleName = Literal["constraint", "gcv", "reml", "interpolate", "fixed"]
# for all joints alike, or in their order
PerJointSetting = Annotated[float, Ge(0)] | tuple[Annotated[float, Ge(0)], ...]


@dataclass(frozen=True)
class SplineSettings:
    """The settings of a ``Spline``, by the name of its rule.

    ``S`` belongs to "constraint", ``p`` or ``lam`` to "fixed". "torque" gives several splines to choose from, with
    increasing multiples of the noise.
    """

    rule: Literal[RuleName, "torque"] = "constraint"
    S: PerJointSetting | None = None
    p: PerJointSetting | None = None
    lam: PerJointSetting | None = None
    sigma: Annotated[Annotated[float, Gt(0)] | Mapping[str, Annotated[float, Gt(0)]] | None, BY_JOINT] = None
    ends: Annotated[float, Ge(0)] = 6.0
    factor: Annotated[Annotated[float, Gt(0)] | Mapping[str, Annotated[float, Gt(0)]], BY_JOINT] = 1.0

    def __post_init__(self) -> None:
        given_settings = [name for name in ("p", "lam") if getattr(self, name) is not None]
        if self.rule == "fixed" and len(given_settings) != 1:
            raise ConfigError("`rule: fixed` needs either `p` or `lam`")
        if self.rule != "fixed" and given_settings:
            raise ConfigError(f"`{given_settings[0]}` is only used by `rule: fixed`, not by `rule: {self.rule}`")
        if self.rule != "constraint" and self.S is not None:
            raise ConfigError(f"`S` is only used by `rule: constraint`, not by `rule: {self.rule}`")

    @classmethod
    def of(cls, part: Spline) -> SplineSettings:
        """Return the settings that build ``part``; ConfigError for a rule of another package."""
        name: Any = next((name for name, rule in RULES.items() if type(part.rule) is rule), None)
        if name is None:
            raise ConfigError(f"the rule {part.rule!r} has no name in a configuration.")
        rule_settings: dict[str, Any] = {
            key: value if value is None or np.isscalar(value) else tuple(value)
            for key, value in vars(part.rule).items()
        }
        return cls(name, **rule_settings, sigma=part.sigma, ends=part.ends, factor=part.factor)

    def build(self) -> Spline | tuple[Spline, ...]:
        """Return the spline, or those that ``rule`` "torque" chooses from."""
        if self.rule == "torque":
            factor = self.factor
            factors = (
                {name: k * size for name, size in factor.items()} if isinstance(factor, Mapping) else k * factor
                for k in NOISE_FACTORS
            )
            return tuple(Spline(Constraint(), self.sigma, self.ends, factor) for factor in factors)
        rule_settings: Any = {"constraint": {"S": self.S}, "fixed": {"p": self.p, "lam": self.lam}}
        rule = RULES[self.rule](**rule_settings.get(self.rule, {}))
        return Spline(rule, self.sigma, self.ends, self.factor)


RULE_TEXTS: Mapping[type[Rule], str] = {
    GCV: "generalised cross-validation",
    REML: "restricted maximum likelihood",
    Interpolation: "interpolated",
    Fixed: "lam as given",
}


@dataclass(frozen=True)
class Spline(Smoother):
    """Smooth each joint's position by a natural cubic spline and take dq and ddq from it, eqs. (34)-(36).

    ``rule`` chooses how much to smooth (default: ``Constraint()``, S = n). The position noise is ``factor`` times
    ``sigma`` (rad, m): either is one number, or a mapping by joint name (joints that it lacks have the factor 1); None
    as ``sigma`` estimates it from the data. With S = n, S is ``factor``^2 n in terms of sigma. The mask leaves out
    ``ends`` times the bandwidth of the widest kernel, plus one step, at both ends, where the natural spline's zero
    acceleration biases the derivatives: after k bandwidths exp(-k / sqrt 2) of the bias is left, 1.4 % at 6.

    Calling it returns a ``Motion``. Raises ConfigError for bad settings or unknown joints, and InputError where the
    log is too short or cannot be smoothed.

    >>> import numpy as np
    >>> import dynident as dy
    >>> t = np.arange(1001) * 0.01
    >>> q = np.sin(t) + 1e-3 * np.random.default_rng(0).standard_normal(1001)
    >>> log = dy.Log(t, q[:, None], tau=np.cos(t)[:, None], joints=("hinge",))
    >>> motion = dy.Spline(sigma=1e-3)(log)
    >>> motion
    <Motion 'log': 1001 samples of hinge; 0 to 10 s, 100 Hz; 869 usable; natural cubic smoothing spline, S = n>
    >>> print(f"error of the velocity {np.abs(motion.dq[:, 0] - np.cos(t))[motion.mask].max():.3f} rad/s")
    error of the velocity 0.003 rad/s
    """

    rule: Rule = field(default_factory=Constraint)
    sigma: float | Mapping[str, float] | None = None
    ends: Annotated[float, Ge(0)] = 6.0
    factor: Annotated[Annotated[float, Gt(0)] | Mapping[str, Annotated[float, Gt(0)]], BY_JOINT] = 1.0
    Settings: ClassVar[type[SplineSettings]]

    @property
    def method(self) -> str:
        """The method in words."""
        is_scaled = isinstance(self.factor, int | float) and self.factor != 1.0 and self.rule.needs_sigma
        factor_text = f" at {self.factor:.3g} times the noise" if is_scaled else ""
        rule = self.rule
        if isinstance(rule, Constraint):
            rule_text = "S = n" if rule.S is None else "S as given"
        else:
            rule_text = RULE_TEXTS.get(type(rule), type(rule).__name__)
        return f"natural cubic smoothing spline, {rule_text}{factor_text}"

    def __call__(self, log: Log) -> Motion:
        """Smooth; ``smoothing`` holds per joint sigma, S, lam, edf, the noise left, bandwidth (s) and cut-off (Hz)."""
        try:
            names = [f"joint {name!r}" for name in log.joints]
            fit = smooth(log.t, log.q, self.rule, sigma=self._sigma(log), names=names)
        except InputError as error:
            raise InputError(f"{log.source}: {error}") from error
        widths = fit.bandwidth[np.isfinite(fit.bandwidth)]
        # the natural spline has no acceleration at its ends: mask what this bias reaches
        reach = self.ends * (float(widths.max(initial=0.0)) + float(np.diff(log.t).mean()))
        keys = ("sigma", "S", "lam", "edf", "noise", "bandwidth", "cutoff")
        smoothing: dict[str, object] = {name: tuple(map(float, getattr(fit, name))) for name in keys}
        smoothing["method"] = self.method
        mask = ends_mask(log, reach, reach)
        channels = fit.values, fit.derivative(1), fit.derivative(2)
        return make_motion(log, channels, mask, smoothing, at_rest(log.q, fit.values, fit.noise))

    def as_used(self, motion: Motion) -> Spline:
        """Return the spline with the lam, for each joint, that it has used for a motion."""
        lam, sigma = (motion.smoothing[name] for name in ("lam", "sigma"))
        return Spline(Fixed(lam=tuple(lam)), dict(zip(motion.joints, sigma, strict=True)), self.ends)

    def _sigma(self, log: Log) -> list[float] | float | None:
        if self.factor == 1.0 and not isinstance(self.sigma, Mapping):
            return self.sigma
        factors, sigmas = self.by_joint("factor", log), self.by_joint("sigma", log)
        estimate = position_noise(log).tolist() if None in sigmas else sigmas
        noise = [number if sigma is None else sigma for sigma, number in zip(sigmas, estimate, strict=True)]
        return [float(sigma) * (1.0 if k is None else float(k)) for k, sigma in zip(factors, noise, strict=True)]

    def __str__(self) -> str:
        rule, extras = self.rule, [f"noise {setting_text(self.sigma)} rad or m"] if self.sigma is not None else []
        ends = [] if self.ends == 6.0 else [f"{self.ends:g} bandwidths left out at the ends"]
        if isinstance(rule, Constraint):
            how = _smoothing_degree(rule, self.factor)
        else:
            is_criterion = type(rule) in (GCV, REML)
            how = f"by {RULE_TEXTS[type(rule)]}" if is_criterion else settings_text(type(rule).__name__, rule)
            is_scaled = self.factor != 1.0 and not isinstance(rule, Fixed)
            extras += [f"{setting_text(self.factor)} times the noise"] * is_scaled
        if isinstance(rule, Interpolation):
            return ", ".join(["interpolating spline", *ends])
        if isinstance(rule, Fixed):
            how = "p" if rule.p is not None else "lam"
            how = f"{how} {setting_text(getattr(rule, how))}"
        return ", ".join([f"smoothing spline, {how}", *extras, *ends])


Spline.Settings = SplineSettings


def _smoothing_degree(rule: Constraint, factor: object) -> str:
    """Return how much a spline smooths: S by the number of samples and the noise of the positions."""
    if rule.S is not None:
        times = "" if factor == 1.0 else f", {setting_text(factor)} times the noise"
        return f"S = {setting_text(rule.S)}{times}"
    if isinstance(factor, int | float):
        return "S = n" if factor == 1.0 else f"S = {short(factor**2)} n ({short(factor)} times the noise)"
    return f"S = n at {setting_text(factor)} times the noise"
