"""What a likelihood's end tells: its inverse and what that leaves open."""

import numpy as np

from dynident.estimators.findings import covariance_of, inverted


def test_the_inverse_of_a_singular_information_keeps_what_undetermined_parameters_share() -> None:
    """Scores need the whole pseudo-inverse; the covariance tells nothing of what is not determined."""
    rng = np.random.default_rng(0)
    X = rng.standard_normal((50, 3)) * [1.0, 10.0, 0.1]
    S = np.concatenate([X, X[:, :1] + X[:, 2:]], axis=1)  # the last acts as the first and the third
    S = S.T @ S
    inverse, rank, condition, lost = inverted(S)
    np.testing.assert_allclose(S @ inverse @ S, S, atol=1e-9 * S.max())
    assert rank == 3
    assert condition > 1e6
    assert lost.tolist() == [True, False, True, True]
    assert np.abs(inverse[1, lost]).max() > 0
    covariance = covariance_of(inverse, lost)
    assert np.isinf(np.diag(covariance)[lost]).all()
    assert covariance[1, 1] == inverse[1, 1]
    assert np.count_nonzero(covariance[1]) == 1
