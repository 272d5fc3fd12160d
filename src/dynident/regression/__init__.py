"""The linear problem tau = Y theta: rows, parallel filter, triangular factors, rank and base parameters."""

from dynident.regression.base_parameters import (
    BaseParameters,
    UnexcitedParameters,
    base_parameters,
    base_std,
    compare,
    informed_std,
    structural_base_parameters,
)
from dynident.regression.groups import Group, GroupKind, groups_of, independent_columns, kinds_of
from dynident.regression.linear_problem import (
    BLOCK,
    Regression,
    RegressorBlock,
    fast_enough,
    fitted_rows,
    stretches,
    triangularise,
)
from dynident.regression.parallel_filter import HIGHEST_ORDER, ParallelFilter
from dynident.regression.parts import Part, divided, factors_of_parts, merged, packed, unpacked
from dynident.regression.rank import Rank, precision, rank_of, rank_of_information
from dynident.regression.triangular import EntryBlock, TriangularFactors, factorise, one_thread
from dynident.regression.whitening import Whitening, ages, is_stable, joined

__all__ = [
    "BLOCK",
    "HIGHEST_ORDER",
    "BaseParameters",
    "EntryBlock",
    "Group",
    "GroupKind",
    "ParallelFilter",
    "Part",
    "Rank",
    "Regression",
    "RegressorBlock",
    "TriangularFactors",
    "UnexcitedParameters",
    "Whitening",
    "ages",
    "base_parameters",
    "base_std",
    "compare",
    "divided",
    "factorise",
    "factors_of_parts",
    "fast_enough",
    "fitted_rows",
    "groups_of",
    "independent_columns",
    "informed_std",
    "is_stable",
    "joined",
    "kinds_of",
    "merged",
    "one_thread",
    "packed",
    "precision",
    "rank_of",
    "rank_of_information",
    "stretches",
    "structural_base_parameters",
    "triangularise",
    "unpacked",
]
