"""Sums over windows of all lengths, in memory that does not grow."""

from __future__ import annotations

import numpy as np

from dynident.online.windows import EACH, Sums, pushed, suffixes


def one(k: int) -> Sums:
    x = np.array([float(k)])
    return Sums(float(k), k + 1.0, 1, 10, x[:, None], x, x, x, x, np.ones(1))


def test_windows_that_end_now_have_the_sums_of_their_blocks() -> None:
    kept: tuple[Sums, ...] = ()
    for k in range(1000):
        kept = pushed(kept, one(k))
    starts, sums = suffixes(kept)
    assert len(kept) <= (EACH + 1) * (1 + int(np.log2(1000)))
    assert starts[-1] == 0.0
    assert sums["count"].tolist() == (1000 - starts).tolist()
    np.testing.assert_allclose(sums["score"][:, 0], [sum(range(int(start), 1000)) for start in starts])
    assert (sums["samples"] == 10 * sums["count"]).all()


def test_windows_are_known_to_a_share_of_their_length() -> None:
    kept: tuple[Sums, ...] = ()
    for k in range(5000):
        kept = pushed(kept, one(k))
    lengths = suffixes(kept)[1]["count"]
    assert lengths[:EACH].tolist() == list(range(1, EACH + 1)) or lengths[0] == 1
    assert (lengths[1:] <= lengths[:-1] + np.maximum(2, 0.5 * lengths[:-1])).all()
