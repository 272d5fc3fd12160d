"""What became of all logs of a fleet: what its report reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import TYPE_CHECKING

import numpy as np

from dynident.apps.fleets.changes import Change, Changes, design
from dynident.apps.fleets.components import MIN_INFORMATION, History, Scatter, blocks_of, variance_components, whiten
from dynident.models import Joint, Model
from dynident.regression import BaseParameters, GroupKind, ParameterGroup, rank_of_information
from dynident.runtime import Noun, brief
from dynident.runtime.arrays import Array

if TYPE_CHECKING:
    import polars as pl

MIN_ROBOTS = 3  # robots that show a spread


class Posterior(Noun):
    """The base parameters (b) of one robot given its logs and its type, with their covariance (b, b)."""

    robot: str
    value: Array
    covariance: Array

    @property
    def std(self) -> Array:
        """Standard errors (b) of the base parameters."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))


class Population(Noun):
    """Robots of one type: their ``mean`` (b) with its covariance (b, b), and the ``spread`` (b, b) of single robots.

    ``robots`` are the posteriors of those it was found of; ``weights`` (R) say how much each counts for the mean, below
    one where a robot is unlike the others.
    """

    mean: Array
    covariance: Array
    spread: Array
    robots: tuple[Posterior, ...]
    weights: Array

    def borrow(self, robot: str, value: Array, information: Array) -> Posterior:
        """Return the posterior of a robot of this type whose own logs show ``value`` (b) with ``information`` (b, b).

        Where they show nothing it is the mean of the type with the spread, where they show all it is the value.
        """
        return _robot_posterior(robot, value, information, self.mean, self.spread + self.covariance)[0]


def pool_robots(
    histories: Sequence[History], groups: Sequence[ParameterGroup], scatter: Scatter, changes: Sequence[Change] = ()
) -> Population:
    """Return what robots of one type share, each as it was before its changes.

    ``scatter`` as ``find_changes`` returns it; changes of residuals count for nothing. The spread has no zeros by
    chance (Chung et al., 2013), and one odd robot is bounded in it and in the mean.
    """
    parameter_changes = [entry for entry in changes if entry.group.kind is not GroupKind.RESIDUAL]
    changes_of = {history.robot: [x for x in parameter_changes if x.robot == history.robot] for history in histories}
    baselines = (baseline(history, scatter, changes_of[history.robot]) for history in histories)
    values, information = (np.array(stack) for stack in zip(*baselines, strict=True))
    # one vector for each robot, about the mean of their type
    vectors = whiten(values, information)
    variances = variance_components([vectors], blocks_of(groups, values.shape[1]), avoid_zero=True)
    # robots unlike the others count less for the mean
    weights = vectors.robust_weights(variances)
    solution = vectors.solve(variances, weights)
    robots = []
    for history, value, precision in zip(histories, values, information, strict=True):
        entry, share = _robot_posterior(history.robot, value, precision, solution.value, variances.covariance)
        mean_share = np.eye(len(value)) - share  # of the mean, whose error counts as well
        robots.append(replace(entry, covariance=entry.covariance + mean_share @ solution.covariance @ mean_share.T))
    return Population(solution.value, solution.covariance, variances.covariance, tuple(robots), weights)


def baseline(history: History, scatter: Scatter, changes: Sequence[Change] = ()) -> tuple[Array, Array]:
    """Return the base parameters (b) of a robot before its changes from all its logs, and their information (b, b)."""
    b = history.value.shape[1]
    solution = whiten(history.value, history.information, design(history, changes)).solve(scatter)
    # the first b columns of the design are the parameters before all changes
    return solution.value[:b], rank_of_information(solution.covariance[:b, :b], tolerance=MIN_INFORMATION).inverse


def _robot_posterior(
    robot: str, value: Array, information: Array, mean: Array, prior: Array
) -> tuple[Posterior, Array]:
    """Return the posterior for a prior covariance (b, b) about a mean (b), and the share (b, b) of what is measured."""
    vectors = whiten(value[None], information[None])
    G, z = vectors.factor[0], vectors.value[0]
    # the gain of a Kalman update, with rows whitened by the information
    gain = np.linalg.solve(np.eye(len(z)) + G @ prior @ G.T, G @ prior).T
    return Posterior(robot, mean + gain @ (z - G @ mean), prior - gain @ G @ prior), gain @ G


@dataclass(frozen=True)
class FleetBase:
    """The b base parameters that all robots share: ``names`` of those that lead, their ``units``, ``groupings`` as
    formulas of the standard parameters; and the ``joints``."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    groupings: tuple[str, ...]
    joints: tuple[Joint, ...]

    __repr__ = brief

    @classmethod
    def of(cls, model: Model, basis: BaseParameters) -> FleetBase:
        """Return those of a model."""
        units = tuple(model.parameters[k].unit for k in basis.independent)
        return cls(basis.leading, units, basis.groupings, model.joints)


@dataclass(frozen=True, eq=False)
class FleetResult:
    """All that is known of a fleet.

    ``rows`` has a row for each log (``dynident.apps.fleets.fit.schema``), of the present recipe, by robot and date.
    ``histories`` are those of robots with a result; their days count from ``start``, the first date of all.
    ``groups`` are what can change of these. ``types`` has the robots of each type. ``identified_count`` is the
    number of logs that this run has identified, the others were known. ``changes`` are those of each type of
    which a log has a result, ``pooled`` by type what its robots share, where there are at least three.
    ``residuals`` are histories of the torque that the model leaves, of the same robots and logs: the logarithms
    of its root mean squares by joint.
    """

    name: str
    rows: pl.DataFrame
    base: FleetBase
    histories: tuple[History, ...]
    groups: tuple[ParameterGroup, ...]
    types: Mapping[str, tuple[str, ...]]
    start: datetime | None
    identified_count: int = 0
    warnings: tuple[str, ...] = ()
    changes: tuple[Changes, ...] = ()
    pooled: Mapping[str, Population] = field(default_factory=dict)
    residuals: tuple[History, ...] = ()

    def __repr__(self) -> str:
        robots = self.rows["robot"].n_unique()
        failed = len(self.rows) - sum(len(entry.logs) for entry in self.histories)
        changes = sum(len(entry.changes) for entry in self.changes)
        words = f"{len(self.rows)} logs of {robots} robots, {failed} failed, {changes} changes"
        return f"<FleetResult {self.name!r}: {words}>"

    def frame(self) -> pl.DataFrame:
        """Return the table of logs, one row each, without the packed information."""
        return self.rows.drop("information")
