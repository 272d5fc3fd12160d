"""What became of all logs of a fleet: what its report reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING

from dynident.errors import brief
from dynident.fleets.changes import Changes
from dynident.fleets.history import History
from dynident.fleets.pooled import Pooled
from dynident.models import Joint, Model
from dynident.regression import BaseParameters, Group

if TYPE_CHECKING:
    import polars as pl

__all__ = ["FleetBase", "FleetResult"]


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

    ``rows`` has a row for each log (``dynident.fleets.rows.schema``), of the present recipe, by robot and date.
    ``histories`` are those of robots with a result; their days count from ``start``, the first date of all. ``groups``
    are what can change of these. ``types`` has the robots of each type. ``fitted`` counts the logs that this run has
    identified, the others were known. ``changes`` are those of each type of which a log has a result, ``pooled`` by
    type what its robots share, where there are at least three. ``residuals`` are histories of the torque that the model
    leaves, of the same robots and logs: the logarithms of its root mean squares by joint.
    """

    name: str
    rows: pl.DataFrame
    base: FleetBase
    histories: tuple[History, ...]
    groups: tuple[Group, ...]
    types: Mapping[str, tuple[str, ...]]
    start: datetime | None
    fitted: int = 0
    warnings: tuple[str, ...] = ()
    changes: tuple[Changes, ...] = ()
    pooled: Mapping[str, Pooled] = field(default_factory=dict)
    residuals: tuple[History, ...] = ()

    def __repr__(self) -> str:
        robots = self.rows["robot"].n_unique()
        failed = len(self.rows) - sum(len(one.logs) for one in self.histories)
        changes = sum(len(one.found) for one in self.changes)
        words = f"{len(self.rows)} logs of {robots} robots, {failed} failed, {changes} changes"
        return f"<FleetResult {self.name!r}: {words}>"

    def frame(self) -> pl.DataFrame:
        """Return the table of logs, one row each, without the packed information."""
        return self.rows.drop("information")
