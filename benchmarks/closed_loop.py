"""Maximum likelihood on arms from robot files, simulated in closed loop: python3 benchmarks/closed_loop.py.

An arm follows a Fourier trajectory under a PD controller that sees quantised positions; its torque is held from sample
to sample. Joints have viscous and Coulomb friction. The torque's noise is white, or coloured (first order). Printed
over the base parameters: root mean square error over the Cramer-Rao bound, the share of errors within 1.96
bounds, and the largest mean error in its standard errors; and seconds a run.
"""

from __future__ import annotations

import argparse
import os
import time

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np

from dynident.basis import structural_basis
from dynident.bound import information
from dynident.estimators import Consistent, MaximumLikelihood, Problem
from dynident.log import Log, Motion
from dynident.model import Model
from dynident.regression import Regression
from dynident.smoothers import Delayed, Spline
from dynident.terms import Bodies, Coulomb, Viscous

LINKS = (  # mass, height of the next joint, its offset, its axis turned about x by so many right angles
    (4.0, 0.33, 0.0, -1),
    (3.5, 0.0, 0.0, 1),
    (3.0, 0.32, 0.08, 1),
    (2.7, 0.0, -0.08, -1),
    (1.7, 0.38, 0.0, 1),
    (1.6, 0.0, 0.09, 1),
)
PERIOD, RATE = 10.0, 500.0  # s, Hz
COUNT = 2 * np.pi / 2**17  # rad
LOW_PASS = 0.2  # share of a new sample in the filtered position, whose distance is the velocity: about 20 Hz


def arm(joints: int) -> Model:
    parts, rise, shift, turn = ['<robot name="arm"><link name="base"/>'], 0.3, 0.0, 1
    for k, (mass, height, offset, quarter) in enumerate(LINKS[6 - joints :], start=1):
        parent = "base" if k == 1 else f"link{k - 1}"
        size = 0.02 * mass
        parts.append(
            f'<link name="link{k}"><inertial><origin xyz="0.01 0.02 {0.05 + height / 2:.3f}"/><mass value="{mass}"/>'
            f'<inertia ixx="{size:.4f}" iyy="{0.9 * size:.4f}" izz="{0.3 * size:.4f}" ixy="0" ixz="0" iyz="0"/>'
            f'</inertial></link><joint name="joint{k}" type="revolute"><parent link="{parent}"/><child link="link{k}"/>'
            f'<origin xyz="{shift} 0 {rise}" rpy="{turn * np.pi / 2:.15f} 0 0"/><axis xyz="0 0 1"/>'
            '<limit lower="-3" upper="3" effort="80" velocity="3"/></joint>'
        )
        rise, shift, turn = height, offset, quarter
    bodies = Bodies("".join([*parts, "</robot>"]))
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


def simulate(model: Model) -> Motion:
    """Simulate the closed loop; all runs see the same motion, with noise of their own."""
    theta = np.asarray(model.values)
    t, reference, speed, acceleration = fourier(len(model.joints))
    feedforward = model.torque(reference, speed, acceleration, theta)
    inertia = np.diagonal(model.mass_matrix(reference[:1], theta)[0])
    kp, kd, h = 400.0 * inertia, 40.0 * inertia, 1 / RATE
    x, states, torques = np.concatenate([reference[:1], speed[:1]], axis=1), [], []
    n, slow = len(inertia), reference[0].copy()

    def rate(x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        return np.concatenate([x[:, n:], model.forward(x[:, :n], x[:, n:], tau[None], theta)], axis=1)

    for k in range(len(t)):
        seen = COUNT * np.round(x[0, :n] / COUNT)
        slow += LOW_PASS * (seen - slow)  # the velocity that a drive feeds back is filtered
        tau = feedforward[k] + kp * (reference[k] - seen) + kd * (speed[k] - LOW_PASS * RATE * (seen - slow))
        states.append(x[0])
        torques.append(tau)
        a = rate(x, tau)
        b = rate(x + h / 2 * a, tau)
        c = rate(x + h / 2 * b, tau)
        x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, tau))
    q, dq, tau = np.array(states)[:, :n], np.array(states)[:, n:], np.array(torques)
    ddq = model.forward(q, dq, tau, theta)
    names = tuple(joint.name for joint in model.joints)
    return Motion(t, q, dq, ddq, tau, names, np.ones(len(t), dtype=bool), "closed loop")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--joints", type=int, choices=range(2, 7), default=2)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--colour", type=float, default=0.0, help="correlation of neighbouring torque errors")
    parser.add_argument("--noise", type=float, default=0.1, help="standard deviation of the torque's noise in N m")
    parser.add_argument("--seed", type=int, default=7)
    given = parser.parse_args()
    model = arm(given.joints)
    truth, basis = np.asarray(model.values), structural_basis(model)
    motion = simulate(model)
    pick = list(basis.independent)
    S = information(model, truth, motion, COUNT / np.sqrt(12), given.noise, substeps=1)[np.ix_(pick, pick)]
    least = np.sqrt(np.diag(np.linalg.inv(S)))
    for name, estimator in (("consistent", Consistent(costs=False)), ("maximum likelihood", MaximumLikelihood())):
        errors, took, words = [], [], set()
        for rng in np.random.default_rng(given.seed).spawn(given.runs):
            problem = posed(model, motion, given.noise, given.colour, rng)
            began = time.process_time()
            found = estimator(problem)
            took.append(time.process_time() - began)
            errors.append(basis.combination @ (found.value - truth))
            words.add(found.status.partition("rank")[0])
        error = np.array(errors)
        ratio = np.sqrt((error**2).mean(axis=0)) / least
        z = error.mean(axis=0) / (error.std(axis=0, ddof=1) / np.sqrt(len(error)))
        near = 100 * (np.abs(error) < 1.96 * least).mean()
        print(
            f"{name}: RMSE / bound median {np.median(ratio):.2f}, worst {ratio.max():.2f}; {near:.0f} % within 1.96; "
            f"largest bias z {np.abs(z).max():.1f} of {len(z)}; {np.median(took):.1f} s; {'; '.join(sorted(words))}",
            flush=True,
        )


def posed(model: Model, motion: Motion, noise: float, colour: float, rng: np.random.Generator) -> Problem:
    white = rng.standard_normal(motion.tau.shape)
    for k in range(1, len(white)):
        white[k] = colour * white[k - 1] + np.sqrt(1 - colour**2) * white[k]
    dither = COUNT * rng.uniform(0, 1, motion.q.shape[1])  # where the encoder's counts begin
    q = COUNT * np.round((motion.q + dither) / COUNT) - dither
    log = Log(motion.t, q, motion.tau + noise * white, motion.joints)
    delay = 0.5 / RATE  # a torque that is held belongs to the middle of its period
    motions = (Delayed(Spline(), delay)(log),)
    return Problem(model, motions, Regression(model, motions), (log,), delay)


if __name__ == "__main__":
    main()
