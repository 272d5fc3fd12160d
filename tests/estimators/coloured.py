"""Problems whose noise is known: autoregressions with correlated innovations."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from dynident.estimators import Estimator, Problem
from dynident.models import Model
from dynident.models.lagrangian import two_link_arm
from dynident.regression import Regression, Whitening
from dynident.testing.estimator import make_problem, multisine_motion

Array = NDArray[np.float64]
ARM = two_link_arm()
S = np.array([[1.0, 0.6], [0.6, 1.5]]) * 1e-4
CORRELATED = Whitening((np.zeros(0), np.zeros(0)), S)
COLOURED = Whitening((np.array([1.2, -0.5]), np.array([0.9])), S)


def drawn(noise: Whitening, samples: int, rng: np.random.Generator) -> Array:
    """Noise (N, n)."""
    u = rng.standard_normal((samples + 500, len(noise.covariance))) @ np.linalg.cholesky(noise.covariance).T
    columns = (lfilter([1.0], np.append(1.0, -a), u[:, j])[500:] for j, a in enumerate(noise.coefficients))
    return np.stack(list(columns), axis=1)


def noisy(noise: Whitening, seed: int, samples: int = 1000, model: Model = ARM, count: int = 1) -> Problem:
    """The problem of exact motions and a torque with noise."""
    rng = np.random.default_rng(seed)
    exact = [multisine_motion(model, samples=samples, seed=k) for k in range(count)]
    return make_problem(model, *(replace(x, tau=x.tau + drawn(noise, samples, rng)) for x in exact))


def bound(noise: Whitening, samples: int = 1000) -> Array:
    """The least standard errors (p) of a linear fit that has no bias, (X' V^-1 X)^-1."""
    exact = multisine_motion(ARM, samples=samples)
    R = Regression(ARM, (exact,), whitening=noise).triangular_factors.stack()[:-1, :-1]
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(R.T @ R))))


def repeated(noise: Whitening, estimator: Estimator, runs: int) -> tuple[Array, Array]:
    """The errors (runs, p) of an estimator, and its standard errors."""
    result = [estimator(noisy(noise, seed)) for seed in range(runs)]
    return np.stack([x.value for x in result]) - ARM.values, np.stack([x.std for x in result])
