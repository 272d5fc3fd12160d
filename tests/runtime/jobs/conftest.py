"""Settings of the tests of jobs."""

from collections.abc import Iterator

import pytest

from dynident.runtime.jobs import workers


@pytest.fixture(autouse=True, scope="module")
def light() -> Iterator[None]:
    """Workers without what real jobs need start in no time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workers, "PRELOADED_MODULES", ())
        yield
