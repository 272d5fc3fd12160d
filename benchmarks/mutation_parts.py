"""The parts of the core that benchmarks/mutation.py tries: their files, the tests that should notice, the faults."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["EVERY", "OPERATORS", "PARTS", "Part"]

RANK = ("tests/regression", "tests/laws/test_certified.py", "tests/estimators/test_least_squares.py")
FITS = ("tests/estimators/constraints", "tests/estimators/physically_consistent")
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
    """A part of the core: files below src/dynident, and tests that run after those that mirror a file."""

    files: tuple[str, ...]
    tests: tuple[str, ...]


PARTS = {
    "splines": Part(
        tuple(
            f"splines/{name}.py"
            for name in ("banded", "bspline", "compiled", "noise", "rules", "search", "series", "spline")
        ),
        ("tests/splines/test_spline.py", "tests/splines/test_rules.py", "tests/smoothers/test_spline.py"),
    ),
    "spikes": Part(("splines/spikes.py",), ("tests/checks/test_channels.py",)),
    "regression": Part(("regression/linear_problem.py", "regression/rank.py"), (*RANK, "tests/laws/test_rank.py")),
    "base parameters": Part(("regression/base_parameters.py",), (*RANK, "tests/laws/test_rank.py")),
    "estimators": Part(
        (
            *("estimators/least_squares.py", "estimators/linear.py"),
            *("estimators/physically_consistent/*.py", "estimators/constraints/*.py"),
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
        ("regression/whitening.py", "estimators/noise.py", "estimators/feasible.py"),
        tuple(f"tests/estimators/test_{kind}_least_squares.py" for kind in ("weighted", "generalised")),
    ),
    "robust": Part(
        tuple(f"estimators/{name}.py" for name in ("robust", "reweighting", "ridge", "total_least_squares")),
        ("tests/estimators/test_robust.py", "tests/estimators/test_linear.py"),
    ),
    "instruments": Part(("estimators/instrumental_variables/*.py",), ("tests/estimators/instrumental_variables",)),
    "output error": Part(("estimators/output_error/*.py",), ("tests/estimators/output_error",)),
    "Kalman filter": Part(("estimators/augmented_kalman/*.py",), ("tests/estimators/augmented_kalman",)),
    "Wiener processes": Part(
        ("splines/wiener.py", "splines/quintic.py", "smoothers/kalman.py"),
        ("tests/splines/test_wiener.py", "tests/smoothers/test_kalman.py"),
    ),
    "local and periodic": Part(
        tuple(
            f"smoothers/{name}.py"
            for name in ("local_polynomials", "savitzky_golay", "period", "harmonics", "harmonic_sums", "periodic_fit")
        ),
        ("tests/smoothers/test_savitzky_golay.py", "tests/smoothers/test_fourier.py"),
    ),
    "simulation": Part(("simulation/*.py",), ("tests/simulation", "tests/models/test_simulation.py")),
    "ranking": Part(
        tuple(f"ranking/{name}.py" for name in ("differences", "blocks", "assemble", "ranking", "truth")),
        ("tests/ranking", "tests/report/test_ranking.py"),
    ),
    "hac": Part(("validation/hac.py", "regression/long_run.py"), ("tests/estimators/test_least_squares.py",)),
    "verdict": Part(
        ("identification/verdict/*.py", "report/verdict.py", "report/advice.py"),
        ("tests/identification/test_verdict.py", "tests/report/test_wording.py", "tests/report/test_verdict.py"),
    ),
    "terms": Part(
        tuple(
            f"models/{name}.py"
            for name in ("term", "model", "friction/*", "motor", "rigid_bodies", "lagrangian", "lumping")
        ),
        TERMS,
    ),
    "inertia": Part(("models/inertia.py",), ("tests/models/test_rigid_bodies.py", *FITS)),
}
