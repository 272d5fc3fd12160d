"""Smoothers and estimators on the same data, ranked by the torque error on motion that was held out."""

from dynident.ranking.candidates import Candidate, Combination
from dynident.ranking.ranking import Absent, Ranked, Ranking, TruthFigures, mean_of
from dynident.ranking.rows import Outcome
from dynident.ranking.run import FILES, NUMBERS, REPORT, TABLE, run_comparison

__all__ = [
    "FILES",
    "NUMBERS",
    "REPORT",
    "TABLE",
    "Absent",
    "Candidate",
    "Combination",
    "Outcome",
    "Ranked",
    "Ranking",
    "TruthFigures",
    "mean_of",
    "run_comparison",
]
