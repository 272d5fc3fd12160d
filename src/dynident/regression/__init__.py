"""The linear problem tau = Y theta: rows, parallel filter, triangular factors, rank and base parameters."""

from dynident.regression.base_parameters import (
    BaseParameters,
    UnexcitedParameters,
    base_parameters,
    base_std,
    find_unexcited,
    informed_std,
    structural_base_parameters,
)
from dynident.regression.groups import (
    MAX_REPEAT_DIFFERENCE,
    GroupKind,
    ParameterGroup,
    evidence,
    groups_of,
    independent_columns,
    kinds_of,
    repeat_of,
    repeats_path,
)
from dynident.regression.linear_problem import (
    BLOCK,
    EVERYTHING,
    Regression,
    RegressionPart,
    RegressorBlock,
    Selection,
    divide_regression,
    factors_of_parts,
    fitted_mask,
    fitted_rows,
)
from dynident.regression.rank import Rank, precision, rank_of, rank_of_information
from dynident.regression.triangular import (
    EntryBlock,
    Reduction,
    TriangularFactors,
    factorise,
    merge_factors,
    one_thread,
    pack_factors,
    unpack_factors,
)
from dynident.regression.whitening import (
    HIGHEST_ORDER,
    ParallelFilter,
    Whitening,
    is_stable,
    join_blocks,
    preceding_counts,
)
