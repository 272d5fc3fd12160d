"""Sums over windows of all lengths, in memory that does not grow."""

from __future__ import annotations

import numpy as np

from dynident.apps.online.scores import MAX_EQUAL_LENGTHS, Sums, push_sums, suffix_sums


def one(k: int) -> Sums:
    x = np.array([float(k)])
    return Sums(float(k), k + 1.0, 1, 10, x[:, None], x, x, x, x, np.ones(1))


def test_windows_that_end_now_have_the_sums_of_their_blocks() -> None:
    kept: tuple[Sums, ...] = ()
    for k in range(1000):
        kept = push_sums(kept, one(k))
    starts, sums = suffix_sums(kept)
    assert len(kept) <= (MAX_EQUAL_LENGTHS + 1) * (1 + int(np.log2(1000)))
    assert starts[-1] == 0.0
    assert sums["count"].tolist() == (1000 - starts).tolist()
    np.testing.assert_allclose(sums["score"][:, 0], [sum(range(int(start), 1000)) for start in starts])
    assert (sums["samples"] == 10 * sums["count"]).all()


def test_windows_are_known_to_a_share_of_their_length() -> None:
    kept: tuple[Sums, ...] = ()
    for k in range(5000):
        kept = push_sums(kept, one(k))
    lengths = suffix_sums(kept)[1]["count"]
    assert lengths[:MAX_EQUAL_LENGTHS].tolist() == list(range(1, MAX_EQUAL_LENGTHS + 1)) or lengths[0] == 1
    assert (lengths[1:] <= lengths[:-1] + np.maximum(2, 0.5 * lengths[:-1])).all()
