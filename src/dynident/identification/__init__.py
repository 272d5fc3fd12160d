"""The method: align, calibrate, estimate, validate and judge."""

from dynident.identification.accuracy_bound import (
    CHANGES,
    AccuracyBound,
    Measure,
    Noise,
    Origin,
    TorqueNoise,
    accuracy_bound,
    noise_of,
)
from dynident.identification.base_tilt import BaseTilt, SteepBase, find_base_tilt
from dynident.identification.bootstrap import Bootstrap, bootstrap
from dynident.identification.calibration import Calibration, with_plain_terms
from dynident.identification.cramer_rao import cramer_rao_bound, information, normal_matrices, variance
from dynident.identification.cross_validation import Gain, cross_validated_error
from dynident.identification.dataset import (
    Logs,
    NotFitted,
    NotJudged,
    NotLogged,
    SubstituteUsed,
    logs_by_name,
    substitute_notes,
)
from dynident.identification.identify import estimate_parameters, identify
from dynident.identification.long import InPieces, PiecePlan, identify_from_pieces, plan_pieces
from dynident.identification.mounting import find_mounting, has_gravity, tilt_base
from dynident.identification.pieces import DivisionSettings, LongRecording, PieceFactors, Span, Stretch
from dynident.identification.prior_strength import PriorStrength, find_prior_strength
from dynident.identification.recipe import Recipe, Rests, arm_rests, held_joints, moving_span, rest_blocks
from dynident.identification.result import (
    Identifiability,
    Identification,
    SourceFile,
    Sources,
    StandardErrors,
    versions,
)
from dynident.identification.smoother_choice import SmootherChoice, choose_smoother, cut_excerpts
from dynident.identification.time_offset import Alignment, TimeOffset, align_motion, find_time_offset
from dynident.identification.verdict import HeldOut, LargestResidual, Verdict, WorstRun
from dynident.identification.verdict_reasons import Reason
from dynident.identification.verdict_rules import judge
from dynident.identification.verdict_steps import NextStep, Remedy
