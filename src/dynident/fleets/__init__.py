"""Many logs of many robots, each identified with one recipe: parameters over time, changes, and what robots share."""

from dynident.fleets.history import Group, GroupKind, History

__all__ = ["Group", "GroupKind", "History"]
