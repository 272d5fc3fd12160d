"""The choice of terms in words, in a table and in figures."""

import pytest

from dynident.identification import Calibration
from dynident.identification.terms import TermChoice, TermTrial, TrialOutcome
from dynident.models import Joint
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.report.identification import identification_page
from dynident.report.identification.figures import trial_figure
from dynident.report.identification.terms import OUTCOMES, choice_comments, term_section
from tests.report.test_page import EVIL


def choice(joints):
    trials = (
        TermTrial(joints[0], "coulomb", (("width", 0.01),), 90.0, 16.0, TrialOutcome.ENTERED, 95.0, 20.0),
        TermTrial(joints[0], "ripple", (("cycles", (30.0, 60.5)),), 2.0, 1.5, TrialOutcome.WITHIN_ERROR),
        TermTrial(joints[0], "power", (), -4000.0, 10.0, TrialOutcome.REFUTED_FASTER, -7000.0, 5.0),
        TermTrial(joints[1], "dahl", (("length", 0.002),), 0.2, 0.1, TrialOutcome.TOO_SMALL),
    )
    some = tuple(map(Joint, joints))
    terms = (Offset(some), Viscous(some, on=joints[:1]), Coulomb(some, on=joints[:1], width=0.01))
    return TermChoice(joints, terms, trials, (8.0, 3.0), (5.0, 3.0), (0.0, 0.0))


def changed(identification, calibration):
    return type(identification)(**{**vars(identification), "calibration": calibration})


@pytest.fixture
def chosen(identification):
    joints = tuple(joint.name for joint in identification.model.joints)
    return changed(identification, Calibration(terms=choice(joints)))


def test_every_outcome_has_words():
    assert OUTCOMES.keys() == set(TrialOutcome)


def test_the_page_has_a_figure_per_joint_and_all_that_was_tried(chosen, identification):
    (section,) = term_section(chosen)
    _, _, gallery, fold = section.blocks
    assert [keys for keys, _ in gallery.views] == [(joint.name,) for joint in chosen.model.joints]
    (table,) = fold.blocks
    assert [row[1] for row in table.rows] == ["coulomb", "ripple", "power", "dahl"]
    assert table.rows[0][2:] == ("width 0.0100", "90.0", "16.0", "95.0", "20.0", "entered")
    assert table.rows[1][2] == "cycles 30.0 and 60.5"
    assert "Friction and other terms" in identification_page(chosen)
    assert list(term_section(identification)) == []


def test_names_are_escaped(chosen):
    case = TermTrial(EVIL, EVIL, (), 1.0, 1.0, TrialOutcome.ENTERED)
    figure = trial_figure([case], OUTCOMES)
    assert EVIL not in figure.json()


def test_comments_name_the_gains_and_the_errors(chosen):
    said = choice_comments(chosen, "robot.yaml")
    assert "robot.yaml" in said[""][0]
    assert said.keys() == {"", "model.terms", "rests"}  # no more than was chosen
    assert chosen.recipe.rests == "trim"
    joint = chosen.model.joints[0].name
    assert (
        f"{joint}: offset, viscous, coulomb (width 0.0100, gain 90.0 +- 16); error 8.00 -> 5.00 %"
        in said["model.terms"]
    )
