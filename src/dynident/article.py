"""The article's study, sec. 3: its scenarios, its three methods, its printed tables 2-7."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, choices
from dynident.estimators import Estimate, LeastSquares, Problem
from dynident.gallery import two_link_arm
from dynident.log import Motion
from dynident.regression import Regression
from dynident.simulation import Recording, record, simulate
from dynident.smoothers import Butterworth, Difference, Smoother, Spline
from dynident.study import generator, run_study, statistics

__all__ = ["LEVELS", "METHODS", "SCENARIOS", "ArmScenario", "Case", "Reproduction", "SmoothAndFit", "reproduce"]

Array = NDArray[np.float64]
T = TypeVar("T")
LEVELS = (1e-8, 1e-6, 1e-4)  # sigma_q^2, rad^2
PERIOD, SAMPLES = 0.0025, 4001  # Ts and the samples in <0, T>, T = 10 s


@dataclass(frozen=True)
class ArmScenario:
    """The two-link arm under u1 = A1 sin t, u2 = A2 cos t, from rest; torque noise of standard deviation sigma_tau.

    A noise level is the variance of the position noise, sigma_q^2.
    """

    name: str
    description: str
    amplitudes: tuple[float, float]
    sigma_tau: float

    def truth(self) -> Motion:
        """Return the motion without noise."""
        return _truth(self.amplitudes)

    def record(self, level: float, rng: np.random.Generator) -> Recording:
        """Return the recording with the noise of eqs. (44)-(46)."""
        return record(self.truth(), np.sqrt(level), self.sigma_tau, rng, source=f"{self.name}, sigma_q^2 = {level:g}")


@cache
def _truth(amplitudes: tuple[float, float]) -> Motion:
    model = two_link_arm()
    first, second = amplitudes
    t = np.arange(SAMPLES) * PERIOD
    theta = np.asarray(model.values, dtype=float)
    return simulate(model, theta, lambda s: np.array([first * np.sin(s), second * np.cos(s)]), t)


SCENARIOS: Mapping[str, ArmScenario] = {
    one.name: one
    for one in (
        ArmScenario(
            "tabulated",
            "Amplitudes 1.13 and 0.78 N m and torque noise of standard deviation 1e-2 N m: "
            "the inputs that give the article's tables (the printed ones do not)",
            (1.13, 0.78),
            1e-2,
        ),
        ArmScenario(
            "stated", "Amplitudes 6 and 4 N m and torque noise of variance 1e-2 N^2 m^2, as printed", (6.0, 4.0), 1e-1
        ),
        ArmScenario(
            "weak",
            "The amplitudes of the tables, 1.13 and 0.78 N m, with the printed torque-noise variance 1e-2 N^2 m^2",
            (1.13, 0.78),
            1e-1,
        ),
    )
}


@dataclass(frozen=True)
class SmoothAndFit:
    """A method of the article: smooth, leave out the samples before ``start`` (s), then least squares, eq. (11).

    ``knows_sigma``: the smoother is told the standard deviation of the position noise, as the article does.
    """

    name: str
    smoother: Smoother
    start: float

    def motion(self, recording: Recording) -> Motion:
        """Return the smoothed motion with the transient masked out."""
        return self.smoother_for(recording)(recording.log).between(start=self.start - 1e-9)

    def smoother_for(self, recording: Recording) -> Smoother:
        """Return the smoother; a spline is told the noise that the recording was made with."""
        if not isinstance(self.smoother, Spline) or self.smoother.sigma is not None:
            return self.smoother
        sigma = dict(zip(recording.log.joints, recording.sigma_q.tolist(), strict=True))
        return Spline(self.smoother.rule, sigma, self.smoother.ends)

    def estimate(self, recording: Recording) -> Estimate:
        """Estimate the seven parameters."""
        model = two_link_arm()
        motions = (self.motion(recording),)
        return LeastSquares()(Problem(model, motions, Regression(model, motions)))


METHODS: Mapping[str, SmoothAndFit] = {
    one.name: one
    for one in (
        SmoothAndFit("raw", Difference(), 0.25),
        SmoothAndFit("filtered", Butterworth(settle=(0.0, 0.0)), 1.7475),
        SmoothAndFit("spline", Spline(ends=0.0), 0.25),
    )
}

# Printed tables 2, 4, 6 (means) and 3, 5, 7 (variances); None where only an order of magnitude is printed.
_Row = tuple[float | None, ...]
_NONE3: _Row = (None, None, None)
PRINTED: Mapping[tuple[float, str], tuple[_Row, _Row]] = {
    (1e-8, "raw"): (
        (0.0010, 0.0005, -0.0005, 0.1282, 0.0165, 0.6158, 0.6200),
        (0.0447e-8, 0.0086e-8, 0.0283e-8, 0.0008e-8, 0.0004e-8, 0.3448e-8, 0.1180e-8),
    ),
    (1e-8, "filtered"): (
        (0.0361, 0.0021, 0.0042, 0.1331, 0.0168, 0.6206, 0.6190),
        (0.1894e-6, 0.0382e-6, 0.0019e-6, 0.0015e-6, 0.0011e-6, 0.0125e-6, 0.0004e-6),
    ),
    (1e-8, "spline"): (
        (0.0359, 0.0031, 0.0043, 0.1331, 0.0169, 0.6210, 0.6191),
        (0.0182e-5, 0.1022e-5, 0.0001e-5, 0.0001e-5, 0.0011e-5, 0.0151e-5, 0.0003e-5),
    ),
    (1e-6, "raw"): (
        (0.0007, 0.0004, -0.0004, 0.1255, 0.0183, 0.4561, 0.5126),
        (*_NONE3, 0.0002e-4, 0.0001e-4, 0.1537e-4, 0.0511e-4),
    ),
    (1e-6, "filtered"): (
        (0.0330, 0.0029, 0.0045, 0.1328, 0.0169, 0.6207, 0.6192),
        (0.1736e-5, 0.0026e-5, 0.0007e-5, 0.0018e-5, 0.0001e-5, 0.0013e-5, 0.0002e-5),
    ),
    (1e-6, "spline"): (
        (0.0366, 0.0024, 0.0041, 0.1331, 0.0168, 0.6209, 0.6192),
        (0.3771e-4, 0.0036e-4, 0.0023e-4, 0.0032e-4, 0.0003e-4, 0.0038e-4, 0.0002e-4),
    ),
    (1e-4, "raw"): (
        (*_NONE3, 0.1225, 0.0202, 0.0179, 0.0279),
        (*_NONE3, 0.0024e-6, 0.0007e-6, 0.1526e-6, 0.9735e-6),
    ),
    (1e-4, "filtered"): (
        (0.0131, 0.0051, 0.0054, 0.1308, 0.0173, 0.6211, 0.6188),
        (0.2434e-3, 0.0038e-3, 0.0017e-3, 0.0019e-3, 0.0001e-3, 0.0023e-3, 0.0003e-3),
    ),
    (1e-4, "spline"): (
        (0.0454, -0.0032, 0.0030, 0.1338, 0.0158, 0.6209, 0.6206),
        (0.0016, 0.0001, None, None, None, None, None),
    ),
}


@dataclass(frozen=True, eq=False)
class Case:
    """One column of the tables: a method at a noise level, with the printed numbers where there are any.

    ``mean`` and ``variance`` (7) over the runs, ``estimates`` (runs, 7), ``failed`` the number of failed fits.
    """

    sigma_q2: float
    method: str
    mean: Array
    variance: Array
    failed: int
    estimates: Array
    printed_mean: _Row | None = None
    printed_variance: _Row | None = None


@dataclass(frozen=True, eq=False)
class Reproduction:
    """The article's study, run again: what the report reads. ``true`` (7) are the parameters of eq. (40)."""

    scenario: str
    description: str
    runs: int
    seed: int
    names: tuple[str, ...]
    expressions: tuple[str, ...]
    true: Array
    seconds: float
    cases: tuple[Case, ...]
    traces: Mapping[str, Motion]
    settings: Mapping[str, str]

    def summary(self) -> dict[str, object]:
        """Return the numbers as plain data, for JSON."""
        return {
            "scenario": self.scenario,
            "runs": self.runs,
            "seed": self.seed,
            "true": self.true.tolist(),
            "cases": [
                {
                    "sigma_q2": case.sigma_q2,
                    "method": case.method,
                    "mean": case.mean.tolist(),
                    "variance": case.variance.tolist(),
                    "failed": case.failed,
                }
                for case in self.cases
            ],
        }


def reproduce(
    scenario: str = "tabulated",
    runs: int = 30,
    seed: int = 0,
    methods: Sequence[str] = ("raw", "filtered", "spline"),
    *,
    path: str | Path | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005
) -> Reproduction:
    """Run sec. 3 of the article: three noise levels x the methods x ``runs`` recordings.

    ``path``, ``executor`` and ``progress`` are ``run_study``'s. Raises ConfigError for an unknown scenario or method,
    InputError for a bad number of runs.
    """
    chosen = _chosen(scenario, SCENARIOS, "scenario")
    parts = [_chosen(name, METHODS, "method") for name in dict.fromkeys(methods)]
    if not parts:
        raise ConfigError(f"no method is given. {choices('', METHODS)}")
    if not 0 <= seed < 2**63:
        raise ConfigError(f"seed is {seed}; give a whole number from 0 to 2^63 - 1.")
    model = two_link_arm()
    table = run_study([chosen], parts, LEVELS, runs, seed, path=path, executor=executor, progress=progress)
    cases = []
    for level in LEVELS:
        for part in parts:
            rows = table.filter((table["level"] == level) & (table["method"] == part.name))
            found = statistics(rows, len(model.parameters))
            printed = PRINTED.get((level, part.name), (None, None))
            numbers = (found.mean, found.variance, found.failed, found.estimates)
            cases.append(Case(level, part.name, *numbers, *printed))
    return Reproduction(
        scenario=chosen.name,
        description=chosen.description,
        runs=runs,
        seed=seed,
        names=model.names,
        expressions=tuple(parameter.expression for parameter in model.parameters),
        true=np.asarray(model.values),
        seconds=float(table["seconds"].sum()),
        cases=tuple(cases),
        traces=_traces(chosen, parts, seed),
        settings=_settings(chosen, parts),
    )


def _chosen(name: str, known: Mapping[str, T], what: str) -> T:
    if name not in known:
        raise ConfigError(f"unknown {what} {name!r}: {choices(name, known)}")
    return known[name]


def _traces(scenario: ArmScenario, methods: Sequence[SmoothAndFit], seed: int) -> dict[str, Motion]:
    """Return the motions of figures 2 and 3: the first recording at sigma_q^2 = 1e-6, by method."""
    recording = scenario.record(LEVELS[1], generator(seed, LEVELS[1], 0))
    return {"simulated": recording.truth, **{method.name: method.motion(recording) for method in methods}}


def _settings(scenario: ArmScenario, methods: Sequence[SmoothAndFit]) -> dict[str, str]:
    return {
        "arm": "planar, two links; l1 = l2 = 0.2675 m, lc1 = 0.0398 m, lc2 = 0.0392 m, m1 = 0.4347 kg, m2 = 0.4322 kg, "
        "I1 = I2 = 0.0024 kg m^2, mu1 = mu2 = 0.6189 N m s/rad, g = 9.81 m/s^2",
        "input": f"u1 = {scenario.amplitudes[0]:g} sin t, u2 = {scenario.amplitudes[1]:g} cos t N m, from rest",
        "recording": f"{SAMPLES} samples, one each {PERIOD:g} s; sigma_tau = {scenario.sigma_tau:g} N m",
        **{
            f"method {method.name}": f"{method.smoother}, samples before {method.start:g} s dropped"
            for method in methods
        },
    }
