"""Smoothers and estimators on the same logs, ranked on held-out motion."""

from dynident.apps.ranking.config import Candidate, Combination
from dynident.apps.ranking.page import cost_figure, ranking_figure
from dynident.apps.ranking.ranking import CombinationOutcome, InapplicablePart, RankedCombination, Ranking, TruthFigures
from dynident.apps.ranking.run import FILES, compare
