"""Studies: many simulated runs of many methods, the article's study, and the tables it published."""

from dynident.studies.article import (
    LEVELS,
    METHODS,
    SCENARIOS,
    ArmScenario,
    Case,
    Reproduction,
    SmoothAndFit,
    method_of,
    reproduce,
)
from dynident.studies.published_tables import PUBLISHED, Row
from dynident.studies.study import Method, Scenario, Statistics, run_study, statistics
from dynident.studies.table import Outcome

__all__ = [
    "LEVELS",
    "METHODS",
    "PUBLISHED",
    "SCENARIOS",
    "ArmScenario",
    "Case",
    "Method",
    "Outcome",
    "Reproduction",
    "Row",
    "Scenario",
    "SmoothAndFit",
    "Statistics",
    "method_of",
    "reproduce",
    "run_study",
    "statistics",
]
