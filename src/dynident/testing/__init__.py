"""What every smoother, term and estimator promises, as checks to be called from the tests of a new one.

Each ``check_...`` runs all checks of its family and raises AssertionError at the first that fails; ``..._CHECKS`` hold
them one by one, for ``pytest.mark.parametrize``.
"""

from dynident.testing.estimator import ESTIMATOR_CHECKS, check_estimator
from dynident.testing.smoother import SMOOTHER_CHECKS, check_smoother
from dynident.testing.term import TERM_CHECKS, check_term
