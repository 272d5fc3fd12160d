"""The values of a servo arm whose simulated positions are nearest to the measured ones, their standard errors, and what
of the given values contradicts the log: gains, masses and offsets of encoders and commands, tested at the fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from dynident.apps.servo.plant import ServoPlant, ignore_divergence
from dynident.apps.servo.start import SmoothLog, StateWindows
from dynident.apps.servo.values import Entry, Quantity, ServoValues
from dynident.runtime import ModelError, Noun, report_progress
from dynident.runtime.arrays import Array

SETTLING = 0.5  # s at the start of a rollout that are not compared: the speed there is not measured
WINDOW = 0.5  # s, of short rollouts
STATE_STEP = 1e-4  # rad and rad/s, of differences
MAX_ITERATIONS = 12
TOLERANCE = 0.1  # standard errors, below which a step ends the search
MIN_DECREASE = 0.05  # of the squared error in a step, below which the sensitivities are not computed again
MAX_CHORD_STEP = 0.02  # of a coordinate, beyond which they are in any case
MAX_REMAINING = 0.3  # standard errors, by which the values of a search that has converged are off at most
STEPS = {Quantity.DELAY: 1e-4, Quantity.OFFSET: 1e-3, Quantity.COMMAND_OFFSET: 1e-3}  # s and rad, of differences
RELATIVE_STEP = 1e-3  # of differences: small, as a factor that all values of a joint share hardly acts
MAX_REFUSALS = 8  # of a step, each with more damping
MIN_STEP = 1e-6  # SI: of differences of what is nearly zero
CORRELATION_TIME = 0.3  # s, over which residuals may be correlated
MIN_SHARE = 1e-6  # of the largest eigenvalue of the scaled information, below which a direction is not determined
MIN_WEIGHT_SHARE = 0.02  # of this log's largest residual: a joint that fits much better counts no more than this
MIN_SUSPECT_GAIN = 0.05  # share of the squared error that an entry must explain
MIN_SUSPECT_SCORE = 3.0  # standard errors of its score, correlated over time
MIN_OWN_SHARE = 1e-4  # of its effect that no fitted entry has
# of the logarithm, and rad
MIN_CHANGES = {Quantity.KP: 0.03, Quantity.MASS: 0.05, Quantity.OFFSET: 3e-3, Quantity.COMMAND_OFFSET: 3e-3}


class ServoFit(Noun):
    """A fit: ``values`` with the ``entries`` that were sought and their covariance (p, p), that of the search's
    coordinates.

    ``residuals`` (N', n) are simulated less measured positions of all recordings, ``sensitivity`` (N', n, p) their
    derivatives, and ``scale`` (n) their standard deviations. ``undetermined`` are combinations of entries that the
    recordings do not tell apart, ``vanished`` those that the search drove to zero. It has ``converged`` where no other
    one is further from the minimum than a share of its standard error, whatever ended it.
    """

    values: ServoValues
    entries: tuple[Entry, ...]
    covariance: Array
    residuals: Array
    sensitivity: Array
    scale: Array
    converged: bool
    undetermined: tuple[tuple[Entry, ...], ...]
    vanished: tuple[Entry, ...] = ()

    @property
    def std(self) -> Array:
        """The standard errors (p) of the entries, in their units."""
        factors = [self.values.entry(entry) if entry.quantity.positive else 1.0 for entry in self.entries]
        return np.asarray(np.sqrt(np.diag(self.covariance)) * np.array(factors))


def residuals(plant: ServoPlant, motions: Sequence[SmoothLog], values: ServoValues) -> Array:
    """Return simulated less measured positions (N', n) of all recordings, without the settling at their starts.

    Those of recordings in windows are without what the states at the starts of these explain.
    """
    parts = []
    for motion in motions:
        log = motion.log
        if motion.windows is None:
            simulated = plant.rollout(values, log, speeds=motion.speeds)[0]
            parts.append((simulated - log.q)[log.t > log.t[0] + SETTLING])
        else:
            parts += window_residuals(plant, motion, motion.windows, values)
    return np.vstack(parts)


def window_residuals(plant: ServoPlant, motion: SmoothLog, windows: StateWindows, values: ServoValues) -> list[Array]:
    """Return simulated less measured positions (m, n) by window, without what the state at its start explains."""
    log = motion.log
    paths = plant.rollout(values, log, windows.starts, windows.stops, motion.speeds)
    misses = [path - log.q[a:b] for path, a, b in zip(paths, windows.starts, windows.stops, strict=True)]
    return [
        (miss.ravel() - basis @ (basis.T @ miss.ravel())).reshape(miss.shape)
        for miss, basis in zip(misses, windows.bases, strict=True)
    ]


def split_into_windows(plant: ServoPlant, motion: SmoothLog, values: ServoValues) -> SmoothLog:
    """Return a recording in windows of 0.5 s, for arms of commanded torques: nothing holds these on their way.

    What their states change is found by differences at the values.
    """
    log, n = motion.log, motion.log.q.shape[1]
    edges = np.searchsorted(log.t, np.arange(log.t[0], log.t[-1] - WINDOW / 2, WINDOW))
    starts, stops = tuple(map(int, edges)), (*map(int, edges[1:]), len(log.t))
    paths = plant.rollout(values, log, starts, stops, motion.speeds)
    columns = []
    for k in range(2 * n):
        change = np.eye(n)[k % n] * STATE_STEP
        moved = replace(log, q=log.q + change) if k < n else log
        speeds = motion.speeds if k < n else motion.speeds + change
        columns.append(plant.rollout(values, moved, starts, stops, speeds))
    bases = [
        np.linalg.qr(np.column_stack([(column[i] - path).ravel() / STATE_STEP for column in columns]))[0]
        for i, path in enumerate(paths)
    ]
    return replace(motion, windows=StateWindows(starts, stops, tuple(bases)))


def sensitivity(
    plant: ServoPlant, motions: Sequence[SmoothLog], values: ServoValues, entries: Sequence[Entry], base: Array
) -> Array:
    """Return the derivatives (N', n, p) of the residuals ``base`` at the values, by differences."""

    def column(k: int) -> Array:
        entry = entries[k]
        size = STEPS.get(entry.quantity) or max(RELATIVE_STEP, MIN_STEP / values.entry(entry))
        moved, before = values.moved(entries, size * np.eye(len(entries))[k]), base
        if entry.quantity is Quantity.DELAY:
            # to both sides: the effect of a delay has kinks, where a command passes from one time step to the next
            earlier = values.changed([entry], [values.delay - size])
            before, size = residuals(plant, motions, earlier), moved.delay - earlier.delay
        return (residuals(plant, motions, moved) - before) / size

    # MuJoCo releases Python's lock while it simulates, and each rollout has a model of its own
    with ignore_divergence(), ThreadPoolExecutor() as pool:
        return np.stack(list(pool.map(column, range(len(entries)))), axis=-1)


def fit_values(
    plant: ServoPlant, motions: Sequence[SmoothLog], values: ServoValues, entries: Sequence[Entry]
) -> ServoFit:
    """Return the fit by Gauss-Newton steps with Levenberg's damping, from ``values``.

    Residuals are weighted by their standard deviation at each joint, found anew in each step.
    """
    entries = tuple(entries)
    base = residuals(plant, motions, values)
    if not np.isfinite(base).all():
        raise ModelError(
            "the simulation of the servos diverges: look at `kp` and `limit`, and at the file's time step and masses."
        )
    damping, is_current = 1e-5, True
    slopes = sensitivity(plant, motions, values, entries, base)
    for iteration in range(1, MAX_ITERATIONS + 1):
        scale = joint_scale(base)
        report_progress(f"simulating the servos, step {iteration}: {1e3 * np.sqrt((base**2).mean()):.3g} mrad")
        information, gradient = _normal_equations(slopes, base, scale)
        size = np.sqrt(np.diag(information)) + 1e-12
        for _ in range(MAX_REFUSALS):
            step = -np.linalg.solve(information / np.outer(size, size) + damping * np.eye(len(size)), gradient / size)
            step = step / size
            candidate = values.moved(entries, step)
            moved = residuals(plant, motions, candidate)
            decrease = 1 - ((moved / scale) ** 2).sum() / ((base / scale) ** 2).sum()
            if decrease > 0:
                break
            damping = max(10 * damping, 1e-3)
        else:
            if is_current:
                break
            # refused by sensitivities of another place: they are computed anew
            slopes, damping, is_current = sensitivity(plant, motions, values, entries, base), 1e-5, True
            continue
        damping /= 10
        # Newton's decrement: how far the minimum is, in standard errors
        decrement = np.sqrt(max(-float(gradient @ step), 0.0))
        values, base, is_current = candidate, moved, False
        if decrement < TOLERANCE:
            break
        if decrease > MIN_DECREASE or np.abs(step).max() > MAX_CHORD_STEP:
            slopes, is_current = sensitivity(plant, motions, values, entries, base), True
    return summarise(values, entries, base, slopes, motions)


def joint_scale(base: Array) -> Array:
    """Return the standard deviations (n) that weight the joints."""
    scale = np.sqrt((base**2).mean(axis=0))
    return np.asarray(np.maximum(scale, max(MIN_WEIGHT_SHARE * scale.max(), 1e-9)))


def _normal_equations(slopes: Array, base: Array, scale: Array) -> tuple[Array, Array]:
    """Return information (p, p) and gradient (p) of weighted residuals."""
    rows = (slopes / scale[None, :, None]).reshape(-1, slopes.shape[-1])
    return rows.T @ rows, rows.T @ (base / scale).ravel()


def summarise(
    values: ServoValues, entries: tuple[Entry, ...], base: Array, slopes: Array, motions: Sequence[SmoothLog]
) -> ServoFit:
    """Return the fit at values, with its covariance: a sandwich, of scores that are correlated over time."""
    scale = joint_scale(base)
    information, gradient = _normal_equations(slopes, base, scale)
    step = float(np.median(np.diff(motions[0].log.t)))
    scores = np.einsum("ijk,ij->ik", slopes / scale[None, :, None], base / scale)
    meat = correlated_sum(scores, step)
    size = np.sqrt(np.diag(information)) + 1e-12
    spectrum, vectors = np.linalg.eigh(information / np.outer(size, size))
    weak = spectrum < MIN_SHARE * spectrum[-1]
    inverse = (vectors / np.maximum(spectrum, MIN_SHARE * spectrum[-1])) @ vectors.T / np.outer(size, size)
    covariance = inverse @ meat @ inverse
    # with few independent residuals the sandwich is too small: it is not let below the plain inverse
    plain = np.diag(inverse)
    floor = np.sqrt(np.maximum(plain / np.maximum(np.diag(covariance), 1e-12 * plain), 1.0))
    covariance = covariance * np.outer(floor, floor)
    undetermined = tuple(
        tuple(entries[i] for i in np.flatnonzero(np.abs(vectors[:, k]) > 0.3)) for k in np.flatnonzero(weak)
    )
    # a step that remains is one to the minimum, or across zero
    remaining = -inverse @ gradient
    vanished = [e.quantity.positive and bool(x <= -1) for e, x in zip(entries, remaining, strict=True)]
    distance = np.where(vanished, 0.0, np.abs(remaining) / np.sqrt(np.maximum(np.diag(covariance), 1e-300)))
    return ServoFit(
        values, entries, covariance, base, slopes, scale, bool(distance.max(initial=0.0) < MAX_REMAINING),
        undetermined, tuple(e for e, is_zero in zip(entries, vanished, strict=True) if is_zero),
    )  # fmt: skip


def correlated_sum(scores: Array, step: float) -> Array:
    """Return the covariance (p, p) of the sum of scores (N, p) that are correlated over ``CORRELATION_TIME``.

    Newey and West, "A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance
    matrix", Econometrica 55 (1987).
    """
    total = scores.T @ scores
    lags = min(round(CORRELATION_TIME / step), len(scores) - 1)
    for lag in range(1, lags + 1):
        product = (1 - lag / (lags + 1)) * scores[lag:].T @ scores[:-lag]
        total += product + product.T
    return np.asarray(total)


def suspect_entries(plant: ServoPlant, motions: Sequence[SmoothLog], fit: ServoFit) -> dict[Entry, float]:
    """Return given entries that the log contradicts, those that explain most first, with their proposed values.

    They are chosen one after the other from the linearised problem, each beside those before it; all gains together
    are a choice, too: of gains and masses only the ratio shows, and one wrong unit is likelier than several masses.
    """
    joints = range(len(plant.joints))
    entries = [Entry(quantity, k) for quantity in MIN_CHANGES for k in joints]
    entries = [entry for entry in entries if entry not in fit.entries and _matters(plant, fit, entry)]
    slopes = sensitivity(plant, motions, fit.values, entries, fit.residuals)
    step = float(np.median(np.diff(motions[0].log.t)))
    gains = [k for k, entry in enumerate(entries) if entry.quantity is Quantity.KP]
    groups = [*([k] for k in range(len(entries))), *([gains] if len(gains) > 1 else [])]
    columns = np.stack([slopes[..., group].sum(axis=-1) for group in groups], axis=-1)

    def accepts(group: int, change: float) -> bool:
        return abs(change) > MIN_CHANGES[entries[groups[group][0]].quantity]

    chosen, shifts, _ = choose_columns(fit, columns, step, MIN_SUSPECT_GAIN, MIN_SUSPECT_SCORE, accepts)
    changes = dict[Entry, float]()
    for group, shift in zip(chosen, shifts, strict=True):
        for k in groups[group]:
            changes[entries[k]] = changes.get(entries[k], 0.0) + shift
    moved = fit.values.moved(list(changes), np.clip(list(changes.values()), -0.7, 0.7))
    return {entry: moved.entry(entry) for entry in changes}


def choose_columns(
    fit: ServoFit, slopes: Array, step: float, min_gain: float, min_score: float, accepts: Callable[[int, float], bool]
) -> tuple[list[int], Array, float]:
    """Return which of the ``slopes`` (N', n, q) explain residuals of a fit beside its entries, their changes, and the
    share of the squared error that they explain.

    They are chosen one after the other, the best first, as long as each explains ``min_gain``, its change is accepted,
    and its score is ``min_score`` standard errors, correlated over time; samples are ``step`` s apart.
    """
    scale = joint_scale(fit.residuals)
    weighted = fit.residuals / scale
    columns = (np.concatenate([fit.sensitivity, slopes], axis=-1) / scale[:, None]).reshape(weighted.size, -1)
    p = len(fit.entries)
    chosen, total_gain = list(range(p)), 0.0
    while True:
        base = columns[:, chosen]
        residual = weighted.ravel() - base @ np.linalg.lstsq(base, weighted.ravel(), rcond=None)[0]
        gains = {}
        for k in range(p, columns.shape[1]):
            unexplained = columns[:, k] - base @ np.linalg.lstsq(base, columns[:, k], rcond=None)[0]
            size = float(unexplained @ unexplained)
            if k in chosen or size <= MIN_OWN_SHARE * float(columns[:, k] @ columns[:, k]):
                continue
            change = -float(unexplained @ residual) / size
            score = (unexplained * residual).reshape(weighted.shape).sum(axis=1)
            spread = np.sqrt(max(correlated_sum(score[:, None], step)[0, 0], 1e-300))
            if abs(score.sum()) > min_score * spread and accepts(k - p, change):
                gains[k] = change**2 * size / float(residual @ residual)
        best = max(gains, key=lambda k: gains[k], default=None)
        if best is None or gains[best] < min_gain:
            break
        total_gain += (1 - total_gain) * gains[best]
        chosen.append(best)
    changes = -np.linalg.lstsq(columns[:, chosen], weighted.ravel(), rcond=None)[0][p:]
    return [k - p for k in chosen[p:]], np.asarray(changes, dtype=float), total_gain


def _matters(plant: ServoPlant, fit: ServoFit, entry: Entry) -> bool:
    if entry.quantity is Quantity.KP:
        return not fit.values.takes_torque[entry.k]
    return entry.quantity is not Quantity.MASS or bool(plant.model.body_mass[plant.bodies[entry.k]] > 0)
