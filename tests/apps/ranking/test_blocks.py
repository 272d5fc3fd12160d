"""Blocks of time."""

from __future__ import annotations

import numpy as np

from dynident.apps.ranking.differences import time_blocks
from dynident.motion.log import Log


def test_blocks_are_of_equal_time_and_of_one_log_each() -> None:
    logs = {
        name: Log(t, np.sin(t)[:, None], np.cos(t)[:, None], ("a",), name)
        for name, t in (("long", np.arange(3000) * 0.01), ("short", np.arange(1000) * 0.01))
    }
    blocks = time_blocks(logs)
    assert len(blocks) == 400
    assert np.bincount(blocks.log).tolist() == [300, 100]
    sums = blocks.sums({name: np.ones((len(log), 2)) for name, log in logs.items()})
    assert sums.sum(axis=0).tolist() == [4000.0, 4000.0]
    assert (np.abs(sums - 10.0) <= 1.0).all()
    assert len(time_blocks({"short": logs["short"].rows(slice(0, 7), "short")})) == 3
