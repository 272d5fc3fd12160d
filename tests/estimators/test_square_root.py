"""The square-root filter: in the linear and Gaussian case it is exact least squares."""

import numpy as np

from dynident.estimators.augmented_kalman_steps import correct_state, lower_root


def test_linear_case_is_least_squares():
    """A constant parameter drives a position; the filter's end is the weighted fit of all that is known together."""
    rng = np.random.default_rng(0)
    steps, sigma, noise, start = 30, np.array([0.1]), 0.05, np.diag([1.0, 2.0, 3.0])
    F = np.array([[1.0, 0.1, 0.005], [0.0, 1.0, 0.1], [0.0, 0.0, 1.0]])
    G = np.array([[0.005], [0.1], [0.0]])
    y = rng.standard_normal(steps)
    x, S = np.zeros((1, 3)), start[None]
    for one in y:
        x, S, _ = correct_state(
            (F @ x.T).T, lower_root(np.concatenate([F @ S, (noise * G)[None]], axis=2)), one[None, None], sigma
        )
    # the unknowns: the first state and the noise of each step
    rows, right = [np.linalg.inv(start) @ np.eye(3, 3 + steps)], [np.zeros(3)]
    state = np.eye(3, 3 + steps)
    for k, one in enumerate(y):
        state = F @ state + G @ np.eye(3 + steps)[[3 + k]]
        rows += [np.eye(3 + steps)[[3 + k]] / noise, state[:1] / sigma]
        right += [np.zeros(1), one / sigma]
    X = np.concatenate(rows)
    found = np.linalg.lstsq(X, np.concatenate(right), rcond=None)[0]
    np.testing.assert_allclose(x[0], state @ found, rtol=1e-9)
    np.testing.assert_allclose(S[0] @ S[0].T, state @ np.linalg.inv(X.T @ X) @ state.T, rtol=1e-9)
