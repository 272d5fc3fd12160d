"""The article's Monte Carlo study, run again."""

from dynident.apps.article.article import (
    LEVELS,
    METHODS,
    PUBLISHED,
    SCENARIOS,
    ArmScenario,
    Reproduction,
    SmoothAndFit,
    StudyCase,
    method_of,
    reproduce,
)
from dynident.apps.article.report import findings, study_page, study_tables, study_text
from dynident.apps.article.study import FitOutcome, Method, Scenario, Statistics, run_study, statistics
