"""One bench for the tests of this folder."""

from __future__ import annotations

import pytest

from dynident.tuning import Bench
from tests.tuning.arms import bench, logs, recording


@pytest.fixture(scope="package")
def arm() -> Bench:
    """A small arm with a recording and a held-out one."""
    return bench(logs(recording(0, name="monday"), held=(recording(1, name="tuesday"),)))
