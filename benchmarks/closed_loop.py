"""Maximum likelihood on arms from robot files, simulated in closed loop: python3 benchmarks/closed_loop.py.

An arm follows a Fourier trajectory under a PD controller that sees quantised positions; its torque is held from sample
to sample. Joints have viscous and Coulomb friction. The torque's noise is white, or coloured (first order). Printed
over the base parameters: root mean square error, spread and bias over the Cramer-Rao bound for white noise; how many
biases are more than chance; how many 95 % intervals, by two kinds of standard errors, hold the truth; seconds a run.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from arm import LINKS, urdf
from scipy.special import ndtri

from dynident.estimators import Estimator, LeastSquares, PhysicallyConsistent, Problem
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.identification import align_motion, information
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Viscous
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Smoother, Spline
from dynident.motion.smoothers.spline import NOISE_FACTORS
from dynident.regression import BaseParameters, Regression, base_std, informed_std, structural_base_parameters
from dynident.validation import robust_covariance

PERIOD, RATE = 10.0, 500.0  # s, Hz
ESTIMATORS: dict[str, Estimator] = {
    "least squares": LeastSquares(),
    "consistent": PhysicallyConsistent(costs=False),
    "maximum likelihood": MaximumLikelihood(),
}
COUNT = 2 * np.pi / 2**17  # rad
LOW_PASS = 0.2  # share of a new sample in the filtered position, whose distance is the velocity: about 20 Hz


def arm(joints: int) -> Model:
    bodies = RigidBodies(urdf(LINKS[6 - joints : 6], turn=1))
    viscous = Viscous(bodies.joints, values=(0.5,) * joints)
    return Model((bodies, viscous, Coulomb(bodies.joints, values=(0.4,) * joints, width=0.02)))


def fourier(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times, and positions, velocities and accelerations (N, n) of a periodic trajectory that starts from rest."""
    rng = np.random.default_rng(3)
    t = np.arange(0, PERIOD, 1 / RATE)
    rate = 2 * np.pi / PERIOD * np.arange(1, 9)[:, None]
    a, b = rng.uniform(-0.15, 0.15, (2, 8, n))
    b -= b.mean(axis=0)
    angle = rate * t[:, None, None]
    q = (a * np.cos(angle) + b / rate * rate[0] * np.sin(angle)).sum(axis=1)
    dq = (-a * rate * np.sin(angle) + b * rate[0] * np.cos(angle)).sum(axis=1)
    ddq = (-a * rate**2 * np.cos(angle) - b * rate[0] * rate * np.sin(angle)).sum(axis=1)
    return t, q, dq, ddq


def simulate(model: Model, rngs: Sequence[np.random.Generator]) -> list[tuple[Motion, np.ndarray]]:
    """Simulate a closed loop for each generator; return the motions, and the positions that the controller saw.

    Where the encoders' counts begin differs, and with it the chatter about the reference.
    """
    theta, runs = np.asarray(model.values), len(rngs)
    t, reference, speed, acceleration = fourier(len(model.joints))
    feedforward = model.torque(reference, speed, acceleration, theta)
    inertia = np.diagonal(model.mass_matrix(reference[:1], theta)[0])
    kp, kd, h = 400.0 * inertia, 40.0 * inertia, 1 / RATE
    n = len(inertia)
    dither = np.array([rng.uniform(0, COUNT, n) for rng in rngs])
    x = np.tile(np.concatenate([reference[0], speed[0]]), (runs, 1))
    slow, states, views, torques = x[:, :n].copy(), [], [], []

    def rate(x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        return np.concatenate([x[:, n:], model.forward_dynamics(x[:, :n], x[:, n:], tau, theta)], axis=1)

    for k in range(len(t)):
        seen = COUNT * np.round((x[:, :n] + dither) / COUNT) - dither
        slow += LOW_PASS * (seen - slow)  # the velocity that a drive feeds back is filtered
        tau = feedforward[k] + kp * (reference[k] - seen) + kd * (speed[k] - LOW_PASS * RATE * (seen - slow))
        states.append(x)
        views.append(seen)
        torques.append(tau)
        a = rate(x, tau)
        b = rate(x + h / 2 * a, tau)
        c = rate(x + h / 2 * b, tau)
        x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, tau))
    names = tuple(joint.name for joint in model.joints)
    out, usable = [], np.ones(len(t), dtype=bool)
    for state, seen, tau in zip(*(np.stack(part, axis=1) for part in (states, views, torques)), strict=True):
        q, dq = state[:, :n], state[:, n:]
        ddq = model.forward_dynamics(q, dq, tau, theta)
        out.append((Motion(t, q, dq, ddq, tau, names, usable, "closed loop"), seen))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--joints", type=int, choices=range(2, 7), default=2)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--colour", type=float, default=0.0, help="correlation of neighbouring torque errors")
    parser.add_argument("--noise", type=float, default=0.1, help="standard deviation of the torque's noise in N m")
    parser.add_argument("--seed", type=int, default=7)
    given = parser.parse_args()
    model = arm(given.joints)
    truth, basis = np.asarray(model.values), structural_base_parameters(model)
    rngs = np.random.default_rng(given.seed).spawn(given.runs)
    runs = simulate(model, rngs)
    S = information(model, truth, runs[0][0], COUNT / np.sqrt(12), given.noise, substeps=1)
    least = informed_std(basis, S)
    logs = [recorded(*run, given.noise, given.colour, rng) for run, rng in zip(runs, rngs, strict=True)]
    smoother = align_motion(model, logs[:1], [Spline(factor=x) for x in NOISE_FACTORS], 0.5 / RATE).smoother
    problems = [posed(model, log, smoother) for log in logs]
    for name, estimator in ESTIMATORS.items():
        tell(name, [judged(estimator, problem, truth, basis) for problem in problems], least, basis)


@dataclass(frozen=True)
class Result:
    """Errors (r) of the base parameters, two kinds of standard errors (2, r), CPU seconds, kinds of notes."""

    error: np.ndarray
    std: np.ndarray
    seconds: float
    notes: tuple[str, ...]


def judged(estimator: Estimator, problem: Problem, truth: np.ndarray, basis: BaseParameters) -> Result:
    began = time.process_time()
    estimate = estimator(problem)
    took = time.process_time() - began
    if estimate.information is not None:
        std = informed_std(basis, estimate.information)
    else:
        std = base_std(basis, problem.regression.triangular_factors, estimate.residual.sigma, estimate.residual.weights)
    hac = robust_covariance(problem.regression, estimate.value, estimate.residual.weights, basis.independent)
    both = np.stack([std, np.sqrt(np.diag(hac))])
    notes = tuple(type(note).__name__ for note in estimate.notes)
    return Result(basis.combination @ (estimate.value - truth), both, took, notes)


def tell(name: str, results: list[Result], least: np.ndarray, basis: BaseParameters) -> None:
    error, std = np.array([result.error for result in results]), np.array([result.std for result in results])
    N, r = error.shape
    ratio, spread = np.sqrt((error**2).mean(axis=0)) / least, error.std(axis=0, ddof=1) / least
    bias = error.mean(axis=0) / least
    z = error.mean(axis=0) / (error.std(axis=0, ddof=1) / np.sqrt(N))
    limit = -ndtri(0.01 / (2 * r))
    seconds = np.median([result.seconds for result in results])
    print(f"{name}: {N} runs, {r} base parameters, median {seconds:.1f} s of CPU")
    for words, x in (("RMSE / bound", ratio), ("spread / bound", spread), ("|bias| / bound", np.abs(bias))):
        print(f"  {words:16s} median {np.median(x):.2f}, worst {x.max():.2f} ({basis.groupings[int(x.argmax())]})")
    beyond = (np.abs(z) > limit).sum()
    print(f"  bias: {beyond} of {r} beyond |z| = {limit:.2f} (1 % for all together), largest {np.abs(z).max():.1f}")
    for words, x in zip(("own", "HAC"), 100 * (np.abs(error[:, None]) < 1.96 * std).mean(axis=0), strict=True):
        print(f"  coverage, 95 % by {words} standard errors: mean {x.mean():.1f} %, least {x.min():.0f} %")
    notes = Counter(note for result in results for note in result.notes)
    print(f"  notes, by runs: {', '.join(f'{note} {count}' for note, count in notes.items()) or 'none'}", flush=True)


def recorded(motion: Motion, seen: np.ndarray, noise: float, colour: float, rng: np.random.Generator) -> Log:
    white = rng.standard_normal(motion.tau.shape)
    for k in range(1, len(white)):
        white[k] = colour * white[k - 1] + np.sqrt(1 - colour**2) * white[k]
    return Log(motion.t, seen, motion.tau + noise * white, motion.joints)


def posed(model: Model, log: Log, smoother: Smoother) -> Problem:
    motions = (smoother(log),)
    time_offset = 0.5 / RATE  # a torque that is held belongs to the middle of its period
    return Problem(model, motions, Regression(model, motions), (log,), time_offset)


if __name__ == "__main__":
    main()
