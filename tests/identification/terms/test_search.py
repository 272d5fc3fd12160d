"""Which of several good laws enters: the simplest that is as good as the best, and the better one of the same cause."""

import numpy as np
import pytest

from dynident.identification.terms.candidates import TermGroup, TermTrial, TrialOutcome, library_kinds
from dynident.identification.terms.grams import gain_share
from dynident.identification.terms.search import JointSearch, TermEntry, _TrialResult
from dynident.models import Joint
from dynident.models.friction import Coulomb

EVEN, WAVE = np.full(16, 1.0), np.tile([-1.0, 1.0], 8)  # of gain in each block of time
ENTERED, WITHIN_ERROR = TrialOutcome.ENTERED, TrialOutcome.WITHIN_ERROR


def result(name: str, gains: np.ndarray, outcome: TrialOutcome = ENTERED) -> _TrialResult:
    """Return a trial of a kind with gains (16), of which the size does not matter."""
    kind = next(kind for kind in library_kinds() if kind.name == name)
    group = TermGroup(kind, (Coulomb((Joint("j1"),)),), ((0,),))
    spread = 4.0 * float(gains.std(ddof=1))
    return _TrialResult(TermTrial("j1", name, (), float(gains.sum()), spread, outcome), gains, TermEntry(group, 0))


class ScriptedSearch(JointSearch):
    """A search in which dry friction has entered, whose trials are given, once."""

    def __init__(self, *results: _TrialResult) -> None:
        super().__init__("j1", None, tuple(x.entered.group for x in results), None, 1.0)
        self.entered, self.results = [result("coulomb", EVEN).entered], list(results)

    def _try_groups(self, *_, **__) -> list[_TrialResult]:
        results, self.results = self.results, []
        return results

    def _resize(self, _) -> None:
        """Leave the sizes."""


@pytest.mark.parametrize(
    ("results", "entered"),
    [
        (
            [result("load_coulomb", 3 * EVEN), result("dahl", 3.01 * EVEN + 0.1 * WAVE)],
            "load_coulomb",
        ),
        ([result("load_coulomb", EVEN), result("dahl", 3 * EVEN)], "dahl"),
        # a gain of few blocks counts where a law of the same cause is sure, not beside another, nor if it is less
        ([result("load_coulomb", 30 * np.eye(16)[2], WITHIN_ERROR), result("load_dahl", EVEN)], "load_coulomb"),
        ([result("load_coulomb", 30 * np.eye(16)[2], WITHIN_ERROR), result("dahl", EVEN)], "dahl"),
        ([result("load_viscous", 30 * np.eye(16)[2], WITHIN_ERROR), result("load_dahl", EVEN)], "load_dahl"),
        ([result("load_coulomb", 9 * np.eye(16)[2], WITHIN_ERROR), result("load_dahl", EVEN)], "load_dahl"),
        ([result("load_coulomb", 30 * np.eye(16)[2], WITHIN_ERROR)], "coulomb"),
    ],
)
def test_what_enters(results, entered) -> None:
    search = ScriptedSearch(*results)
    search.forward(None)
    assert search.entered[-1].group.kind.name == entered


class SpoiltSearch(JointSearch):
    """A search in which all groups enter, and then two go that are good alone: each spoils the sign of the other."""

    @property
    def kinds(self) -> set[str]:
        return {entry.group.kind.name for entry in self.entered}

    def forward(self, _) -> None:
        self.entered = [TermEntry(group, 0) for group in self.groups]

    def backward(self, _) -> None:
        spoilt = {"stribeck", "wide_coulomb"}
        if spoilt <= self.kinds:
            self.entered = [entry for entry in self.entered if entry.group.kind.name not in spoilt]
            self.trials |= {x: TermTrial("j1", x, (), 80.0, 8.0, TrialOutcome.REDUNDANT) for x in spoilt}

    def errors(self, _) -> np.ndarray:
        return np.array([9.0 - 5.0 * ("wide_coulomb" in self.kinds) - 8.0 * ("stribeck" in self.kinds)])


def test_of_two_terms_that_spoil_each_others_sign_the_better_one_stays() -> None:
    groups = [result(name, EVEN).entered.group for name in ("stribeck", "wide_coulomb", "dahl")]
    search = SpoiltSearch("j1", None, tuple(groups), None, 1.0)
    search.forward(None)
    search.backward(None)
    assert search.kinds == {"dahl"}
    search.exchange(None)
    assert search.kinds == {"stribeck", "dahl"}


def test_gains_are_shares_of_the_error_before_with_the_error_of_their_sum() -> None:
    share = gain_share(np.array([1.0, 2.0, 6.0]), np.array([10.0, 20.0, 30.0]))
    assert share == pytest.approx((15.0, 100 * 21**0.5 / 60))
    assert gain_share(np.array([3.0]), np.array([4.0])) == (75.0, 0.0)
    assert gain_share(EVEN, 0 * EVEN) == (0.0, 0.0)
