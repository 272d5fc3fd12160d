"""The study of the article, sec. 3: its scenarios, its three methods and any other, its published tables 2-7."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from dynident.apps.article.study import Statistics, generator, run_study, statistics
from dynident.estimators import Estimate, Estimator, LeastSquares, Problem
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.identification import cramer_rao_bound
from dynident.models import Model
from dynident.models.lagrangian import two_link_arm
from dynident.models.simulation import Recording, record, simulate
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Butterworth, Difference, Smoother, Spline
from dynident.project.parts import build
from dynident.regression import Regression
from dynident.runtime import ConfigError, Noun, brief, choices
from dynident.runtime.arrays import Array
from dynident.runtime.families import ESTIMATORS, SMOOTHERS
from dynident.runtime.jobs import Limits, run_jobs
from dynident.runtime.kernel import kernel

Row = tuple[float | None, ...]
NONE3: Row = (None, None, None)

# By sigma_q^2 and method: tables 2, 4, 6 (means) and 3, 5, 7 (variances); None where only an order of magnitude is
# printed.
PUBLISHED: Mapping[tuple[float, str], tuple[Row, Row]] = {
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
        (*NONE3, 0.0002e-4, 0.0001e-4, 0.1537e-4, 0.0511e-4),
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
        (*NONE3, 0.1225, 0.0202, 0.0179, 0.0279),
        (*NONE3, 0.0024e-6, 0.0007e-6, 0.1526e-6, 0.9735e-6),
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


T = TypeVar("T")
LEVELS = (1e-8, 1e-6, 1e-4)  # sigma_q^2, rad^2
SAMPLING_PERIOD, N_SAMPLES = 0.0025, 4001  # Ts and the samples in <0, T>, T = 10 s
TRANSIENT_END = 0.25  # s: what is before is the transient
SPLINE = Spline(ends=0.0)


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
        (A1, A2), model = self.amplitudes, two_link_arm()
        t = np.arange(N_SAMPLES) * SAMPLING_PERIOD
        theta = np.asarray(model.values, dtype=float)
        return simulate(model, theta, lambda s: np.array([A1 * np.sin(s), A2 * np.cos(s)]), t)

    def bound(self, level: float) -> Array:
        """Return the Cramer-Rao bound (7) of the variances, with a known start from rest."""
        return _cached_bound(self, level)

    def record(self, level: float, rng: np.random.Generator) -> Recording:
        """Return the recording with the noise of eqs. (44)-(46)."""
        return record(self.truth, np.sqrt(level), self.sigma_tau, rng, source=f"{self.name}, sigma_q^2 = {level:g}")


@cache
def arm_to_identify() -> Model:
    """Return the arm without its parameter values: these are the true ones, which no estimator may use."""
    terms: Any = two_link_arm().terms
    links, friction = terms
    unknowns = tuple(replace(unknown, value=None) for unknown in links.unknowns)
    return Model((replace(links, unknowns=unknowns), replace(friction, values=None)), two_link_arm().name)


@cache
def _cached_bound(scenario: ArmScenario, level: float) -> Array:
    model = two_link_arm()
    theta = np.asarray(model.values, dtype=float)
    return np.diag(cramer_rao_bound(model, theta, scenario.truth, np.sqrt(level), scenario.sigma_tau, rest=True))


_WORDS = {
    "tabulated": "Amplitudes 1.13 and 0.78 N m and torque noise of standard deviation 1e-2 N m: "
    "the inputs that give the article's tables (the printed ones do not)",
    "stated": "Amplitudes 6 and 4 N m and torque noise of variance 1e-2 N^2 m^2, as printed",
    "weak": "The amplitudes of the tables, 1.13 and 0.78 N m, with the printed torque-noise variance 1e-2 N^2 m^2",
}
_INPUTS = {"tabulated": ((1.13, 0.78), 1e-2), "stated": ((6.0, 4.0), 1e-1), "weak": ((1.13, 0.78), 1e-1)}
SCENARIOS: Mapping[str, ArmScenario] = {name: ArmScenario(name, _WORDS[name], *_INPUTS[name]) for name in _INPUTS}


@dataclass(frozen=True)
class SmoothAndFit:
    """A method: smooth, leave out the samples before ``start`` (s), then estimate; in the article by eq. (11).

    A smoother that takes the noise level gets the true standard deviation of the positions, as in the article.
    With ``drop_before_smoothing`` the samples are left out before smoothing, so that the transient does not
    affect the motion.
    """

    name: str
    smoother: Smoother
    start: float = TRANSIENT_END
    drop_before_smoothing: bool = False
    estimator: Estimator = field(default_factory=LeastSquares)

    def log(self, recording: Recording) -> Log:
        """Return the log that is smoothed."""
        return recording.log.window(start=self.start - 1e-9) if self.drop_before_smoothing else recording.log

    def motion(self, recording: Recording) -> Motion:
        """Return the smoothed motion without the transient, or with it masked out."""
        motion = self.smoother_for(recording)(self.log(recording))
        return motion if self.drop_before_smoothing else motion.select_between(start=self.start - 1e-9)

    @property
    def description(self) -> str:
        """Description of the method for the settings of a report."""
        when = " before smoothing" if self.drop_before_smoothing else ""
        method = getattr(self.smoother, "method", type(self.smoother).__name__)
        fit = ESTIMATORS.kind_of(self.estimator).replace("_", " ")
        return f"{method}, samples before {self.start:g} s dropped{when}, {fit}"

    def smoother_for(self, recording: Recording) -> Smoother:
        """Return the smoother, with the noise level of the recording where it can be given one."""
        # the noise is known in a simulation, as in the article
        return self.smoother.with_noise(dict(zip(recording.log.joints, recording.sigma_q.tolist(), strict=True)))

    def estimate(self, recording: Recording) -> Estimate:
        """Estimate the seven parameters."""
        model = arm_to_identify()
        motions = (self.motion(recording),)
        return self.estimator(Problem(model, motions, Regression(model, motions), (self.log(recording),)))


METHODS: Mapping[str, SmoothAndFit] = {
    method.name: method
    for method in (
        SmoothAndFit("raw", Difference()),
        SmoothAndFit("filtered", Butterworth(settle=(0.0, 0.0)), 1.7475),
        SmoothAndFit("spline", SPLINE),
        SmoothAndFit("spline-early", SPLINE, drop_before_smoothing=True),
        SmoothAndFit("ml", SPLINE, estimator=MaximumLikelihood(start="rest")),
    )
}


def method_of(name: str) -> SmoothAndFit:
    """Return a method by name: one of ``METHODS``, a kind of smoother, or an estimator on the article's spline.

    Raises ConfigError where there is none, or where the kind has settings without a default.
    """
    if name in METHODS:
        return METHODS[name]
    if name in SMOOTHERS.kinds():
        return SmoothAndFit(name, build(SMOOTHERS, {"kind": name}, "method"))
    _look_up(name, dict.fromkeys((*METHODS, *SMOOTHERS.kinds(), *ESTIMATORS.kinds())), "method")
    return SmoothAndFit(name, SPLINE, estimator=build(ESTIMATORS, {"kind": name}, "method"))


@dataclass(frozen=True, eq=False, kw_only=True)
class StudyCase(Statistics):
    """One column of the tables: the statistics of a method at a noise level, beside the published numbers, if any.

    ``coverage`` (7) is the share of the 95 % intervals that hold the true value.
    """

    sigma_q2: float
    method: str
    coverage: Array
    published_mean: Row | None = None
    published_variance: Row | None = None

    __repr__ = brief


class Reproduction(Noun):
    """The results of the article's study, run again. ``true`` (7) are the parameters of eq. (40).

    ``bounds`` maps a noise level to the least variances (7) that an unbiased method can reach.
    """

    scenario: str
    description: str
    runs: int
    seed: int
    names: tuple[str, ...]
    expressions: tuple[str, ...]
    true: Array
    seconds: float
    cases: tuple[StudyCase, ...]
    traces: Mapping[str, Motion]
    settings: Mapping[str, str]
    bounds: Mapping[float, Array] = field(default_factory=dict)

    def summary(self) -> dict[str, object]:
        """Return the numbers as plain data, for JSON; ``bound`` are least variances."""
        return {
            "scenario": self.scenario,
            "runs": self.runs,
            "seed": self.seed,
            "kernel": self.settings.get("kernel"),
            "true": self.true.tolist(),
            "cases": [
                {name: getattr(case, name) for name in ("sigma_q2", "method", "failed", "unsettled")}
                | {name: getattr(case, name).tolist() for name in ("mean", "variance", "coverage")}
                | {"bound": self.bounds[case.sigma_q2].tolist() if case.sigma_q2 in self.bounds else None}
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
) -> Reproduction:
    """Run sec. 3 of the article: three noise levels x the methods x ``runs`` recordings.

    ``path``, ``executor``, ``rerun`` and ``limits`` are ``run_study``'s. Raises ConfigError for an
    unknown scenario or method, InputError for a bad number of runs.
    """
    arm_scenario = _look_up(scenario, SCENARIOS, "scenario")
    fit_methods = [method_of(name) for name in dict.fromkeys(methods)]
    if not fit_methods:
        raise ConfigError(f"no method is given. {choices('', METHODS)}")
    if not 0 <= seed < 2**63:
        raise ConfigError(f"seed is {seed}; give a whole number from 0 to 2^63 - 1.")
    model = two_link_arm()
    true = np.asarray(model.values, dtype=float)
    if executor is not None:
        arm_scenario.truth  # noqa: B018 -- goes to the workers with it
    table = run_study(
        [arm_scenario], fit_methods, LEVELS, runs, seed,
        path=path, executor=executor, rerun=rerun, limits=limits,
    )  # fmt: skip
    # one case for each column of the tables, with the numbers of the article beside it
    cases = []
    for level in LEVELS:
        for method in fit_methods:
            rows = table.filter((table["level"] == level) & (table["method"] == method.name))
            sample = statistics(rows, len(model.parameters))
            mean, variance = PUBLISHED.get((level, method.name), (None, None))
            cases.append(
                StudyCase(
                    **vars(sample), sigma_q2=level, method=method.name, coverage=sample.covered_share(true),
                    published_mean=mean, published_variance=variance,
                )
            )  # fmt: skip
    expressions = tuple(parameter.expression for parameter in model.parameters)
    return Reproduction(
        arm_scenario.name, arm_scenario.description, runs, seed, model.names, expressions, true,
        float(table["seconds"].sum()), tuple(cases), _traces(arm_scenario, fit_methods, seed),
        _study_settings(arm_scenario, fit_methods), _bounds(arm_scenario, executor),
    )  # fmt: skip


def _bounds(scenario: ArmScenario, executor: Executor | None) -> dict[float, Array]:
    """Return the least variances by noise level; an error that no worker could report is raised here."""
    variances = {finished_job.job: finished_job.value for finished_job in run_jobs(scenario.bound, LEVELS, executor)}
    return {level: scenario.bound(level) if (variance := variances[level]) is None else variance for level in LEVELS}


def _look_up(name: str, options: Mapping[str, T], kind: str) -> T:
    if name not in options:
        raise ConfigError(f"unknown {kind} {name!r}: {choices(name, options)}")
    return options[name]


def _traces(scenario: ArmScenario, methods: Sequence[SmoothAndFit], seed: int) -> dict[str, Motion]:
    """Return the motions of figures 2 and 3: the first recording at sigma_q^2 = 1e-6, by method.

    Only methods that estimate by least squares on a smoothed motion are shown.
    """
    recording = scenario.record(LEVELS[1], generator(seed, LEVELS[1], 0))
    shown = (method for method in methods if isinstance(method.estimator, LeastSquares))
    return {"simulated": recording.truth} | {method.name: method.motion(recording) for method in shown}


def _study_settings(scenario: ArmScenario, methods: Sequence[SmoothAndFit]) -> dict[str, str]:
    return {
        "arm": "planar, two links; l1 = l2 = 0.2675 m, lc1 = 0.0398 m, lc2 = 0.0392 m, m1 = 0.4347 kg, m2 = 0.4322 kg, "
        "I1 = I2 = 0.0024 kg m^2, mu1 = mu2 = 0.6189 N m s/rad, g = 9.81 m/s^2",
        "input": f"u1 = {scenario.amplitudes[0]:g} sin t, u2 = {scenario.amplitudes[1]:g} cos t N m, from rest",
        "recording": f"{N_SAMPLES} samples, one each {SAMPLING_PERIOD:g} s; sigma_tau = {scenario.sigma_tau:g} N m",
        **{f"method {method.name}": method.description for method in methods},
        "kernel": str(kernel()),
    }


# workers import this module once for all: SymPy finds and compiles the functions of the arm here, not in each fit
arm_to_identify().regressor(*np.zeros((3, 1, 2)))
