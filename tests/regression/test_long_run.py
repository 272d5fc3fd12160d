"""The bandwidth of the long-run covariance: Andrews' formula, printed and by hand."""

import numpy as np
import pytest
from scipy.signal import lfilter

from dynident.regression.whitening import bandwidth


def andrews(series: list[np.ndarray]) -> int:
    """Andrews (1991), eqs. (5.3) and (6.4) for Bartlett's kernel, as printed: alpha(1) of AR(1) fits, weights one.

    Columns are brought to unit variance; a pair of neighbours counts only inside a stretch.
    """
    samples = sum(map(len, series))
    above = below = 0.0
    for k in range(series[0].shape[1]):
        columns = [x[:, k] for x in series]
        total = sum(float(x @ x) for x in columns)
        rho = sum(float(x[1:] @ x[:-1]) for x in columns) / total
        fourth = (1.0 - rho * rho) ** 2
        above += 4 * rho**2 * fourth / ((1 - rho) ** 6 * (1 + rho) ** 2)
        below += fourth / (1 - rho) ** 4
    return int(np.ceil(1.1447 * (above / below * samples) ** (1 / 3)))


@pytest.mark.parametrize("rho", [(0.9,), (0.2, 0.8, -0.5), (-0.7, 0.1)])
def test_bandwidth_is_andrews_formula_over_stretches_and_columns(rho: tuple[float, ...]) -> None:
    rng = np.random.default_rng(1)
    series = [
        np.column_stack(
            [10.0 ** (-4 * k) * lfilter([1.0], [1.0, -r], rng.standard_normal(rows)) for k, r in enumerate(rho)]
        )
        for rows in (3000, 1700)
    ]
    assert 1 < andrews(series) < 470
    assert bandwidth(iter([iter(np.array_split(x, 6)) for x in series])) == andrews(series)


def test_bandwidth_has_limits() -> None:
    """A tenth of the samples, and one sample for series that are too short, all zero or without correlation."""
    slow = np.cumsum(np.random.default_rng(0).standard_normal((200, 1)), axis=0)
    assert bandwidth(iter([iter([slow])])) == 20
    assert bandwidth(iter([iter([slow[:9]])])) == 1
    assert bandwidth(iter([iter([np.zeros((500, 2))])])) == 1
    assert bandwidth(iter([iter([np.array([[1.0], [1.0], [-1.0], [-1.0]] * 100)[:-1]])])) == 1
    constant = np.ones((100_000, 1))
    rho = 0.9999
    capped = 1.1447 * (4 * rho**2 / (1 - rho**2) ** 2 * 1e5) ** (1 / 3)
    assert bandwidth(iter([iter([constant])])) == min(int(np.ceil(capped)), 10_000)
