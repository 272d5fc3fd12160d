"""The whole method: calibrate, choose a smoother, estimate, validate, judge."""

from dynident.identification.base_tilt import BaseTilt, find_base_tilt, mounted
from dynident.identification.identify import identify
from dynident.identification.recipe import Recipe
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
from dynident.identification.smoother_choice import Choice, choose_smoother, cross_validated_error, excerpts
from dynident.identification.terms import Kind, Outcome, TermChoice, Trial, choose_terms
from dynident.identification.terms.added import with_chosen_terms, with_plain_terms
from dynident.identification.time_offset import Pairing, TimeOffset, find_time_offset, pair
from dynident.identification.verdict.reasons import Reason
from dynident.identification.verdict.rules import judge
from dynident.identification.verdict.steps import Remedy, Step
from dynident.identification.verdict.verdict import HeldOut, LargestResidual, Use, Verdict, WorstRun

__all__ = [
    "BaseTilt",
    "Calibration",
    "Choice",
    "HeldOut",
    "Identifiability",
    "Identification",
    "Kind",
    "LargestResidual",
    "OldResult",
    "Outcome",
    "Pairing",
    "Reason",
    "Recipe",
    "Remedy",
    "SourceFile",
    "Sources",
    "StandardErrors",
    "Step",
    "TermChoice",
    "TimeOffset",
    "Trial",
    "Use",
    "Verdict",
    "WorstRun",
    "choose_smoother",
    "choose_terms",
    "cross_validated_error",
    "excerpts",
    "find_base_tilt",
    "find_time_offset",
    "identify",
    "judge",
    "mounted",
    "pair",
    "versions",
    "with_chosen_terms",
    "with_plain_terms",
]
