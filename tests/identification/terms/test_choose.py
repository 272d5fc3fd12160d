"""The choice of terms: sizes, what was tried, the minimum speed, and joints that show no friction."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.identification.terms import (
    CandidateKind,
    TermChoice,
    TermTrial,
    TrialOutcome,
    choose_terms,
    kind_of_class,
    library_kinds,
    samples,
)
from dynident.identification.terms.candidates import KINDS
from dynident.identification.terms.samples import TermSamples
from dynident.models import Joint, Model
from dynident.models.friction import Coulomb, Ripple, Stribeck, Viscous
from dynident.regression import Selection
from dynident.runtime import InputError
from tests.identification.terms import simulated
from tests.identification.terms.simulated import FEW, PLAIN, bodies, recorded


@cache
def chosen(law: str, kinds: tuple[CandidateKind, ...] = KINDS) -> TermChoice:
    """The choice on a recording of an arm with a law; that it is the law, ``tests/laws/test_friction_laws.py`` says."""
    return choose_terms(Model((bodies(),)), [recorded(getattr(simulated, law), 1)], kinds=kinds)


def classes(choice: TermChoice, joint: str) -> set[str]:
    return {type(term).__name__ for term in choice.terms if joint in term.acts_on}  # type: ignore[attr-defined]


def test_shape_constants_are_those_of_the_law() -> None:
    (widths,) = (term for term in chosen("wide", PLAIN).terms if isinstance(term, Coulomb))
    assert [widths.constant("width", name) for name in widths.acts_on] == pytest.approx([0.1] * 3, rel=0.4)
    (term,) = (term for term in chosen("ripple", PLAIN).terms if isinstance(term, Ripple))
    rates = [term.constant("cycles", name)[0] for name in term.acts_on]
    assert rates == pytest.approx([32.0] * 3, rel=0.005)  # right also where the motion did not go


def test_breakaway_is_found_with_its_sharp_sign_where_faster_motion_hardly_shows_it() -> None:
    """A smooth sign, or a wider range of speed, would take a part of it alone."""
    choice = chosen("breakaway", (*PLAIN, *(kind for kind in KINDS if kind.name in ("stribeck", "wide_coulomb"))))
    (term,) = (term for term in choice.terms if isinstance(term, Stribeck))
    assert term.acts_on == ("j1", "j2", "j3")
    assert term.sharp.all()
    assert [term.constant("velocity", name) for name in term.acts_on] == pytest.approx([0.05] * 3, rel=0.3)


@pytest.mark.parametrize(
    ("law", "seed", "rows", "rate"), [("fine_ripple", 1, 4000, 150), ("ripple_and_bump", 3, 1200, 32)]
)
def test_ripple_is_found_between_thinned_samples_and_beside_what_is_wrong_further_out(
    law: str, seed: int, rows: int, rate: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(samples, "MAX_ROWS", 3600)  # of all joints
    choice = choose_terms(Model((bodies(),)), [recorded(getattr(simulated, law), seed, rows=rows)], kinds=PLAIN)
    (term,) = (term for term in choice.terms if isinstance(term, Ripple))
    assert [term.constant("cycles", name) for name in ("j1", "j2", "j3")] == [(pytest.approx(rate, rel=0.005),)] * 3


def test_a_width_that_is_passed_within_a_sample_is_no_friction(monkeypatch: pytest.MonkeyPatch) -> None:
    def widths(*, min_speed: bool) -> list[float]:
        choice = choose_terms(Model((bodies(),)), [recorded(simulated.averaged, 1, noise=0.1)], kinds=PLAIN)
        (sign,) = (term for term in choice.terms if isinstance(term, Coulomb))
        signs = [float(sign.constant("width", name)) for name in sign.acts_on]
        assert [dict(x.settings)["width"] for x in choice.trials if x.kind == "coulomb"] == signs
        assert [speed > 0 for speed in choice.min_speed] == [min_speed] * 3
        return signs

    assert widths(min_speed=True) == [0.0] * 3  # samples on the way are left out
    monkeypatch.setattr(TermSamples, "turning_step", lambda samples, j: 0.0)
    assert min(widths(min_speed=False)) > 0  # the width that predicts best: of the mean, not of the friction


def test_a_wide_sign_stays_where_a_sharp_one_is_clearly_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TermSamples, "turning_step", lambda samples, j: 1.0)  # as if it were sampled slowly
    choice = choose_terms(Model((bodies(),)), [recorded(simulated.wide, 1)], kinds=PLAIN)
    (sign,) = (term for term in choice.terms if isinstance(term, Coulomb))
    assert [sign.constant("width", name) for name in sign.acts_on] == pytest.approx([0.1] * 3, rel=0.4)
    assert max(choice.min_speed) < 0.5


def test_what_was_tried_is_told_with_gain_and_error() -> None:
    choice = chosen("dahl")
    trials = {x.kind: x for x in choice.trials_of("j2")}
    assert trials["dahl"].outcome is TrialOutcome.ENTERED
    assert trials["dahl"].gain > 2.0 * trials["dahl"].std > 0
    assert trials["dahl"].faster > 2.0 * trials["dahl"].faster_std > 0
    assert dict(trials["dahl"].settings)["length"] == pytest.approx(0.02, rel=0.5)
    assert trials["stribeck"].outcome in (TrialOutcome.TOO_SMALL, TrialOutcome.NEGATIVE, TrialOutcome.WITHIN_ERROR)
    untried = {"offset", "viscous", "rotor", "drift"}  # the recordings are too short for a drift
    assert trials.keys() >= {kind.name for kind in library_kinds()} - untried
    assert all(after < before for before, after in zip(choice.before, choice.after, strict=True))
    tau = recorded(simulated.dahl, 1).tau
    noise = 100 * 0.05 * simulated.SIZE / np.sqrt(np.mean(tau**2, axis=0))  # %, of which the choice leaves little more
    np.testing.assert_allclose(choice.after, noise, rtol=0.12)


def test_the_minimum_speed_is_left_to_terms_that_describe_reversals() -> None:
    assert chosen("dahl").min_speed == (0.0, 0.0, 0.0)
    given = choose_terms(
        Model((bodies(),)), [recorded(simulated.coulomb, 1)], Selection(min_speed=(0.1, 0.1, 0.1)), kinds=PLAIN
    )
    assert given.min_speed == (0.0, 0.0, 0.0)


def test_a_term_that_the_model_has_is_not_tried() -> None:
    joints = bodies().joints
    model = Model((bodies(), Viscous(joints)))
    choice = choose_terms(model, [recorded(simulated.coulomb, 1)], kinds=PLAIN)
    assert "viscous" not in {trial.kind for trial in choice.trials}
    assert model.with_terms(*choice.terms).names.count("Fv_j1") == 1


def test_few_samples_are_refused() -> None:
    motion = recorded(simulated.none, 1)
    with pytest.raises(InputError, match="too few to choose the terms by"):
        choose_terms(Model((bodies(),)), [replace(motion, mask=motion.t < 1.0)])


@pytest.mark.parametrize("resting", [(1,), (0, 1, 2)])
def test_a_joint_at_rest_keeps_the_plain_set(resting: tuple[int, ...]) -> None:
    motion = recorded(simulated.coulomb, 1)
    moves = np.where(np.isin(np.arange(3), resting), 0.0, 1.0)
    q = moves * motion.q + (1.0 - moves) * motion.q[0]
    still = replace(motion, q=q, dq=moves * motion.dq, ddq=moves * motion.ddq)
    choice = choose_terms(Model((bodies(),)), [still], kinds=FEW)
    for j in resting:
        assert classes(choice, f"j{j + 1}") == {"Offset", "RotorInertia", "Viscous", "Coulomb"}
        assert choice.trials_of(f"j{j + 1}") == ()


def test_a_joint_that_is_held_shows_no_friction() -> None:
    motion = recorded(simulated.coulomb, 1)
    moves = np.array([1.0, 1e-3, 1.0])
    held = replace(motion, q=moves * motion.q, dq=moves * motion.dq, ddq=moves * motion.ddq)
    choice = choose_terms(Model((bodies(),)), [held], kinds=FEW)
    assert (choice.trials_of("j2"), classes(choice, "j2")) == ((), {"Offset"})
    assert classes(choice, "j1") >= {"Offset", "RotorInertia", "Viscous", "Coulomb"}


@pytest.mark.parametrize(("law", "dry"), [("coulomb", "Coulomb"), ("by_load", "LoadCoulomb")])
def test_dry_friction_stays_at_a_joint_whose_torque_is_fitted_one_way_alone(law: str, dry: str) -> None:
    """Coulomb friction looks like an offset there: without it, all of the friction would be an offset."""
    motion = recorded(getattr(simulated, law), 2)
    keep = (motion.dq > 0.3) | np.array([True, False, True])
    choice = choose_terms(Model((bodies(),)), [replace(motion, keep=keep)], kinds=FEW)
    assert classes(choice, "j2") & {"Coulomb", "LoadCoulomb"} == {dry}
    kept = [(trial.joint, trial.kind) for trial in choice.trials if trial.outcome is TrialOutcome.KEPT]
    assert kept == ([("j2", "coulomb")] if dry == "Coulomb" else [])


def test_a_joint_whose_torque_is_not_fitted_keeps_the_plain_set() -> None:
    motion = recorded(simulated.ripple, 1)
    kept = replace(motion, keep=np.broadcast_to([False, True, True], motion.q.shape))
    choice = choose_terms(Model((bodies(),)), [kept], kinds=FEW)
    assert classes(choice, "j1") <= {"Offset", "Viscous", "Coulomb", "RotorInertia"}


def test_a_class_that_proposes_itself_takes_part() -> None:
    class Cubic(Viscous):
        """Friction with the cube of the speed."""

        law = "dq**3"

        @classmethod
        def proposed(cls, seen: object) -> tuple[Viscous, ...]:
            joint: Joint = seen.joint  # type: ignore[attr-defined]
            return (cls(seen.joints, on=(joint.name,), names=(f"cubic_{joint.name}",)),)  # type: ignore[attr-defined]

    def law(t: np.ndarray, q: np.ndarray, dq: np.ndarray, load: np.ndarray) -> np.ndarray:
        return simulated.coulomb(t, q, dq, load) + 2.0 * dq**3

    kinds = (*PLAIN, kind_of_class("cubic", Cubic))
    choice = choose_terms(Model((bodies(),)), [recorded(law, 1)], kinds=kinds)
    result = [trial for trial in choice.trials if trial.kind == "cubic"]
    assert len(result) == 3
    assert isinstance(result[0], TermTrial)
    assert any(x.outcome is TrialOutcome.ENTERED for x in result)
    assert any(isinstance(term, Cubic) for term in choice.terms)
