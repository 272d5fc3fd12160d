"""The whole method: calibrate, choose a smoother, estimate, validate, judge."""

from dynident.identification.base_tilt import BaseTilt, SteepBase, find_base_tilt, has_gravity, mounted
from dynident.identification.block_bootstrap import Bootstrap, bootstrap
from dynident.identification.comparison import (
    BaseDifference,
    ComparedLog,
    ComparedResult,
    ExportRecord,
    LogDifference,
    ResultComparison,
    compare_results,
)
from dynident.identification.cross_validation import Gain
from dynident.identification.division import Division, LongRecording, Span, Stretch
from dynident.identification.identify import estimated, identify
from dynident.identification.long import InPieces, Prepared, finished, prepared
from dynident.identification.prior_strength import PriorStrength, find_prior_strength
from dynident.identification.recipe import Recipe
from dynident.identification.reducer import Reduced
from dynident.identification.rests import Rests, hardly_moving, moving_span, resting, whole_rests
from dynident.identification.result import (
    Calibration,
    Identifiability,
    Identification,
    OldResult,
    SourceFile,
    Sources,
    StandardErrors,
    versions,
)
from dynident.identification.role_logs import NotFitted, NotJudged, SubstituteUsed, substituted
from dynident.identification.smoother_choice import Choice, choose_smoother, cross_validated_error, excerpts
from dynident.identification.terms import Kind, NotChosen, Outcome, PlainTerms, TermChoice, Trial, choose_terms
from dynident.identification.time_offset import Pairing, TimeOffset, find_time_offset, pair
from dynident.identification.verdict.reasons import Reason
from dynident.identification.verdict.rules import judge
from dynident.identification.verdict.steps import Remedy, Step
from dynident.identification.verdict.verdict import HeldOut, LargestResidual, Use, Verdict, WorstRun

__all__ = [
    "BaseDifference",
    "BaseTilt",
    "Bootstrap",
    "Calibration",
    "Choice",
    "ComparedLog",
    "ComparedResult",
    "Division",
    "ExportRecord",
    "Gain",
    "HeldOut",
    "Identifiability",
    "Identification",
    "InPieces",
    "Kind",
    "LargestResidual",
    "LogDifference",
    "LongRecording",
    "NotChosen",
    "NotFitted",
    "NotJudged",
    "OldResult",
    "Outcome",
    "Pairing",
    "PlainTerms",
    "Prepared",
    "PriorStrength",
    "Reason",
    "Recipe",
    "Reduced",
    "Remedy",
    "Rests",
    "ResultComparison",
    "SourceFile",
    "Sources",
    "Span",
    "StandardErrors",
    "SteepBase",
    "Step",
    "Stretch",
    "SubstituteUsed",
    "TermChoice",
    "TimeOffset",
    "Trial",
    "Use",
    "Verdict",
    "WorstRun",
    "bootstrap",
    "choose_smoother",
    "choose_terms",
    "compare_results",
    "cross_validated_error",
    "estimated",
    "excerpts",
    "find_base_tilt",
    "find_prior_strength",
    "find_time_offset",
    "finished",
    "hardly_moving",
    "has_gravity",
    "identify",
    "judge",
    "mounted",
    "moving_span",
    "pair",
    "prepared",
    "resting",
    "substituted",
    "versions",
    "whole_rests",
]
