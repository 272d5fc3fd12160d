"""The words of findings hold their figures and what to do."""

import dataclasses
import json

import pytest
from pydantic import TypeAdapter

from dynident.checks import channel_notes, file_notes, log_notes, motion_notes, robot_notes
from dynident.checks.file_notes import AffectedColumns
from dynident.checks.robot_notes import MissingTerm, TermKind
from dynident.runtime import Note, Remark
from tests.classes import classes_of

OTHERS = tuple(robot_notes.Rival(f"j{k}", x, 0.1) for k, x in enumerate(robot_notes.SuspectQuantity))
ROBOT_NOTES = [
    *(file_notes.JointsSwapped(("a", "b"), channel, 30.0, 2.0) for channel in AffectedColumns),
    *(file_notes.ColumnReversed(channel, (), 30.0, 2.0) for channel in AffectedColumns),
    file_notes.ColumnReversed(AffectedColumns.BOTH, ("elbow", "wrist"), 30.0, 2.0),
    file_notes.OtherZero(-90, 30.0, 2.0),
    *(file_notes.MotorCoupled("a", "b", sign, channel, 30.0, 2.0) for sign in (1, -1) for channel in AffectedColumns),
    file_notes.OtherAxis((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 30.0, 2.0),
    robot_notes.TorqueGain(1.25, 0.01, 0.2, OTHERS),
    robot_notes.ZeroOff(0.1, 0.01, 0.2, removed=(("a", 0.5), ("b", 0.25))),
    robot_notes.LengthWrong(0.5, 0.01, 0.2, component="x", given=0.4),
    robot_notes.AxisTilted(0.05, 0.01, 0.2, axis=(1.0, 0.0, 0.0), alone=True),
    *(MissingTerm(kind, 0.5, 0.01, 0.6, "j1" if kind is TermKind.COUPLED else "") for kind in TermKind),
    robot_notes.TermLeftOut(TermKind.ROTOR, 0.5, 0.01, 0.6),
    MissingTerm(TermKind.RIPPLE, 0.5, 0.01, 0.6, period=0.524),
    robot_notes.LeftAtReversals(3.52, 0.71),
    robot_notes.Unexplained(8.1, 42.3),
    robot_notes.ClockWrong(1.2, 0.01, 0.2),
    motion_notes.OddLog(12.0, 2.0),
    robot_notes.TiltedBase(0.02, -0.035, (1e-3, 2e-3), 4.0, 2.0, cost=3.0),
    motion_notes.OtherPayload(2.0, 0.1, 0.9),
    motion_notes.OtherPayload(-2.0, 0.1, 0.9),
]
NOTES = [
    *ROBOT_NOTES,
    channel_notes.TooFewSamples(11, 30),
    channel_notes.TooFewSamples(20, 30, step=1.0),
    channel_notes.LongGap(0.102, 0.998, 51.0, 1),
    channel_notes.UnevenSteps(0.17, 0.005006, 0.00461, 0.0103),
    channel_notes.NeverMoves(2, 0.0),
    channel_notes.PerhapsDegrees(8.0, 47.88),
    channel_notes.UnorderedRows(),
    channel_notes.QuantisedPosition(1e-3, 10.0),
    channel_notes.ConstantTorque(1.0),
    channel_notes.ArmAtRest(2.5, 4.0),
    channel_notes.ArmAtRest(12345.04, 12345.51, kept=False),
    channel_notes.EquallySpaced(0.0086, 853.2, 200.0, 0),
    channel_notes.EquallySpaced(0.16, 0.5, 200.0, 13),
    channel_notes.StampsJitter(0.163, 853.0, 200.0, None),
    channel_notes.StampsJitter(0.169, 167.0, None, 0.00500616),
    channel_notes.SamplingJitter(0.163, None),
    channel_notes.SamplingJitter(0.163, 835.0),
    channel_notes.LostSamples(13, 0.00325, 2.0),
    channel_notes.RepeatedPositions(0.75, 4),
    file_notes.ImpossibleInertia("negative mass -4 kg"),
    file_notes.NoMass(("fore",)),
    file_notes.OnlyShapes(),
    file_notes.FloatingBase(),
    file_notes.SeveralLimbs("trunk", ("left", "right")),
    file_notes.PointMass(0.2),
    file_notes.FarCentre(120.0),
    file_notes.LargeGyration(0.05, 0.408, 0.3, 0.3),
    file_notes.InertiaAboutOrigin(("upper", "fore")),
    file_notes.EqualLinks(("upper", "fore"), 2.0, alone=False),
    file_notes.EqualLinks(("upper", "fore"), 2.0, alone=True),
    file_notes.OddTotalMass(6004.0),
    file_notes.EmptyRange(0.0, 0.0),
    file_notes.LimitNotPositive("effort", 0.0),
    file_notes.NoLimit("velocity", ("s", "e")),
    file_notes.GravityIgnored((0.0, 0.0, -1.62), (0.0, 0.0, -9.81)),
    file_notes.OtherGravity((0.0, -6.8, -7.1), (0.0, 0.0, -9.81)),
    file_notes.ReversedSign(-0.999),
    file_notes.ReversedSign(None),
    file_notes.OddScale(99.9, "N m"),
    file_notes.UnrelatedTorque(12.0, 0.19),
    motion_notes.LoopVelocity(1, 2, 0.0324, 0.00264),
    motion_notes.LoopVelocity(1, 0, 0.094, 0.0054),
    motion_notes.LoopGain(0.8, 0.25, 0.01),
    motion_notes.LowPassed(5.3, 0.02, 0.4),
    motion_notes.LoopUnused(("q1_ref", "q2_ref", "q3_ref")),
    motion_notes.LoopDiffers(0.75),
    motion_notes.HardlyMoves(0.0016, 4.4, 0.70012, "rad"),
    motion_notes.FewReversals(1),
    motion_notes.PositionBeyondLimits(-0.5, 0.5, -1.0, 0.2),
    motion_notes.PositionBeyondLimits(-90.0, 110.0, -2.5, 2.5, far=True),
    motion_notes.VelocityAboveLimit(1.0, 0.5),
    motion_notes.EffortAboveLimit(12.0, 10.0, "N m", far=False),
    motion_notes.EffortAboveLimit(300.0, 10.0, "N m", far=True),
    motion_notes.EffortFarBelowLimit(1e-3, 10.0, "N m"),
    motion_notes.SearchLeftOut(motion_notes.SearchKind.PAIRS, 30, 330),
    motion_notes.CorrelatedParameters(5, 1e6),
    log_notes.ClippedTorque(4, 9.5, 7, 1.25, True, False),
    log_notes.FrozenPosition(7, 10, 1.0, 2.0, 0.5, True),
    log_notes.FrozenTorque(7, 10, 1.0, 2.0, 0.5, False, True),
    log_notes.GravityCompensated(0.02, 0.01, 31.0, 4.2),
    log_notes.InterpolatedPositions(0.48),
    log_notes.ManyPositionSpikes(40, (7, 9), (1.0, 1.5), 0.3, False),
    log_notes.ManyTorqueOutliers(0.12, 7, 1.25),
    log_notes.NoFriction(0.4),
    channel_notes.PerhapsMillimetres(120.0, 300.0),
    log_notes.PerhapsRadians(2.0, 60.0, 5.0),
    log_notes.PerhapsRadians(0.04, 60.0, 5.0, others_move=True),
    log_notes.PositionJump(2, 0.5, 7, 1.25),
    log_notes.PositionSpikes(2, (7, 9), (1.0, 1.5), 0.3, True),
    log_notes.SharedSamples("fast", 0.4),
    log_notes.RepeatedMotion("run1", 0.5, 0.2),
    log_notes.SameData("run1", 0.0),
    log_notes.SlowMotion(1.5, 6.0, 4.0),
    log_notes.TorqueSpikes(2, (7, 9), (1.0, 1.5), 30.0, True, False),
    channel_notes.WrappedPosition(3, 6.2832, 7, 1.25),
    channel_notes.WrongTimeUnit(200000.0, 40000.0, 1000.0),
    *(channel_notes.SamplingJitter(0.2, factor) for factor in (1.05, 2.0, 2e3)),
    *(channel_notes.RepeatedPositions(share, every) for share, every in ((0.2, 1), (1.0, 0))),
    *(log_notes.RepeatedMotion("a", lag, 3.0) for lag in (0.0, 0.4, -0.4)),
    *(log_notes.SameData("a", lag) for lag in (0.4, -0.4)),
    robot_notes.ClockWrong(1.2, 0.01, 0.2, cost=3.21),
    robot_notes.PositionGear(0.95, 0.01, 0.2, OTHERS, cost=3.21),
]


@pytest.mark.parametrize("note", NOTES, ids=lambda x: type(x).__name__)
def test_notes_are_the_same_after_a_file(note: Note) -> None:
    """What they say is in ``tests/laws/test_sentences.py``."""
    saved = json.loads(json.dumps(dataclasses.asdict(note)))
    assert TypeAdapter(type(note)).validate_python(saved) == note


def test_all_kinds_of_notes_are_tried() -> None:
    modules = (channel_notes, file_notes, log_notes, motion_notes, robot_notes)
    kinds = {kind for module in modules for kind in classes_of(module) if issubclass(kind, Note)}
    bases = {robot_notes.Costly, robot_notes.WrongValue, robot_notes.SuspectedValue, log_notes.Spikes}
    bases |= {log_notes.FrozenValue}
    assert {type(note) for note in NOTES} == {kind for kind in kinds - bases if not issubclass(kind, Remark)}


def test_what_to_do_is_said_in_short() -> None:
    for note in ROBOT_NOTES:
        assert note.remedy.endswith(("?", "."))
        assert len(note.remedy) <= (0.5 if isinstance(note, robot_notes.WrongValue) else 1.0) * len(str(note))
