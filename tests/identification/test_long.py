"""Identification in pieces finds what identification of the whole finds, and says how sure that is."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.estimators import Estimator, LeastSquares, PhysicallyConsistent
from dynident.identification import (
    Division,
    Identification,
    InPieces,
    Prepared,
    Recipe,
    Stretch,
    finished,
    identify,
    prepared,
)
from dynident.jobs import run_jobs
from dynident.log import Log
from dynident.models import record, simulate
from dynident.models.gallery import two_link_arm
from dynident.regression import ParallelFilter
from dynident.smoothers import Butterworth, Smoother, Spline

ARM = two_link_arm()
SMALL = Division(excerpts=3, excerpt=1500, piece=1000, pieces=10, shortest=500)
assert ARM.values is not None
THETA = ARM.values


@dataclass(frozen=True)
class Held:
    """A recording in memory, with gaps between its stretches."""

    log: Log
    edges: tuple[int, ...] = ()

    @property
    def label(self) -> str:
        return self.log.source

    @property
    def step(self) -> float:
        return float(np.median(np.diff(self.log.t)))

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        edges = [0, *self.edges, len(self.log)]
        return tuple(Stretch(a, b, float(self.log.t[a]), float(self.log.t[b - 1])) for a, b in pairwise(edges))

    def read(self, rows: slice) -> tuple[Log, NDArray[np.intp]]:
        part = self.log.rows(rows, self.log.source)
        return part, np.arange(len(part))


def recording(sigma_tau: float = 0.02, samples: int = 12_000, seed: int = 0) -> Log:
    t = np.arange(samples) * 0.005
    truth = simulate(
        ARM, THETA, lambda s: (1.13 * np.sin(1.7 * s) + 0.3 * np.sin(0.3 * s), 0.78 * np.cos(2.3 * s)), t,
        tolerance=1e-9,
    )  # fmt: skip
    return record(truth, 1e-5, sigma_tau, np.random.default_rng(seed), source="day").log


LOG = recording()


def in_pieces(ready: Prepared, validation: Sequence[Log] = ()) -> Identification:
    done = {one.job: one.value for one in run_jobs(ready.reducer, ready.spans)}
    pieces = [done[span] for span in ready.spans]
    return finished(ready, [one for one in pieces if one is not None], validation)


@pytest.mark.parametrize(
    ("smoother", "estimator", "low"),
    [
        (Spline(sigma=1e-5), LeastSquares(), None),
        (Spline(sigma=1e-5), LeastSquares(weights="per_joint"), ParallelFilter(cutoff=10.0)),
        (Butterworth(cutoffs=(20, 15, 10)), PhysicallyConsistent(), None),
    ],
    ids=["spline", "filter", "butterworth"],
)
def test_the_estimate_is_that_of_the_whole_to_rounding(
    smoother: Smoother, estimator: Estimator, low: ParallelFilter | None
) -> None:
    ready = prepared(ARM, [Held(LOG)], Recipe(smoother, estimator, low), SMALL)
    assert len(ready.spans) == 12
    found = in_pieces(ready)
    whole = identify(ARM, [LOG], recipe=found.recipe)  # with all that was chosen
    np.testing.assert_allclose(found.estimate.value, whole.estimate.value, rtol=1e-8)
    np.testing.assert_allclose(found.estimate.residual.sigma, whole.estimate.residual.sigma, rtol=1e-8)
    assert found.estimate.residual.samples == whole.estimate.residual.samples
    assert found.pieces is not None
    torque = np.sqrt((found.pieces.rows * found.pieces.torque**2).sum(axis=0) / found.pieces.rows.sum(axis=0))
    np.testing.assert_allclose(torque, [np.sqrt(np.mean(x**2)) for x in LOG.tau.T], rtol=0.1)
    note = next(one for one in found.notes if isinstance(one, InPieces))
    assert (note.samples, note.pieces, note.excerpts) == (12_000, 12, 3)
