"""Scores of two passes that are instruments of each other are no independent ones."""

from __future__ import annotations

import numpy as np

from dynident.estimators.instrument_moments import _add_partner_scores
from dynident.estimators.instruments import InstrumentKind, Instruments
from tests.estimators.looped import driven

MOTION, _ = driven(60)


def instruments(other: int, partner: np.ndarray) -> Instruments:
    return Instruments(MOTION, InstrumentKind.REPEATED, None, other, partner)


def test_paired_samples_are_added_once() -> None:
    """The second recording is 5 samples late, of both each third sample is left; the last ones have no partner."""
    n = 60
    there, back = np.arange(n) + 5, np.arange(n) - 5
    there[there >= n] = -1
    back[back < 0] = -1
    at, places = np.arange(0, n, 3), np.arange(2, n, 3)
    u, v = np.ones((len(at), 1)), np.full((len(places), 1), 10.0)
    _add_partner_scores((at, u), (places, v), instruments(1, there), instruments(0, back))
    assert set(np.unique(u)) <= {1.0, 11.0}
    assert float(u.sum() + v.sum()) == len(at) + 10.0 * len(places)
    assert (u[there[at] >= 0] == 11.0).all()
    assert (u[there[at] < 0] == 1.0).all()


def test_of_a_recording_that_repeats_itself_the_later_pass_is_added_to_the_earlier() -> None:
    partner = np.r_[np.arange(30) + 30, np.arange(30)]
    one = np.arange(60), np.arange(60.0)[:, None]
    _add_partner_scores(one, one, instruments(0, partner), instruments(0, partner))
    np.testing.assert_array_equal(one[1][:30, 0], 2 * np.arange(30) + 30)
    np.testing.assert_array_equal(one[1][30:], 0.0)
