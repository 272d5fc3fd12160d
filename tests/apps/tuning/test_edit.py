"""All settings as one value: each control makes the next, changes are said, and terms are switched joint by joint."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.tuning import Bench, Tuning
from dynident.apps.tuning.edit import View, apply_control, setting_changes
from dynident.apps.tuning.switches import Offers, Switches, _basis
from dynident.identification import Recipe, identify
from dynident.identification.terms.samples import columns_of
from dynident.models import CoupledMotor, Model, RigidBodies, Term
from dynident.models.friction import Coulomb, Offset, Stribeck, Viscous
from dynident.motion.smoothers import Spline
from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError, ModelError
from dynident.runtime.families import TERMS
from tests.apps.tuning.arms import BODIES, JOINTS, MODEL, THETA, recording

START = Tuning((0.0, 0.0), (("viscous",), ("viscous", "coulomb")), (0.0, 0.0), "least_squares")


def test_windows_that_meet_are_one() -> None:
    tuning = START.exclude("a", 1.0, 2.0).exclude("b", 0.0, 1.0).exclude("a", 4.0, 5.0).exclude("a", 2.0, 3.0)
    assert tuning.windows("a") == ((1.0, 3.0), (4.0, 5.0))
    assert tuning.windows("b") == ((0.0, 1.0),)
    assert tuning.exclude("a", 0.0, 9.0).windows("a") == ((0.0, 9.0),)
    assert tuning.windows("c") == ()


def test_the_same_of_all_joints_is_said_once_and_what_is_not_changed_is_not() -> None:
    assert setting_changes(START, START, ("a", "b")) == []
    for joint, words in ((None, "all joints"), (1, "b")):
        changes = setting_changes(START, START.with_degree(1.0, joint), ("a", "b"))
        assert changes == [(f"smoothing of {words}", "S/n = 1.00", "S/n = 10.0")]


def test_each_setting_is_said() -> None:
    now = replace(
        START.exclude("log 1", 1.0, 2.5),
        terms=(("viscous", "dahl"), START.terms[1]),
        min_speed=(0.1, 0.0),
        unfitted=("b",),
        filter=ParallelFilter(decimate=4),
        estimator="consistent",
        time_offset=0.002,
    )
    assert setting_changes(START, now, ("a", "b")) == [
        ("minimum speed of a", "0", "0.100"),
        ("terms of a", "viscous", "viscous, dahl"),
        ("joints not fitted", "none", "b"),
        ("parallel filter", "none", "low-pass of order 4 at 0.8 of half the decimated rate, one of 4 samples kept"),
        ("estimator", "least squares", "physically consistent"),
        ("time offset", "0 ms", "2.000 ms"),
        ("samples left out", "none", "log 1 1.000 to 2.500 s"),
    ]


def test_what_acts_on_joints_acts_on_all_or_on_one(arm: Bench) -> None:
    view = View.start(arm)
    assert set(apply_control(view, "degree", 1.5, arm).tuning.degree) == {1.5}
    case = apply_control(view, "reach:one", None, arm)
    assert case.alone
    assert apply_control(case, "degree", "1.5", arm).tuning.degree == (1.5, *arm.start.degree[1:])
    last = apply_control(case, f"joint:{arm.joints[-1]}", None, arm)
    assert apply_control(last, "min_speed", 0.2, arm).tuning.min_speed == (*arm.start.min_speed[:-1], 0.2)
    assert set(apply_control(view, "min_speed", None, arm).tuning.min_speed) == {0.0}


def test_a_term_is_switched_where_it_differs(arm: Bench) -> None:
    view, kind = View.start(arm), arm.switches.kinds[-1]
    had = kind in arm.start.terms[0]
    some = apply_control(replace(view, alone=True), f"term:{kind}", None, arm)
    assert (kind in some.tuning.terms[0]) is not had
    assert some.tuning.terms[1:] == arm.start.terms[1:]
    every = apply_control(replace(some, alone=False), f"term:{kind}", None, arm)
    assert all((kind in terms) is had for terms in every.tuning.terms)


def test_the_filter_is_none_where_it_does_nothing(arm: Bench) -> None:
    view = apply_control(View.start(arm), "filter:low-pass", None, arm)
    assert view.tuning.filter == ParallelFilter(decimate=5)
    view = apply_control(view, "cutoff", 12.0, arm)
    assert apply_control(view, "decimate", 1, arm).tuning.filter == ParallelFilter(cutoff=12.0)
    assert apply_control(apply_control(view, "cutoff", None, arm), "decimate", 1, arm).tuning.filter is None
    assert apply_control(view, "filter:none", None, arm).tuning.filter is None


def test_samples_joints_estimator_and_offset(arm: Bench) -> None:
    view = apply_control(View.start(arm), "exclude", [3.0, 1.0], arm)
    assert view.tuning.excluded == (("log 1", 1.0, 3.0),)
    assert apply_control(view, "include:0", None, arm).tuning == arm.start
    assert apply_control(view, f"fitted:{arm.joints[0]}", None, arm).tuning.unfitted == arm.joints[:1]
    assert apply_control(view, "estimator:consistent", None, arm).tuning.estimator == "consistent"
    assert apply_control(view, "offset", 2.5, arm).tuning.time_offset == 0.0025
    assert apply_control(view, "reset", None, arm).tuning == arm.start


def test_a_mark_is_where_its_rule_chooses(arm: Bench) -> None:
    marks = arm.curve(arm.start).marks
    assert apply_control(View.start(arm), "mark:GCV", None, arm).tuning.degree == marks["GCV"]
    alone = replace(View.start(arm), alone=True)
    degree = apply_control(alone, "mark:GCV", None, arm).tuning.degree
    assert degree == (marks["GCV"][0], *arm.start.degree[1:])


@pytest.mark.parametrize(
    ("control", "value", "words"),
    [
        ("degree", "much", "no number"),
        ("degree", 9, "from -6 to 6"),
        ("degree", "nan", "from -6 to 6"),
        ("min_speed", -1, "at least 0"),
        ("decimate", 2.5, "give a whole number"),
        ("cutoff", -1, "above 0"),
        ("offset", "inf", "time offset is inf"),
        ("exclude", [1.0, 1.0], "drag over some samples"),
        ("exclude", [1.0, "nan"], "excluded window of 'log 1'"),
        ("exclude", [None, 1.0], "no number"),
        ("mark:best", None, "there is no mark 'best'"),
        ("estimator:lucky", None, "there is no estimator 'lucky'"),
        ("colour", 1, "there is no control 'colour'"),
    ],
)
def test_what_makes_no_sense_is_said(arm: Bench, control: str, value: object, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        apply_control(View.start(arm), control, value, arm)


CHANGES: dict[str, Callable[[Tuning], Tuning]] = {
    "nothing": lambda start: start,
    "all joints": lambda start: start.with_degree(0.1 + 0.2),
    "one joint": lambda start: start.with_degree(-1.0, 1),
    "terms": lambda start: replace(start, terms=((), ("stribeck", "viscous"), *start.terms[2:])),
    "windows": lambda start: start.exclude("log 1", 1.25, 3.5).exclude("log 2", 0.0, 1e-3),
    "the rest": lambda start: replace(
        start, min_speed=(0.02, 0.0, 0.1), estimator="consistent", unfitted=("rail",), time_offset=-0.0032
    ),
    "filter": lambda start: replace(start, filter=ParallelFilter(cutoff=12.5, order=2)),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_there_and_back(arm: Bench, change: Callable[[Tuning], Tuning]) -> None:
    for view in (
        replace(View.start(arm), tuning=change(arm.start)),
        View(change(arm.start), arm.joints[1], "log 2", alone=True),
    ):
        text = view.to_query(arm)
        assert View.of_query(text, arm) == view
        assert set('"<> ').isdisjoint(text)
        assert text.isascii()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('joint="knee"', "there is no joint 'knee'"),
        ("joint=[]", "there is no joint"),
        ('log="../etc/passwd"', "there is no log"),
        ("speed=1", "there is no setting 'speed'"),
        ("degree=high", "degree is 'high', which is no JSON"),
        ("degree=" + "[" * 9000, "no JSON"),
        ("degree=NaN", "no JSON"),
        ("degree=%ff", "no JSON"),
        ("degree", "no JSON"),
        ('degree=["a",0,0]', r"degree\[0\]: should be a valid number"),
        ("degree=[99,0,0]", "log10"),
        ("degree=[1]", "degree has 1 entries for 3 joints"),
        ('estimator="magic"', "there is no estimator 'magic'"),
        ('terms=[["rust"],[],[]]', "there is no kind of terms 'rust'"),
        ('excluded=[["log 1",1]]', r"excluded\[0\]"),
        ('excluded=[["log 1",2,1]]', "'log 1': 2 to 1 s; it must stop after it starts"),
        ('excluded=[["friday",1,2]]', "there is no log 'friday'"),
        ('unfitted=["knee"]', "there is no joint 'knee'"),
        ('filter={"decimate":2.5}', r"filter.decimate: should be a valid integer"),
        ('filter={"decimate":1}', "parallel filter"),
        ("time_offset=1e9", "time offset"),
    ],
)
def test_an_address_without_a_meaning_is_refused(arm: Bench, text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        View.of_query(f"?{text}", arm)


MOTOR = CoupledMotor(BODIES.joints, {"shoulder": 1.0, "twist": -1.0}, name="m")
GIVEN = Model((BODIES, Viscous(BODIES.joints, names=("a", "b", "c")), Coulomb(BODIES.joints, width=0.02), MOTOR))
OFFERED: tuple[dict[str, tuple[Term, ...]], ...] = (
    {},
    {"stribeck": (Stribeck(BODIES.joints, on=("rail",), velocity=0.1),)},
    {"offset": (Offset(BODIES.joints, on=("twist",)),)},
)


def switches() -> Switches:
    viscous, coulomb = Viscous(BODIES.joints), Coulomb(BODIES.joints, width=0.02)
    by_joint = ({"viscous": (viscous.for_joint(name),), "coulomb": (coulomb.for_joint(name),)} for name in JOINTS)
    return Switches(GIVEN, (("viscous", "coulomb"),) * 3, tuple(a | b for a, b in zip(by_joint, OFFERED, strict=True)))


def test_kinds_are_switched_joint_by_joint() -> None:
    arm_switches = switches()
    bodies, *terms, motor = arm_switches.with_terms(
        (("viscous",), ("stribeck", "viscous"), ("coulomb", "offset"))
    ).terms
    assert isinstance(bodies, RigidBodies)
    assert motor == MOTOR
    on = {
        type(term).__name__: term.acts_on for term in terms if isinstance(term, Viscous | Coulomb | Stribeck | Offset)
    }
    assert on == {"Viscous": ("shoulder", "rail"), "Stribeck": ("rail",), "Coulomb": ("twist",), "Offset": ("twist",)}
    (coulomb,) = (term for term in terms if isinstance(term, Coulomb))
    assert coulomb.constant("width", "twist") == 0.02
    assert arm_switches.kinds == ("viscous", "coulomb", "stribeck", "offset")
    with pytest.raises(ModelError, match="shoulder: there is no term of kind 'stribeck'"):
        arm_switches.with_terms((("stribeck",), (), ()))


def test_without_offers_nothing_can_be_switched() -> None:
    arm_switches = Switches.of(GIVEN, None)
    assert arm_switches.kinds == ()
    assert arm_switches.with_terms(arm_switches.start) is GIVEN


TRUE = Model((*MODEL.terms, Stribeck(BODIES.joints, on=("twist",), velocity=0.15)))


def test_sizes_are_those_that_explain_what_is_left() -> None:
    log = recording(1, model=TRUE, theta=np.append(THETA, 3.0))
    result = identify(MODEL, [log], recipe=Recipe(Spline()))
    offers = Offers.of(result.model, result.estimate.value, [result.validations[0].motion])
    kinds = dict(offers.kinds_of_joint(2))
    (term,) = kinds["stribeck"]
    assert isinstance(term, Stribeck)
    assert 0.1 < float(term.constant("velocity", "twist")) < 0.25
    assert term.acts_on == ("twist",)
    assert {"viscous", "dahl", "load_coulomb", "spring", "power"} <= kinds.keys()
    assert all(TERMS.kind_of(x) == kind for kind, some in kinds.items() for x in some)
    # what the model has already gains nothing, whatever rounding leaves of its columns
    rows = offers.samples.keep[:, 2]
    viscous_columns = columns_of(offers.samples, Viscous(BODIES.joints, on=("twist",)), 2, offers.loads)[:, rows]
    assert offers._gain(Viscous(BODIES.joints, on=("twist",)), 2, rows, _basis(viscous_columns)) == 0.0
    assert offers._gain(term, 2, rows, _basis(viscous_columns)) > 0.0
