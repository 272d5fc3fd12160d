"""The parallel filter: pieces that fit together, its gain, and decimation."""

from typing import Any

import numpy as np
import pytest

from dynident.motion.splines import stretches
from dynident.regression import ParallelFilter, Regression, Selection, linear_problem
from dynident.runtime import ConfigError
from tests.regression.random_motion import ARM, RATE, drawn, holes, motion

FILTERS = [
    ParallelFilter(cutoff=20.0, order=2),
    ParallelFilter(cutoff=45.0, order=3),
    ParallelFilter(cutoff=25.0, order=1),
    ParallelFilter(decimate=3),
    ParallelFilter(decimate=7, cutoff=6.0),
]
every_filter = pytest.mark.parametrize("parallel_filter", FILTERS, ids=repr)


@every_filter
@pytest.mark.parametrize("size", [1, 64, 301])
def test_filtered_pieces_fit_together(
    monkeypatch: pytest.MonkeyPatch, parallel_filter: ParallelFilter, size: int
) -> None:
    """Pieces with overlap are what filtering each stretch at once gives, on one grid of decimation."""
    monkeypatch.setattr(linear_problem, "BLOCK", size)
    monkeypatch.setattr(linear_problem, "BLOCK_ENTRIES", size)
    made = motion(3000, mask=holes(3000))
    Y, tau = drawn((made,), parallel_filter)
    sections = parallel_filter.sections(made)
    regressor = ARM.regressor(made.q, made.dq, made.ddq)
    kept = [part for part in stretches(made.mask) if part.stop - part.start > 1]
    for result, x in ((Y, regressor), (tau, made.tau)):
        direct = np.concatenate(
            [parallel_filter.apply(sections, x[part])[:: parallel_filter.decimate] for part in kept]
        )
        np.testing.assert_allclose(result, direct, rtol=0, atol=1e-9 * np.abs(direct).max())


@pytest.mark.parametrize("frequency", [1.0, 5.0, 12.0])
def test_gain_of_the_filter(frequency: float) -> None:
    """Forward and backward: without phase, gain 1 / (1 + r^(2 order)), r the ratio of the warped frequencies."""
    parallel_filter, samples = ParallelFilter(cutoff=5.0, order=2), 4000
    made = motion(samples)
    x = np.cos(2 * np.pi * frequency * made.t)
    ratio = np.tan(np.pi * frequency / RATE) / np.tan(np.pi * 5.0 / RATE)
    result = parallel_filter.apply(parallel_filter.sections(made), x)[500:-500]
    np.testing.assert_allclose(result, x[500:-500] / (1 + ratio**4), atol=1e-6)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "give decimate > 1, a cutoff in Hz, or both"),
        ({"decimate": 0}, "decimate = 0"),
        ({"decimate": 2.5}, "decimate = 2.5"),
        ({"decimate": 2, "order": 0}, "order = 0"),
        ({"decimate": 2, "order": 1.5}, "order = 1.5"),
        ({"cutoff": 0.0}, "cutoff = 0.0; give a number above 0"),
        ({"cutoff": -3.0}, "cutoff = -3.0; give a number above 0"),
        ({"cutoff": float("nan")}, "cutoff = nan; give a number above 0"),
    ],
)
def test_wrong_settings_of_the_filter(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        ParallelFilter(**settings)


@pytest.mark.parametrize("cutoff", [50.0, 80.0, 1e5])
def test_cutoff_above_half_the_sampling_rate(cutoff: float) -> None:
    with pytest.raises(
        ConfigError, match=rf"made: the parallel filter's cut-off {cutoff:g} Hz does not lie below half .* \(50 Hz\)"
    ):
        _ = Regression(ARM, (motion(),), Selection(ParallelFilter(cutoff=cutoff))).triangular_factors
