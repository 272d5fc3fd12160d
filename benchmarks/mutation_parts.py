"""The parts of the core that benchmarks/mutation.py tries: their files, the tests that should notice, the faults."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["EVERY", "OPERATORS", "PARTS", "Part"]

RANK = ("tests/regression", "tests/laws/test_certified.py", "tests/estimators/test_least_squares.py")
CONSTRAINTS = ("barrier", "central_path", "cone", "constraints", "inner", "prior", "sizes", "staged")
FITS = (
    *(f"tests/estimators/test_{name}.py" for name in CONSTRAINTS),
    "tests/estimators/test_physically_consistent_fit.py",
)
ESTIMATORS = (
    "tests/estimators/test_least_squares.py",
    *FITS,
    "tests/laws/test_estimators.py",
    "tests/laws/test_rank.py",
)
EVERY = ("tests/meta/test_nouns.py",)
TERMS = ("tests/models/test_model.py", "tests/laws/test_rigid_bodies.py", "tests/laws/test_models.py")
OPERATORS = tuple(
    f"core/{name}"
    for name in (
        *("ReplaceBinaryOperator_" + pair for pair in ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "FloorDiv_Mul")),
        *("ReplaceBinaryOperator_" + pair for pair in ("Mod_Mul", "Pow_Mul", "BitAnd_BitOr", "BitOr_BitAnd")),
        *("ReplaceComparisonOperator_" + pair for pair in ("Lt_LtE", "LtE_Lt", "Gt_GtE", "GtE_Gt")),
        *("ReplaceComparisonOperator_" + pair for pair in ("Lt_GtE", "LtE_Gt", "Gt_LtE", "GtE_Lt", "Eq_NotEq")),
        *("ReplaceComparisonOperator_" + pair for pair in ("NotEq_Eq", "Is_IsNot", "IsNot_Is")),
        *("ReplaceUnaryOperator_" + pair for pair in ("Delete_USub", "Delete_Not", "Delete_Invert")),
        *("ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd", "AddNot"),
        *("ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ZeroIterationForLoop"),
        *("NumberReplacer", "ExceptionReplacer"),
    )
)


@dataclass(frozen=True)
class Part:
    """A part of the core: files below src/dynident, and tests that run after those nearest to a file."""

    files: tuple[str, ...]
    tests: tuple[str, ...]


PARTS = {
    "splines": Part(
        tuple(
            f"motion/splines/{name}.py"
            for name in ("banded", "compiled", "quintic", "rules", "search", "series", "spline")
        ),
        (
            *("tests/motion/splines/test_spline.py", "tests/motion/splines/test_rules.py"),
            "tests/motion/smoothers/test_spline.py",
        ),
    ),
    "spikes": Part(("motion/splines/spikes.py",), ("tests/checks/test_channels.py",)),
    "regression": Part(
        ("regression/linear_problem.py", "regression/triangular.py"), (*RANK, "tests/laws/test_rank.py")
    ),
    "base parameters": Part(("regression/base_parameters.py",), (*RANK, "tests/laws/test_rank.py")),
    "estimators": Part(
        (
            *("estimators/least_squares.py", "estimators/physically_consistent.py"),
            "estimators/*.py",
        ),
        ESTIMATORS,
    ),
    "maximum likelihood": Part(
        ("estimators/maximum_likelihood/*.py",),
        ("tests/estimators/maximum_likelihood", "tests/laws/test_estimators.py"),
    ),
    "calibration": Part(
        ("identification/time_offset.py", "identification/base_tilt.py"),
        ("tests/identification/test_time_offset.py", "tests/identification/test_base_tilt.py"),
    ),
    "whitening": Part(
        ("regression/whitening.py", "estimators/noise.py", "estimators/generalised_least_squares.py"),
        tuple(f"tests/estimators/test_{kind}_least_squares.py" for kind in ("weighted", "generalised")),
    ),
    "robust": Part(
        tuple(f"estimators/{name}.py" for name in ("robust_least_squares", "ridge", "total_least_squares")),
        ("tests/estimators/test_robust.py", "tests/estimators/test_linear.py"),
    ),
    "instruments": Part(
        tuple(f"estimators/{name}.py" for name in ("instrumental_variables", "instruments", "instrument_moments")),
        tuple(
            f"tests/estimators/test_{name}.py"
            for name in ("instrumental_variables_fit", "lagged", "moments", "resmoothed", "scores")
        ),
    ),
    "output error": Part(
        tuple(f"estimators/{name}.py" for name in ("output_error", "output_error_descent", "simulated_recordings")),
        tuple(f"tests/estimators/test_{name}.py" for name in ("output_error", "didim", "first", "first_model")),
    ),
    "Kalman filter": Part(
        ("estimators/augmented_kalman.py", "estimators/augmented_kalman_steps.py"),
        tuple(
            f"tests/estimators/test_{name}.py" for name in ("augmented_kalman_fit", "dynamics", "series", "square_root")
        ),
    ),
    "Wiener processes": Part(
        ("motion/smoothers/kalman.py", "motion/splines/quintic.py"),
        ("tests/motion/smoothers/test_wiener.py", "tests/motion/smoothers/test_kalman.py"),
    ),
    "local and periodic": Part(
        tuple(f"motion/smoothers/{name}.py" for name in ("savitzky_golay", "harmonics", "periodic_fit")),
        ("tests/motion/smoothers/test_savitzky_golay.py", "tests/motion/smoothers/test_fourier.py"),
    ),
    "simulation": Part(("models/simulation/*.py",), ("tests/models/simulation",)),
    "ranking": Part(
        tuple(f"apps/ranking/{name}.py" for name in ("differences", "assemble", "ranking")), ("tests/apps/ranking",)
    ),
    "hac": Part(
        ("validation/standard_errors.py", "regression/whitening.py"), ("tests/estimators/test_least_squares.py",)
    ),
    "verdict": Part(
        ("identification/verdict*.py", "report/identification/report.py"),
        (
            "tests/identification/test_verdict.py",
            "tests/report/test_wording.py",
            "tests/report/identification/test_verdict.py",
        ),
    ),
    "terms": Part(
        tuple(
            f"models/{name}.py"
            for name in ("term", "model", "evaluation", "friction/*", "motor", "rigid_bodies", "lagrangian", "lumping")
        ),
        TERMS,
    ),
    "inertia": Part(("models/inertia.py",), ("tests/models/test_rigid_bodies.py", *FITS)),
}
