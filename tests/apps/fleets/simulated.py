"""Histories of robots whose truth is known: twelve base parameters of sizes from 0.01 to 10, seven groups."""

from collections.abc import Callable

import numpy as np

from dynident.apps.fleets import History
from dynident.regression import GroupKind, ParameterGroup

B = 12
SIZE = np.geomspace(0.01, 10.0, B)
E = np.eye(B)
FRICTION_A, FRICTION_B, OFFSET_A, OFFSET_B, RIPPLE, PAYLOAD = range(6)
MIXED = np.array([[1.0, 0.2, 0.0], [0.1, 1.0, 0.3], [0.0, 0.4, 1.0], [0.5, 0.0, 0.2]])  # of three on the first four
SCATTER = 0.05, 0.02, 0.02  # of friction by the temperature, that both joints share; by itself; of offsets
Change = Callable[[int, int, np.ndarray], None]


def group(kind, joint, directions):
    k = directions.shape[1]
    return ParameterGroup(kind, joint, directions, tuple(f"{kind}{i}" for i in range(k)), ("N m",) * k)


GROUPS = (
    group(GroupKind.FRICTION, "a", E[:, 4:6]),
    group(GroupKind.FRICTION, "b", E[:, 6:8]),
    group(GroupKind.OFFSET, "a", E[:, 8:9]),
    group(GroupKind.OFFSET, "b", E[:, 9:10]),
    group(GroupKind.RIPPLE, "b", E[:, 10:]),
    group(GroupKind.PAYLOAD, "b", E[:, :4] @ MIXED),
)


CARRIED = np.array([0.02, 0.0, 0.05])


def carries(log, value):
    """Add a payload from the log 10 on."""
    value += (log >= 10) * GROUPS[PAYLOAD].directions @ CARRIED


def robot(rng, name, truth, logs, change=lambda log, value: None, rows=40):
    """A robot whose standard errors are 2 % of the size, and 1.5 times too small."""
    values, information = [], []
    for k in range(logs):
        X = rng.standard_normal((rows, B)) / SIZE / (0.02 * np.sqrt(rows))
        J = X.T @ X
        warm, own, offset = SCATTER
        value = truth.copy()
        change(k, value)
        value[4:8] *= 1 + warm * rng.standard_normal() + own * rng.standard_normal(4)
        value[8:10] += offset * SIZE[8:10] * rng.standard_normal(2)
        if rows >= B:
            value += 1.5 * np.linalg.cholesky(np.linalg.inv(J)) @ rng.standard_normal(B)
        values.append(value)
        information.append(J)
    names = tuple(f"log{k}" for k in range(logs))
    return History(name, names, 7.0 * np.arange(logs), np.array(values), np.array(information))


def fleet(rng, robots, logs, changes=None):
    """Robots that differ by 20 %; ``changes`` by robot add to the value of a log."""
    reference = changes or {}
    truth = SIZE * (1 + 0.2 * rng.standard_normal((robots, B)))
    return [robot(rng, f"robot{r}", truth[r], logs, reference.get(r, lambda log, value: None)) for r in range(robots)]
