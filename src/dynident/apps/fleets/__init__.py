"""Many logs of many robots with one recipe: what has changed, and what robots share."""

from dynident.apps.fleets.changes import Change, Changes, ChangeShape, find_changes
from dynident.apps.fleets.components import History, Scatter
from dynident.apps.fleets.doubts import residual_groups
from dynident.apps.fleets.figures import Mark, ParameterTrend, pooled_figure, robots_figure, trend_figure
from dynident.apps.fleets.result import FleetBase, FleetResult, Population, pool_robots
from dynident.apps.fleets.run import fleet
