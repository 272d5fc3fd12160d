"""Watchers of the same settings share the threshold, whose simulation takes most of the time to make one."""

from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from dynident.apps.online import watcher


@pytest.fixture(autouse=True, scope="package")
def simulated_once() -> Iterator[None]:
    simulate, thresholds = watcher.threshold, dict[str, float]()

    def threshold(
        rate: float, block: float, ranks: Sequence[int], dof: float, rng: np.random.Generator, baseline: int
    ) -> float:
        key = repr((rate, block, list(ranks), dof, baseline, rng.bit_generator.state))
        if key not in thresholds:
            thresholds[key] = simulate(rate, block, ranks, dof, rng, baseline)
        return thresholds[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(watcher, "threshold", threshold)
        yield
