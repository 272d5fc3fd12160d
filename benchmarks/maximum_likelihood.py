"""Maximum likelihood on the article's arm against the Cramer-Rao bound: python3 benchmarks/maximum_likelihood.py.

Each run smooths a fresh recording, as ``dynident identify`` does, and estimates from there; nothing is told of the
noise. Per parameter: root mean square error over the bound, mean error in its standard errors, and how many 95 %
intervals cover the truth. Times are CPU times of smoothing and estimation, with one BLAS thread.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import dataclass
from typing import Literal, get_args

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from scipy.special import ndtri

from dynident.apps.article import LEVELS, SCENARIOS, ArmScenario
from dynident.estimators import Problem
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.identification import cramer_rao_bound
from dynident.models.lagrangian import two_link_arm
from dynident.motion.smoothers import Spline
from dynident.regression import Regression

Start = Literal["rest", "free", "test"]
FAMILY = 0.01  # chance that any mean error of a whole table is called a bias where there is none


@dataclass(frozen=True)
class Result:
    """Errors (N, p), whether intervals cover (N, p), converged (N), and seconds of each run (N)."""

    error: np.ndarray
    covers: np.ndarray
    converged: np.ndarray
    negative: int
    seconds: np.ndarray


def repeat(scenario: ArmScenario, level: float, runs: int, seed: int, start: Start) -> Result:
    arm, estimator = two_link_arm(), MaximumLikelihood(start=start)
    truth, rows = np.array(arm.values), []
    inertia = [k for k, one in enumerate(arm.parameters) if one.unit == "kg m^2"][:2]
    for rng in np.random.default_rng([seed, round(-10 * np.log10(level))]).spawn(runs):
        log = scenario.record(level, rng).log
        began = time.process_time()
        motions = (Spline()(log),)
        found = estimator(Problem(arm, motions, Regression(arm, motions), (log,)))
        took = time.process_time() - began
        ends = (
            found.interval if found.interval is not None else found.value[:, None] + 1.96 * np.outer(found.std, [-1, 1])
        )
        covers = (ends[:, 0] <= truth) & (truth <= ends[:, 1])
        rows.append((found.value - truth, covers, not found.notes, (found.value[inertia] <= 0).any(), took))
    error, covers, converged, negative, seconds = map(np.array, zip(*rows, strict=True))
    return Result(error, covers, converged, int(negative.sum()), seconds)


def tell(name: str, level: float, done: Result, least: np.ndarray, cases: int) -> None:
    N, p = done.error.shape
    limit = -ndtri(FAMILY / (2 * p * cases))
    z = done.error.mean(axis=0) / (done.error.std(axis=0, ddof=1) / np.sqrt(N))
    print(f"{name}, sigma_q^2 = {level:g}, {N} runs")
    print("  RMSE / bound ", np.array2string(np.sqrt((done.error**2).mean(axis=0)) / least, precision=3))
    print("  bias z       ", np.array2string(z, precision=2), f"(limit {limit:.2f})")
    print("  coverage %   ", np.array2string(100 * done.covers.mean(axis=0), precision=1))
    middle, late = np.quantile(1e3 * done.seconds, (0.5, 0.95))
    print(
        f"  negative {done.negative}, converged {100 * done.converged.mean():.2f} %, "
        f"median {middle:.0f} ms, 95 % within {late:.0f} ms",
        flush=True,
    )


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", action="append", choices=sorted(SCENARIOS), help="default: stated and weak")
    parser.add_argument("--noise", action="append", type=float, help=f"sigma_q^2 in rad^2; default {LEVELS}")
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--start", choices=get_args(Start), default="rest")
    given = parser.parse_args(arguments)
    names, levels = given.scenario or ["stated", "weak"], given.noise or LEVELS
    arm = two_link_arm()
    truth = np.array(arm.values)
    for name in names:
        scenario = SCENARIOS[name]
        for level in levels:
            done = repeat(scenario, level, given.runs, given.seed, given.start)
            variance = cramer_rao_bound(
                arm, truth, scenario.truth, np.sqrt(level), scenario.sigma_tau, rest=given.start == "rest"
            )
            tell(name, level, done, np.sqrt(np.diag(variance)), len(names) * len(levels))


if __name__ == "__main__":
    main()
