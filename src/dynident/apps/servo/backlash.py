"""Backlash of servos: whether gaps between motors and links explain what the fit does not, and how wide they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dynident.apps.servo.fit import SETTLING, ServoFit, choose_columns, joint_scale
from dynident.apps.servo.plant import ServoLog, ServoPlant, ignore_divergence, import_mujoco, sample_path
from dynident.apps.servo.start import SmoothLog
from dynident.apps.servo.values import ServoValues
from dynident.runtime import Noun, report_progress
from dynident.runtime.arrays import Array

TRIAL = 0.01  # rad or m, of the gap whose effect is looked for
MIN_SIZE, MAX_SIZE = 2e-3, 0.3  # rad or m: what is smaller is not told from other errors
MIN_GAIN = 0.03  # share of the squared error that a gap must explain
MIN_SCORE = 1.0  # standard errors of its score: a gap that is crossed once or twice has hardly more
MIN_EXPLAINED = 0.3  # share of a joint's squared error that its gap takes away once it is simulated
MIN_NOISE_RATIO = 1.1  # of residuals to noise, below which there is nothing to explain
MIN_ROTOR = 1e-5  # kg m^2: without inertia of its own a motor in front of a gap has no motion
GAP_DAMPING = 1e-3  # N m s, of the oil in the gap
HARD_STOP = (0.99, 0.999, 1e-3, 0.5, 2.0)  # MuJoCo's impedance of the flanks
SUFFIX = " (gap)"  # of the joint of a gap
STEPS = 2  # of all sizes together, once the joints are chosen


class Backlash(Noun):
    """A gap at joint ``k``, its ``size`` (rad, m), and whether positions are measured behind it (``output``)."""

    k: int
    size: float
    output: bool


def add_gaps(spec: Any, joints: Sequence[str]) -> None:
    """Add to a MuJoCo specification a joint behind each of the ``joints``, which moves freely within a gap."""
    for joint in [joint for joint in spec.joints if joint.name in joints]:
        gap = joint.parent.add_joint(
            name=f"{joint.name}{SUFFIX}", type=joint.type, axis=joint.axis, pos=joint.pos, limited=1,
            range=[-TRIAL / 2, TRIAL / 2], solimp_limit=HARD_STOP,
        )  # fmt: skip
        gap.solref_limit = [2 * spec.option.timestep, 1.0]
        gap.damping[0] = GAP_DAMPING
        joint.armature = max(float(joint.armature), MIN_ROTOR)


@ignore_divergence()
def rollout_with_gaps(
    plant: ServoPlant, values: ServoValues, gaps: Sequence[Backlash], log: ServoLog, speeds: Array
) -> Array:
    """Return the positions that the encoders show (N, n), of a plant whose model has these gaps."""
    mujoco, ks = import_mujoco(), [gap.k for gap in gaps]
    model = plant.with_values(replace(values, armature=np.maximum(values.armature, MIN_ROTOR)))
    ids = [model.joint(plant.joints[k] + SUFFIX).id for k in ks]
    model.jnt_range[ids] = np.outer([gap.size for gap in gaps], [-0.5, 0.5])
    places, behind, data = model.jnt_qposadr[ids], np.array([gap.output for gap in gaps]), mujoco.MjData(model)
    data.qpos[plant.positions], data.qvel[plant.dofs] = log.q[0] - values.offset, speeds[0]
    count = int(np.ceil((log.t[-1] - log.t[0]) / plant.step)) + 1
    control = plant.controls(values, log.commands_at(log.t[0], plant.step, count, values.delay))
    gear, path = plant.gear[ks], np.empty((count + 1, len(plant.joints)))
    for i in range(count + 1):
        path[i], gap = data.qpos[plant.positions], behind * data.qpos[places]
        path[i, ks] += gap
        if i < count:
            data.ctrl[plant.actuators] = control[i]
            data.ctrl[plant.actuators[ks]] -= gear * gap  # the servo sees what its encoder does
            mujoco.mj_step(model, data)
    return sample_path(path, (log.t - log.t[0]) / plant.step) + values.offset


def find_backlash(
    load: Callable[[Sequence[int]], ServoPlant], motions: Sequence[SmoothLog], fit: ServoFit, noise: Array
) -> tuple[Backlash, ...]:
    """Return the gaps that explain what a fit leaves beyond the ``noise`` (n); ``load`` gives the plant with gaps at
    some joints.

    Each joint is simulated with a gap, in front of or behind its encoder. What this changes beyond what the fitted
    entries can is compared with the residuals, one gap after the other; then the sizes are found with all gaps.
    Where torques are commanded nothing is looked for: no controller answers to the gap.
    """
    if fit.values.takes_torque.any() or not (fit.scale > MIN_NOISE_RATIO * noise).any():
        return ()

    def misses(gaps: Sequence[Backlash]) -> Array:
        plant, parts = load([gap.k for gap in gaps]), []
        for motion in motions:
            log = motion.log
            simulated = rollout_with_gaps(plant, fit.values, gaps, log, motion.speeds)
            parts.append((simulated - log.q)[log.t > log.t[0] + SETTLING])
        moved = np.vstack(parts)
        return moved if np.isfinite(moved).all() else fit.residuals  # where it diverges, a gap explains nothing

    def accepts(k: int, change: float) -> bool:  # a gap moves nothing further than its size
        return max(MIN_SIZE, float(fit.scale[k])) < change < MAX_SIZE

    best, best_gain = tuple[Backlash, ...](), 0.0
    step, scale = float(np.median(np.diff(motions[0].log.t))), joint_scale(fit.residuals)
    for output in (True, False):
        report_progress(f"looking for backlash {'in front of' if output else 'behind'} the encoders")
        trials = [misses([Backlash(k, TRIAL, output)]) for k in range(len(noise))]
        slopes = np.stack([(trial - fit.residuals) / TRIAL for trial in trials], axis=-1)
        chosen, sizes, gain = choose_columns(fit, slopes, step, MIN_GAIN, MIN_SCORE, accepts)
        if gain <= best_gain:
            continue
        for _ in range(STEPS):
            gaps = [Backlash(k, float(x), output) for k, x in zip(chosen, sizes, strict=True)]
            # residuals with these gaps, as if the sizes were fitted entries
            columns = np.concatenate([fit.sensitivity, slopes[..., chosen]], axis=-1) / scale[:, None]
            rows = columns.reshape(-1, columns.shape[-1])
            change = -np.linalg.lstsq(rows, (misses(gaps) / scale).ravel(), rcond=None)[0][-len(chosen) :]
            sizes = np.clip(sizes + change, MIN_SIZE, MAX_SIZE)
        best = tuple(Backlash(k, float(x), output) for k, x in zip(chosen, sizes, strict=True))
        best_gain = gain
    if not best:
        return ()
    # of an elastic gear, say, a gap has the sensitivity, but not the motion
    shares = explained_shares(fit, misses(best))
    return tuple(gap for gap in best if shares[gap.k] > MIN_EXPLAINED)


def explained_shares(fit: ServoFit, moved: Array) -> Array:
    """Return the share (n) of a fit's squared error by joint that other residuals (N', n) take away, once the fitted
    entries follow."""
    columns = fit.sensitivity.reshape(-1, fit.sensitivity.shape[-1])
    weights = np.repeat(1 / joint_scale(fit.residuals)[None], len(moved), axis=0).ravel()
    change = np.linalg.lstsq(columns * weights[:, None], moved.ravel() * weights, rcond=None)[0]
    remaining = (moved.ravel() - columns @ change).reshape(moved.shape)
    return np.asarray(1 - (remaining**2).sum(axis=0) / (fit.residuals**2).sum(axis=0))
