"""Many logs of many robots, each identified with one recipe: parameters over time, changes, and what robots share."""

from dynident.fleets.changes import Change, Changes, Shape, find_changes
from dynident.fleets.history import History
from dynident.fleets.pooled import Pooled, pooled
from dynident.fleets.residuals import residual_groups
from dynident.fleets.result import FleetBase, FleetResult
from dynident.fleets.run import run_fleet
from dynident.fleets.scatter import Scatter

__all__ = [
    "Change",
    "Changes",
    "FleetBase",
    "FleetResult",
    "History",
    "Pooled",
    "Scatter",
    "Shape",
    "find_changes",
    "pooled",
    "residual_groups",
    "run_fleet",
]
