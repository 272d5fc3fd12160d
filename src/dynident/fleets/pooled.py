"""What robots of one type share: a hierarchical mean, their spread, and what one robot borrows of them.

The base parameters of a robot are those of its type and a deviation, beta_r ~ N(mu, T); its logs show beta_r with an
error that is known. T is found by restricted likelihood, and each robot's posterior is the weighted mean of what its
own logs show and of what its type is like (Laird and Ware, 1982).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief
from dynident.fleets.changes import Change, design
from dynident.fleets.components import components, measured, pseudo_inverse, solved, weights_of
from dynident.fleets.history import History
from dynident.fleets.scatter import Scatter, blocks_of
from dynident.regression import Group, GroupKind

__all__ = ["Pooled", "Posterior", "baseline", "pooled"]

Array = NDArray[np.float64]
FEWEST = 3  # robots that show a spread


@dataclass(frozen=True, eq=False)
class Posterior:
    """The base parameters (b) of one robot given its logs and its type, with their covariance (b, b)."""

    robot: str
    value: Array
    covariance: Array

    __repr__ = brief

    @property
    def std(self) -> Array:
        """Standard errors (b) of the base parameters."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))


@dataclass(frozen=True, eq=False)
class Pooled:
    """Robots of one type: their ``mean`` (b) with its covariance (b, b), and the ``spread`` (b, b) of single robots.

    ``robots`` are the posteriors of those it was found of; ``weights`` (R) say how much each counts for the mean, below
    one where a robot is unlike the others.
    """

    mean: Array
    covariance: Array
    spread: Array
    robots: tuple[Posterior, ...]
    weights: Array

    __repr__ = brief

    def deviation(self, robot: str) -> tuple[Array, Array]:
        """Return by how much a robot differs from the mean (b), and the standard error (b) of that.

        Raises KeyError for a robot that is not among ``robots``.
        """
        for one in self.robots:
            if one.robot == robot:
                return one.value - self.mean, one.std
        raise KeyError(robot)

    def borrow(self, robot: str, value: Array, information: Array) -> Posterior:
        """Return the posterior of a robot of this type whose own logs show ``value`` (b) with ``information`` (b, b).

        Where they show nothing it is the mean of the type with the spread, where they show all it is the value.
        """
        return _posterior(robot, value, information, self.mean, self.spread + self.covariance)[0]


def pooled(
    histories: Sequence[History], groups: Sequence[Group], scatter: Scatter, changes: Sequence[Change] = ()
) -> Pooled:
    """Return what robots of one type share, each as it was before its changes.

    ``scatter`` as ``find_changes`` returns it; changes of residuals count for nothing. The spread has no zeros by
    chance (Chung et al., 2013), and one odd robot is bounded in it and in the mean. Raises InputError for fewer than
    three robots.
    """
    if len(histories) < FEWEST:
        raise InputError(f"{len(histories)} robots do not show how robots of a type differ; give at least {FEWEST}.")
    moved = [one for one in changes if one.group.kind is not GroupKind.RESIDUAL]
    known = [baseline(one, scatter, [x for x in moved if x.robot == one.robot]) for one in histories]
    values, information = (np.array(some) for some in zip(*known, strict=True))
    together = measured(values, information)
    parts = components([together], blocks_of(groups, values.shape[1]), few=True)
    weights = weights_of(together, parts)
    run = solved(together, parts, weights)
    robots = []
    for history, value, precision in zip(histories, values, information, strict=True):
        one, share = _posterior(history.robot, value, precision, run.value, parts.covariance)
        rest = np.eye(len(value)) - share  # of the mean, whose error counts as well
        robots.append(Posterior(one.robot, one.value, one.covariance + rest @ run.covariance @ rest.T))
    return Pooled(run.value, run.covariance, parts.covariance, tuple(robots), weights)


def baseline(history: History, scatter: Scatter, changes: Sequence[Change] = ()) -> tuple[Array, Array]:
    """Return the base parameters (b) of a robot before its changes from all its logs, and their information (b, b)."""
    b = history.value.shape[1]
    run = solved(measured(history.value, history.information, design(history, changes)), scatter.parts)
    return run.value[:b], pseudo_inverse(run.covariance[:b, :b])


def _posterior(robot: str, value: Array, information: Array, mean: Array, prior: Array) -> tuple[Posterior, Array]:
    """Return the posterior for a prior covariance (b, b) about a mean (b), and the share (b, b) of what is measured."""
    one = measured(value[None], information[None])
    G, z = one.factor[0], one.value[0]
    gain = np.linalg.solve(np.eye(len(z)) + G @ prior @ G.T, G @ prior).T
    return Posterior(robot, mean + gain @ (z - G @ mean), prior - gain @ G @ prior), gain @ G
