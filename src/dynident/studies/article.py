"""The article's study, sec. 3: its scenarios, its three methods and any other, its published tables 2-7."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dynident.bounds import cramer_rao_bound
from dynident.errors import ConfigError, brief, choices
from dynident.estimators import Estimate, Estimator, LeastSquares, MaximumLikelihood, Problem
from dynident.io.families import ESTIMATORS, SMOOTHERS
from dynident.io.parts import build
from dynident.jobs import Limits, run_jobs
from dynident.kernel import kernel
from dynident.log import Log, Motion
from dynident.models import Model, Recording, record, simulate
from dynident.models.gallery import two_link_arm
from dynident.regression import Regression
from dynident.smoothers import Butterworth, Difference, Smoother, Spline
from dynident.smoothers.smoother import KnowsNoise
from dynident.studies.published_tables import PUBLISHED, Row
from dynident.studies.study import generator, run_study, statistics

__all__ = [
    "LEVELS", "METHODS", "SCENARIOS", "ArmScenario", "Case", "Reproduction", "SmoothAndFit", "arm_to_identify",
    "method_of", "reproduce",
]  # fmt: skip

Array = NDArray[np.float64]
T = TypeVar("T")
LEVELS = (1e-8, 1e-6, 1e-4)  # sigma_q^2, rad^2
PERIOD, SAMPLES = 0.0025, 4001  # Ts and the samples in <0, T>, T = 10 s
START = 0.25  # s: what is before is the transient


@dataclass(frozen=True)
class ArmScenario:
    """The two-link arm under u1 = A1 sin t, u2 = A2 cos t, from rest; torque noise of standard deviation sigma_tau.

    A noise level is the variance of the position noise, sigma_q^2.
    """

    name: str
    description: str
    amplitudes: tuple[float, float]
    sigma_tau: float

    @cached_property
    def truth(self) -> Motion:
        """The motion without noise, which is simulated once; workers get it with the scenario."""
        return _simulated(self.amplitudes)

    def bound(self, level: float) -> Array:
        """Return the least variances (7) of any unbiased method, with a known start from rest."""
        return _bound(self, level)

    def record(self, level: float, rng: np.random.Generator) -> Recording:
        """Return the recording with the noise of eqs. (44)-(46)."""
        return record(self.truth, np.sqrt(level), self.sigma_tau, rng, source=f"{self.name}, sigma_q^2 = {level:g}")


@cache
def arm_to_identify() -> Model:
    """Return the arm without its values: they are the true ones, which no estimator may start from or draw to."""
    terms: Any = two_link_arm().terms
    links, friction = terms
    unknowns = tuple(replace(one, value=None) for one in links.unknowns)
    return Model((replace(links, unknowns=unknowns), replace(friction, values=None)), two_link_arm().name)


def _simulated(amplitudes: tuple[float, float]) -> Motion:
    model = two_link_arm()
    first, second = amplitudes
    t = np.arange(SAMPLES) * PERIOD
    theta = np.asarray(model.values, dtype=float)
    return simulate(model, theta, lambda s: np.array([first * np.sin(s), second * np.cos(s)]), t)


@cache
def _bound(scenario: ArmScenario, level: float) -> Array:
    model = two_link_arm()
    theta = np.asarray(model.values, dtype=float)
    return np.diag(cramer_rao_bound(model, theta, scenario.truth, np.sqrt(level), scenario.sigma_tau, rest=True))


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
    """A method: smooth, leave out the samples before ``start`` (s), then estimate; in the article by eq. (11).

    A smoother that can be given the noise gets the true standard deviation of the positions, as in the article.
    ``early``: the samples are left out before smoothing, so that the transient does not affect the motion that is used.
    """

    name: str
    smoother: Smoother
    start: float = START
    early: bool = False
    estimator: Estimator = field(default_factory=LeastSquares)

    def log(self, recording: Recording) -> Log:
        """Return the log that is smoothed."""
        return recording.log.window(start=self.start - 1e-9) if self.early else recording.log

    def motion(self, recording: Recording) -> Motion:
        """Return the smoothed motion without the transient, or with it masked out."""
        motion = self.smoother_for(recording)(self.log(recording))
        return motion if self.early else motion.between(start=self.start - 1e-9)

    @property
    def description(self) -> str:
        """Description of the method for the settings of a report."""
        when = " before smoothing" if self.early else ""
        method = getattr(self.smoother, "method", type(self.smoother).__name__)
        fit = ESTIMATORS.kind_of(self.estimator).replace("_", " ")
        return f"{method}, samples before {self.start:g} s dropped{when}, {fit}"

    def smoother_for(self, recording: Recording) -> Smoother:
        """Return the smoother, with the noise level of the recording where it can be given one."""
        if not isinstance(self.smoother, KnowsNoise) or self.smoother.sigma is not None:
            return self.smoother
        given: Any = self.smoother
        sigma = dict(zip(recording.log.joints, recording.sigma_q.tolist(), strict=True))
        known: Smoother = replace(given, sigma=sigma)
        return known

    def estimate(self, recording: Recording) -> Estimate:
        """Estimate the seven parameters."""
        model = arm_to_identify()
        motions = (self.motion(recording),)
        return self.estimator(Problem(model, motions, Regression(model, motions), (self.log(recording),)))


SPLINE = Spline(ends=0.0)
METHODS: Mapping[str, SmoothAndFit] = {
    one.name: one
    for one in (
        SmoothAndFit("raw", Difference()),
        SmoothAndFit("filtered", Butterworth(settle=(0.0, 0.0)), 1.7475),
        SmoothAndFit("spline", SPLINE),
        SmoothAndFit("spline-early", SPLINE, early=True),
        SmoothAndFit("ml", SPLINE, estimator=MaximumLikelihood(start="rest")),
    )
}


def method_of(name: str) -> SmoothAndFit:
    """Return a method by its name: one of ``METHODS``, any kind of smoother, or of estimator on the article's spline.

    Raises ConfigError where there is none, or where the kind has settings without a default.
    """
    if name in METHODS:
        return METHODS[name]
    if name in SMOOTHERS.kinds():
        return SmoothAndFit(name, build(SMOOTHERS, {"kind": name}, "method"))
    _chosen(name, dict.fromkeys((*METHODS, *SMOOTHERS.kinds(), *ESTIMATORS.kinds())), "method")
    return SmoothAndFit(name, SPLINE, estimator=build(ESTIMATORS, {"kind": name}, "method"))


@dataclass(frozen=True, eq=False)
class Case:
    """One column of the tables: a method at a noise level, with the published numbers where there are any.

    ``mean`` and ``variance`` (7) over the runs, ``estimates`` (runs, 7), ``failed`` the number of failed fits,
    ``unsettled`` of those that did not converge; ``coverage`` (7) the share of the 95 % intervals that hold the true
    value.
    """

    sigma_q2: float
    method: str
    mean: Array
    variance: Array
    failed: int
    estimates: Array
    published_mean: Row | None = None
    published_variance: Row | None = None
    coverage: Array = field(default_factory=lambda: np.full(7, np.nan))
    unsettled: int = 0

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Reproduction:
    """The results of the article's study, run again. ``true`` (7) are the parameters of eq. (40).

    ``bounds`` maps a noise level to the least variances (7) that an unbiased method can reach there.
    """

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
    bounds: Mapping[float, Array] = field(default_factory=dict)

    __repr__ = brief

    def summary(self) -> dict[str, object]:
        """Return the numbers as plain data, for JSON; ``bound`` are least variances."""
        return {
            "scenario": self.scenario,
            "runs": self.runs,
            "seed": self.seed,
            "kernel": self.settings.get("kernel"),
            "true": self.true.tolist(),
            "cases": [
                {
                    "sigma_q2": case.sigma_q2,
                    "method": case.method,
                    "mean": case.mean.tolist(),
                    "variance": case.variance.tolist(),
                    "failed": case.failed,
                    "unsettled": case.unsettled,
                    "coverage": case.coverage.tolist(),
                    "bound": self.bounds[case.sigma_q2].tolist() if case.sigma_q2 in self.bounds else None,
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
    rerun: bool = False,
    limits: Limits | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005
) -> Reproduction:
    """Run sec. 3 of the article: three noise levels x the methods x ``runs`` recordings.

    ``path``, ``executor``, ``rerun``, ``limits`` and ``progress`` are ``run_study``'s. Raises ConfigError for an
    unknown scenario or method, InputError for a bad number of runs.
    """
    chosen = _chosen(scenario, SCENARIOS, "scenario")
    parts = [method_of(name) for name in dict.fromkeys(methods)]
    if not parts:
        raise ConfigError(f"no method is given. {choices('', METHODS)}")
    if not 0 <= seed < 2**63:
        raise ConfigError(f"seed is {seed}; give a whole number from 0 to 2^63 - 1.")
    model = two_link_arm()
    true = np.asarray(model.values, dtype=float)
    if executor is not None:
        chosen.truth  # noqa: B018 -- goes to the workers with it
    table = run_study(
        [chosen], parts, LEVELS, runs, seed,
        path=path, executor=executor, rerun=rerun, limits=limits, progress=progress,
    )  # fmt: skip
    cases = []
    for level in LEVELS:
        for part in parts:
            rows = table.filter((table["level"] == level) & (table["method"] == part.name))
            found = statistics(rows, len(model.parameters))
            published = PUBLISHED.get((level, part.name), (None, None))
            numbers = (found.mean, found.variance, found.failed, found.estimates)
            case = Case(level, part.name, *numbers, *published)
            cases.append(replace(case, coverage=found.coverage(true), unsettled=found.unsettled))
    return Reproduction(
        scenario=chosen.name,
        description=chosen.description,
        runs=runs,
        seed=seed,
        names=model.names,
        expressions=tuple(parameter.expression for parameter in model.parameters),
        true=true,
        seconds=float(table["seconds"].sum()),
        cases=tuple(cases),
        traces=_traces(chosen, parts, seed),
        settings=_settings(chosen, parts),
        bounds=_bounds(chosen, executor),
    )


def _bounds(scenario: ArmScenario, executor: Executor | None) -> dict[float, Array]:
    """Return the least variances by noise level; what no worker can compute raises its error here."""
    found = {done.job: done.value for done in run_jobs(scenario.bound, LEVELS, executor)}
    return {level: scenario.bound(level) if (one := found[level]) is None else one for level in LEVELS}


def _chosen(name: str, known: Mapping[str, T], what: str) -> T:
    if name not in known:
        raise ConfigError(f"unknown {what} {name!r}: {choices(name, known)}")
    return known[name]


def _traces(scenario: ArmScenario, methods: Sequence[SmoothAndFit], seed: int) -> dict[str, Motion]:
    """Return the motions of figures 2 and 3: the first recording at sigma_q^2 = 1e-6, by method that smooths."""
    recording = scenario.record(LEVELS[1], generator(seed, LEVELS[1], 0))
    smoothed = {one.name: one.motion(recording) for one in methods if isinstance(one.estimator, LeastSquares)}
    return {"simulated": recording.truth, **smoothed}


def _settings(scenario: ArmScenario, methods: Sequence[SmoothAndFit]) -> dict[str, str]:
    return {
        "arm": "planar, two links; l1 = l2 = 0.2675 m, lc1 = 0.0398 m, lc2 = 0.0392 m, m1 = 0.4347 kg, m2 = 0.4322 kg, "
        "I1 = I2 = 0.0024 kg m^2, mu1 = mu2 = 0.6189 N m s/rad, g = 9.81 m/s^2",
        "input": f"u1 = {scenario.amplitudes[0]:g} sin t, u2 = {scenario.amplitudes[1]:g} cos t N m, from rest",
        "recording": f"{SAMPLES} samples, one each {PERIOD:g} s; sigma_tau = {scenario.sigma_tau:g} N m",
        **{f"method {method.name}": method.description for method in methods},
        "kernel": str(kernel()),
    }
