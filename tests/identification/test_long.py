"""Identification in pieces finds what identification of the whole finds, and says how sure that is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.estimators import Estimator, LeastSquares, PhysicallyConsistent, RobustLeastSquares, TotalLeastSquares
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.identification import (
    DivisionSettings,
    Identification,
    InPieces,
    PiecePlan,
    Recipe,
    Span,
    Stretch,
    identify,
    identify_from_pieces,
    plan_pieces,
)
from dynident.models.lagrangian import two_link_arm
from dynident.models.simulation import record
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Butterworth, Smoother, Spline
from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError, progress_to
from dynident.runtime.jobs import run_jobs
from tests.identification.motions import sines

ARM = two_link_arm()
SMALL = DivisionSettings(excerpts=3, excerpt=1500, piece=1000, pieces=10, shortest=500)
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
    def stretches(self) -> tuple[Stretch, ...]:
        edges = [0, *self.edges, len(self.log)]
        return tuple(Stretch(a, b, float(self.log.t[a]), float(self.log.t[b - 1])) for a, b in pairwise(edges))

    def read(self, rows: slice) -> tuple[Log, NDArray[np.intp]]:
        part = self.log.rows(rows, self.log.source)
        return part, np.arange(len(part))


def recording(sigma_tau: float = 0.02, samples: int = 12_000, seed: int = 0) -> Log:
    """On a motion that is chosen, whose torque follows: to integrate the equations of a minute takes seconds."""
    t = np.arange(samples) * 0.005
    rate, size = np.array([[1.7, 2.3], [0.3, 0.7], [3.1, 3.9]]), np.array([[0.9, 0.7], [0.4, 0.5], [0.3, 0.2]])
    q, dq, ddq = sines(t, size, rate)
    names = tuple(joint.name for joint in ARM.joints)
    truth = Motion(t, q, dq, ddq, ARM.torque(q, dq, ddq, THETA), names, np.ones(samples, dtype=bool))
    return record(truth, 1e-5, sigma_tau, np.random.default_rng(seed), source="day").log


LOG = recording()


def in_pieces(ready: PiecePlan, validation: Sequence[Log] = ()) -> Identification:
    done = {outcome.job: outcome.value for outcome in run_jobs(ready.reducer, ready.spans)}
    pieces = [done[span] for span in ready.spans]
    return identify_from_pieces(ready, [piece for piece in pieces if piece is not None], validation)


PLAIN = Recipe(Spline(sigma=1e-5))


@cache
def day(recipe: Recipe = PLAIN) -> tuple[Identification, Identification]:
    """The recording identified in pieces, and as a whole with all that was chosen."""
    result = in_pieces(plan_pieces(ARM, [Held(LOG)], recipe, SMALL))
    return result, identify(ARM, [LOG], recipe=result.recipe)


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
    result, full = day(Recipe(smoother, estimator, low))
    np.testing.assert_allclose(result.estimate.value, full.estimate.value, rtol=1e-8)
    np.testing.assert_allclose(result.estimate.residual.sigma, full.estimate.residual.sigma, rtol=1e-8)
    assert result.estimate.residual.samples == full.estimate.residual.samples
    pieces = result.estimate.residual.pieces
    torque = np.sqrt((pieces.rows * pieces.torque**2).sum(axis=0) / pieces.rows.sum(axis=0))
    np.testing.assert_allclose(torque, [np.sqrt(np.mean(x**2)) for x in LOG.tau.T], rtol=0.1)
    note = next(note for note in result.notes if isinstance(note, InPieces))
    assert (note.samples, note.pieces, note.excerpts) == (12_000, 12, 3)


def test_standard_errors_allow_for_correlation_and_hold_the_truth() -> None:
    result, full = day()
    ratio = result.errors.std / full.errors.std
    assert ((ratio > 0.4) & (ratio < 1.6)).all()  # twelve pieces tell a standard error to a fifth
    assert (np.abs(result.estimate.value - THETA) < 5 * result.errors.std).all()


def test_held_out_logs_are_judged_as_ever_and_excerpts_stand_for_the_training() -> None:
    held = replace(recording(seed=1, samples=2000), source="tuesday")
    result = in_pieces(plan_pieces(ARM, [Held(LOG)], Recipe(Spline(sigma=1e-5)), SMALL), [held])
    *excerpts, last = result.validations
    assert [validation.role for validation in result.validations] == ["train"] * 3 + ["validation"]
    assert [len(excerpt.motion) for excerpt in excerpts] == [1500] * 3
    assert [excerpt.name for excerpt in excerpts] == ["day excerpt 1", "day excerpt 2", "day excerpt 3"]
    again = result.predict(held)
    assert last.errors.relative_error == pytest.approx(again.errors.relative_error, rel=1e-12)


def test_gaps_end_pieces_and_short_stretches_are_left_out() -> None:
    held = Held(LOG, (4000, 4100, 4130))
    ready = plan_pieces(ARM, [held, Held(replace(LOG, source="night"))], Recipe(Spline(sigma=1e-5)), SMALL)
    assert ready.lost_samples == 30
    edges = {0, 4000, 4100, 4130, 12_000}
    for span in ready.spans:
        assert span.read_start <= span.start < span.stop <= span.read_stop
        if span.recording == 0:
            assert not any(span.read_start < edge < span.read_stop for edge in edges)
    assert sum(span.stop - span.start for span in ready.spans) == 2 * len(LOG) - 30
    assert {span.recording for span in ready.spans} == {0, 1}


def test_excerpts_are_where_the_arm_moves_and_rests_are_not_fitted() -> None:
    rest = np.arange(len(LOG)) % 3000 < 1400
    still = replace(
        LOG, q=np.where(rest[:, None], 0.3, LOG.q) + 1e-5 * np.random.default_rng(2).normal(size=LOG.q.shape)
    )
    ready = plan_pieces(ARM, [Held(still)], Recipe(Spline(sigma=1e-5), outliers="keep"), replace(SMALL, excerpt=1000))
    for case in ready.logs.values():
        assert np.ptp(case.q, axis=0).min() > 0.1
    resting = Span(0, 6050, 7050, 6000, 7100)
    assert ready.reducer(resting).rows == (0, 0)
    assert not ready.reducer.motion(still.rows(slice(6000, 7100), "rest")).keep.any()  # type: ignore[union-attr]


def test_what_needs_all_samples_at_once_is_refused() -> None:
    short = Held(LOG.rows(slice(0, 1500), "short"))
    recipe = Recipe(Spline(sigma=1e-5), MaximumLikelihood())
    steps: list[str] = []
    for estimator in (MaximumLikelihood(), PhysicallyConsistent(fit=RobustLeastSquares())):
        words = f"{type(estimator).__name__} needs all samples at once"
        with progress_to(steps.append), pytest.raises(ConfigError, match=words):
            plan_pieces(ARM, [short], replace(recipe, estimator=estimator), SMALL)
    assert not steps  # before anything is fitted
    reference = TotalLeastSquares(errors={ARM.names[0]: 1e-3})
    with pytest.raises(ConfigError, match="TotalLeastSquares needs all samples at once"):
        plan_pieces(ARM, [short], replace(recipe, estimator=reference), replace(SMALL, excerpt=300))
    with pytest.raises(ConfigError, match=r"smooths over .* no piece of 60 samples"):
        plan_pieces(ARM, [Held(LOG, tuple(range(60, 12_000, 60)))], Recipe(Spline(sigma=1e-5)), SMALL)
