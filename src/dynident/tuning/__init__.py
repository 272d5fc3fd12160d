"""Tuning by hand: one set of logs and a model, and what each setting makes of them, fast enough to watch."""

from dynident.tuning.address import of_query, to_query
from dynident.tuning.bench import Bench
from dynident.tuning.curve import DegreeCurve
from dynident.tuning.quick_fit import LogFit, QuickFit
from dynident.tuning.smoothed import Smoothed
from dynident.tuning.tuning import Tuning

__all__ = ["Bench", "DegreeCurve", "LogFit", "QuickFit", "Smoothed", "Tuning", "of_query", "to_query"]
