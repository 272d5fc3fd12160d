"""Two saved results of one robot, side by side."""

from dynident.apps.compare_results.comparison import (
    BaseDifference,
    ComparedLog,
    ComparedResult,
    ExportRecord,
    LogDifference,
    ResultComparison,
    compare_results,
)
