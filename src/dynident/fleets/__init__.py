"""Many logs of many robots, each identified with one recipe: parameters over time, changes, and what robots share."""

from dynident.fleets.groups import groups_of
from dynident.fleets.history import Group, GroupKind, History
from dynident.fleets.result import FleetBase, FleetResult
from dynident.fleets.run import run_fleet

__all__ = ["FleetBase", "FleetResult", "Group", "GroupKind", "History", "groups_of", "run_fleet"]
