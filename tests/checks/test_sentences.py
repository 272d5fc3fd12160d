"""The words of findings hold their figures and what to do."""

from __future__ import annotations

import pytest

from dynident.checks import channel_notes, file_notes, log_notes, motion_notes
from dynident.runtime import Note

SAID = [
    (
        channel_notes.TooFewSamples(11, 30),
        "only 11 samples; at least 30 are needed: widen the window or record longer.",
    ),
    (
        channel_notes.TooFewSamples(20, 30, step=1.0),
        (
            "only 20 samples, 1 s apart; at least 30 are needed: is the `unit` of `time` right? Else widen the window "
            "or record longer."
        ),
    ),
    (
        channel_notes.LongGap(0.102, 0.998, 51.0, 1),
        (
            "a gap of 0.102 s after t = 0.998 s (51 times the median step; the only one). Leave it out with "
            "a window, or set `gaps: split` to smooth each piece separately."
        ),
    ),
    (
        channel_notes.UnevenSteps(0.17, 0.005006, 0.00461, 0.0103),
        (
            "the time steps vary by 17 % about 0.005006 s (from 0.00461 to 0.0103 s). Where the clock of the "
            "stamps is not that of the sampling, this acts as position noise."
        ),
    ),
    (
        channel_notes.NeverMoves(2, 0.0),
        (
            "the position never moves (2 distinct values near 0): nothing about this joint's own motion can be "
            "identified. Check that the right column is named, or use another window; a joint of a robot file that is "
            "to stand still goes under `model.lock`."
        ),
    ),
    (
        channel_notes.PerhapsDegrees(8.0, 47.88),
        (
            "the position spans 8 rad at up to 47.88 rad/s, more than a robot arm does; is it in degrees? Set "
            "`unit: deg`, or `multi_turn: true` in the joint's position channel if it does turn that far."
        ),
    ),
    (
        channel_notes.QuantisedPosition(1e-3, 10.0),
        (
            "the position is quantised in steps of 0.001, and most samples differ by fewer than 10 of them: the "
            "error is not white noise, so do not rely on a noise level estimated from it."
        ),
    ),
    (
        channel_notes.ConstantTorque(1.0),
        (
            "the torque is 1 throughout; check that the right column is named and was recorded. The fit leaves its "
            "equation out, unless the other joints show that the joint turns freely."
        ),
    ),
    (
        channel_notes.ArmAtRest(2.5, 4.0),
        (
            "the arm is at rest from 2.5 to 4.0 s: static friction there can take any value up to its limit. Set "
            "`rests: trim`, `min_speed`, or a window without this part."
        ),
    ),
    (
        channel_notes.ArmAtRest(12345.04, 12345.51, kept=False),
        (
            "the arm is at rest from 12345.04 to 12345.51 s: static friction there can take any value up to its "
            "limit. At the ends of a log this is left out, and within it where that predicts the torque in motion "
            "better."
        ),
    ),
    (
        channel_notes.EquallySpaced(0.0086, 853.2, 200.0, 0),
        (
            "samples are taken as equally spaced, at 200 Hz: the steps of the stamps vary by 0.86 %, and the positions "
            "are 853 times less noisy. `time: { spacing: stamps }` undoes it."
        ),
    ),
    (
        channel_notes.EquallySpaced(0.16, 0.5, 200.0, 13),
        (
            "samples are taken as equally spaced, at 200 Hz, 13 lost samples left open: the steps of the stamps vary "
            "by 16 %, and the positions are 2 times more noisy. `time: { spacing: stamps }` undoes it."
        ),
    ),
    (
        channel_notes.StampsJitter(0.163, 853.0, 200.0, None),
        (
            "the time steps vary by 16 % rms, and the positions would be 853 times less noisy with equal spacing: "
            "the sampling is regular and the stamps are not. Set `time: { rate: 200 }` instead of the column, and "
            "compare the held-out error."
        ),
    ),
    (
        channel_notes.StampsJitter(0.169, 167.0, None, 0.00500616),
        (
            "the time steps vary by 17 % rms, and the positions would be 167 times less noisy with equal spacing: "
            "the sampling is regular and the stamps are not. Round the stamps to multiples of 0.00500616 s in the "
            "file."
        ),
    ),
    (
        channel_notes.SamplingJitter(0.163, None),
        (
            "the time steps vary by 16 % rms, and the positions do not show whether the stamps or the sampling "
            "jitter. Keep the stamps, and use the spline smoother, which needs no equal spacing."
        ),
    ),
    (
        channel_notes.SamplingJitter(0.163, 835.0),
        (
            "the time steps vary by 16 % rms, and the positions would be 835 times noisier with equal spacing: "
            "the sampling itself jitters. Keep the stamps, and use the spline smoother, which needs no equal "
            "spacing."
        ),
    ),
    (
        channel_notes.LostSamples(13, 0.00325, 2.0),
        (
            "about 13 samples (0.33 %) are lost, in steps of up to 2 times the median: a spline bridges them if "
            "the time is taken from the stamps and not from a `rate`."
        ),
    ),
    (
        channel_notes.RepeatedPositions(0.75, 4),
        (
            "75 % of the positions exactly repeat the previous one although the joint moves: the encoder is read "
            "less often than it is logged. Keep only one row in 4, the first with each new value."
        ),
    ),
    (
        file_notes.ImpossibleInertia("negative mass -4 kg"),
        (
            "negative mass -4 kg. No body can have such an inertia. Take it from CAD, or identify it with `kind: "
            "consistent`."
        ),
    ),
    (
        file_notes.NoMass(("fore",)),
        (
            "the links that the joint moves (fore) have no mass in the file: simulators reject this, and it gives "
            "no prior. Take it from CAD, or identify it with `kind: consistent`."
        ),
    ),
    (
        file_notes.OnlyShapes(),
        (
            "its inertia follows from meshes or height fields, which are not read; save the compiled model from "
            "MuJoCo with <compiler saveinertial='true'/>, which writes the inertia out."
        ),
    ),
    (
        file_notes.FloatingBase(),
        (
            "it lets the whole robot float or drive, but only a fixed base is supported: it is taken as fixed. "
            "Record with the base clamped, as what it feels of a moving one is not modelled."
        ),
    ),
    (
        file_notes.SeveralLimbs("trunk", ("left", "right")),
        (
            "2 limbs move from the base 'trunk', which is taken as fixed (left, right): right for arms on a stand; "
            "a walking robot must be clamped at its trunk."
        ),
    ),
    (
        file_notes.PointMass(0.2),
        "0.2 kg without an inertia about the centre of mass: a point mass, or an inertia rounded to zero.",
    ),
    (
        file_notes.FarCentre(120.0),
        (
            "its centre of mass is 120 m from its frame. Is it in millimetres, or in another frame? A URDF gives "
            "metres in the link's own frame."
        ),
    ),
    (
        file_notes.LargeGyration(0.05, 0.408, 0.3, 0.3),
        (
            "its largest moment 0.05 kg m^2 means a radius of gyration of 0.41 m for its 0.3 kg, on a link of "
            "about 0.3 m. Is it about another point, or a placeholder? It would be a misleading prior."
        ),
    ),
    (
        file_notes.InertiaAboutOrigin(("upper", "fore")),
        (
            "the inertias of upper, fore are as large as if they were about the origins of the links' frames. A "
            "robot file gives them about the centre of mass; if that was overlooked, subtract m c^2 (parallel "
            "axes)."
        ),
    ),
    (
        file_notes.EqualLinks(("upper", "fore"), 2.0, alone=False),
        ("upper, fore have the same mass 2 kg and the same moments: copied, or simple shapes? They are a weak prior."),
    ),
    (
        file_notes.EqualLinks(("upper", "fore"), 2.0, alone=True),
        (
            "all links have the same mass 2 kg and the same moments: placeholders? Take it from CAD, or identify "
            "it with `kind: consistent`."
        ),
    ),
    (
        file_notes.OddTotalMass(6004.0),
        "the total mass of all links is 6004 kg. Are the masses in kg?",
    ),
    (
        file_notes.EmptyRange(0.0, 0.0),
        "its lower limit 0 is not below its upper limit 0: simulators use it as given. Correct it.",
    ),
    (
        file_notes.LimitNotPositive("effort", 0.0),
        "its effort limit is 0: simulators use it as given. Correct it.",
    ),
    (
        file_notes.NoLimit("velocity", ("s", "e")),
        "no velocity limit for s, e: recordings cannot be checked against it.",
    ),
    (
        file_notes.GravityIgnored((0.0, 0.0, -1.62), (0.0, 0.0, -9.81)),
        (
            "the file's gravity (0.0, 0.0, -1.62) is ignored; (0.0, 0.0, -9.81) m/s^2 is used. Set `gravity` if "
            "the arm is mounted that way."
        ),
    ),
    (
        file_notes.OtherGravity((0.0, -6.8, -7.1), (0.0, 0.0, -9.81)),
        (
            "is gravity right? The torques fit a gravity of about (0, -6.8, -7.1) m/s^2 in the root link's "
            "frame, not (0, 0, -9.81). Set `gravity` if the arm is mounted that way; otherwise check the signs of "
            "all torques and positions, and `zero`."
        ),
    ),
    (
        file_notes.ReversedSign(-0.999),
        (
            "is the sign of the torque reversed? In this motion it opposes the torque of the robot file's "
            "inertias (correlation -1.00). Check the signs of `gain` and `transmission`, and that position and "
            "torque have the same positive direction."
        ),
    ),
    (
        file_notes.ReversedSign(None),
        (
            "is the sign of the torque reversed? In this motion friction and inertia of the joint are estimated "
            "as negative. Check the signs of `gain` and `transmission`, and that position and torque have the "
            "same positive direction."
        ),
    ),
    (
        file_notes.OddScale(99.9, "N m"),
        (
            "the torque is 99.9 times that of the robot file's inertias. Is a gear ratio, a torque constant or a "
            "unit missing in `gain`? It should be in N m."
        ),
    ),
    (
        file_notes.UnrelatedTorque(12.0, 0.19),
        (
            "does this torque belong to this joint? It hardly correlates with the torque of the robot file's "
            "inertias, which is 12 times as large (correlation 0.19). Check the column."
        ),
    ),
    (
        motion_notes.LoopVelocity(1, 2, 0.0324, 0.00264),
        (
            "with its velocity over 1 step, the controller asks for a torque that differs from the measured one by "
            "3.24 %, over 2 by 0.264 %. Give `velocity_steps: 2`, or the drive's `period`. What is found by simulating "
            "the loop is wrong by more than its errors say."
        ),
    ),
    (
        motion_notes.LoopVelocity(1, 0, 0.094, 0.0054),
        (
            "with its velocity over 1 step, the controller asks for a torque that differs from the measured one by "
            "9.4 %, with the velocity of the moment by 0.54 %. Give the drive's `period`. What is found by simulating "
            "the loop is wrong by more than its errors say."
        ),
    ),
    (
        motion_notes.LoopGain(0.8, 0.25, 0.01),
        (
            "the measured torque is 0.8 times what the controller asks for (they differ by 25 %, with this factor by "
            "1 %). Check its gains and that of the torque. What is found by simulating the loop is wrong by more than "
            "its errors say."
        ),
    ),
    (
        motion_notes.LoopUnused(("q1_ref", "q2_ref", "q3_ref")),
        (
            "columns are named as reference positions ('q1_ref', 'q2_ref' and 1 more). With the gains of the drives, "
            "in the section `simulation`, estimators that simulate the loop apply as well, and the model is judged in "
            "it."
        ),
    ),
    (
        motion_notes.LoopDiffers(0.75),
        (
            "the controller asks for a torque that differs from the measured one by 75 %. Check its gains and its "
            "reference; or something else drives this joint, too. What is found by simulating the loop is wrong by "
            "more than its errors say."
        ),
    ),
    (
        motion_notes.HardlyMoves(0.0016, 4.4, 0.70012, "rad"),
        (
            "the joint hardly moves in training, by 0.0016 rad where others move by up to 4.4: nothing is seen of its "
            "friction and rotor, and where it does move its torque is not to be relied on. Record a motion of it, or "
            "hold it in the model: `lock` it at 0.7001, and leave it out of `joints`, `position` and `torque`."
        ),
    ),
    (
        motion_notes.FewReversals(1),
        (
            "the joint reverses only once: friction, offset and gravity are then strongly correlated. Record a "
            "motion that goes back and forth."
        ),
    ),
    (
        motion_notes.PositionBeyondLimits(-0.5, 0.5, -1.0, 0.2),
        (
            "the position runs from -0.5 to 0.5, the file allows -1 to 0.2. Check the unit, the sign and `zero`, "
            "or the file's limits."
        ),
    ),
    (
        motion_notes.PositionBeyondLimits(-90.0, 110.0, -2.5, 2.5, far=True),
        (
            "the position runs from -90 to 110, the file allows -2.5 to 2.5. Is it in another unit, or of a motor "
            "before its gear (see `transmission`)?"
        ),
    ),
    (
        motion_notes.VelocityAboveLimit(1.0, 0.5),
        (
            "the velocity reaches 1, the robot file allows 0.5 (rad/s or m/s). Check the units of position and "
            "time; or the positions are too noisy for this smoother."
        ),
    ),
    (
        motion_notes.EffortAboveLimit(12.0, 10.0, "N m", far=False),
        "the torque reaches 12 N m, the robot file allows 10. Check the unit and gain, or the file.",
    ),
    (
        motion_notes.EffortAboveLimit(300.0, 10.0, "N m", far=True),
        "the torque reaches 300 N m, the robot file allows 10. Is it a motor current, or in another unit?",
    ),
    (
        motion_notes.EffortFarBelowLimit(1e-3, 10.0, "N m"),
        (
            "the torque stays below 0.001 N m, a thousandth of the robot file's limit 10. Is it on the motor side "
            "of the gear, in another unit, or is the limit a placeholder?"
        ),
    ),
    (
        motion_notes.SearchLeftOut(motion_notes.SearchKind.PAIRS, 30, 330),
        (
            "the model has 330 parameters of 30 joints, so that exchanged columns were looked for only among joints "
            "that follow each other."
        ),
    ),
    (
        motion_notes.CorrelatedParameters(5, 1e6),
        (
            "the 5 base parameters are strongly correlated in these motions (condition number 1.0e6): move more "
            "joints at the same time, faster, and over more of their range."
        ),
    ),
    (
        log_notes.ClippedTorque(4, 9.5, 7, 1.25, True, False),
        (
            "4 torques are exactly 9.5, first sample 7 (t = 1.25 s), where the motion needs more: the sensor or "
            "the signal is at its limit. They are left out of the fit. Record with a larger range, or a gentler "
            "motion."
        ),
    ),
    (
        log_notes.FrozenPosition(7, 10, 1.0, 2.0, 0.5, True),
        (
            "the position is 0.5 for 10 samples, from sample 7 (t = 1 s) to t = 2 s, and jumps: it was not read "
            "there. They are replaced by what is around them, and left out of the fit. Look for a loose cable, a "
            "lost message, or a full buffer where it was recorded."
        ),
    ),
    (
        log_notes.FrozenTorque(7, 10, 1.0, 2.0, 0.5, False, True),
        (
            "the torque is 0.5 for 10 samples, from sample 7 (t = 1 s) to t = 2 s, though the motion needs "
            "another: it was not read there, or the drive was off. The error on this log counts them as measured;"
            " correct them in the file, or leave them out with a window. Look for a loose cable, a lost message, "
            "or a full buffer where it was recorded."
        ),
    ),
    (
        log_notes.GravityCompensated(0.02, 0.01, 31.0, 4.2),
        (
            "the torque shows 0.02 +- 0.01 times the gravity of the arm: without it the plain fit leaves 4.2 % "
            "instead of 31 %. Was it logged after gravity compensation, or is the arm mounted so that gravity "
            "does not act? Log the whole torque, add the compensation to it by `sum`, or set `gravity: [0, 0, 0]`"
            " for a model without gravity."
        ),
    ),
    (
        log_notes.InterpolatedPositions(0.48),
        (
            "48 % of the positions lie exactly on the line between their neighbours: they were interpolated from "
            "fewer samples, which adds no knowledge and spoils accelerations. Log at the rate of the encoder, or "
            "keep only its own samples."
        ),
    ),
    (
        log_notes.ManyPositionSpikes(40, (7, 9), (1.0, 1.5), 0.3, False),
        (
            "40 positions stand out by up to 0.3, too many to be replaced: samples 7, 9, ... (t = 1, 1.5, ... s)."
            " Correct them in the file. Look for a loose cable, a lost message, or a full buffer where it was "
            "recorded."
        ),
    ),
    (
        log_notes.ManyTorqueOutliers(0.12, 7, 1.25),
        (
            "12 % of the torques look like outliers, first sample 7 (t = 1.25 s): too many to be left out, so "
            "that none is. Is it the right column, or was it recorded badly?"
        ),
    ),
    (
        log_notes.NoFriction(0.4),
        (
            "the torque shows almost no friction: at most 0.4 % of any joint's. Was it logged after friction "
            "compensation, measured behind the gears, or simulated without friction? The model then gives the "
            "torque of the links: for feedforward, add the friction of the drives."
        ),
    ),
    (
        channel_notes.PerhapsMillimetres(120.0, 300.0),
        (
            "the position spans 120 m at up to 300 m/s, more than a sliding joint does; is it in millimetres? Set"
            " `unit: mm`."
        ),
    ),
    (
        log_notes.PerhapsRadians(2.0, 60.0, 5.0),
        (
            "no joint moves more than 2 rad; as degrees that should have been radians, the positions leave 5 % of"
            " the torque unexplained instead of 60 %. Are they in rad? Set `unit: rad`."
        ),
    ),
    (
        log_notes.PositionJump(2, 0.5, 7, 1.25),
        (
            "the position jumps by 0.5 after sample 7 (t = 1.25 s), and once more: are two recordings joined, or "
            "did the encoder lose counts? Give the pieces as separate logs, by windows."
        ),
    ),
    (
        log_notes.PositionSpikes(2, (7, 9), (1.0, 1.5), 0.3, True),
        (
            "2 positions stand out by up to 0.3: samples 7, 9 (t = 1, 1.5 s). They are replaced by what is around"
            " them, and left out of the fit. Look for a loose cable, a lost message, or a full buffer where it "
            "was recorded."
        ),
    ),
    (
        log_notes.RepeatedMotion("run1", 0.5, 0.2),
        (
            "repeats the motion of 'run1', 0.5 s later in it, to 0.2 %: its error shows repeatability, not how "
            "the model does on another motion. Hold out a different motion. (Repeats at another speed are not "
            "looked for.)"
        ),
    ),
    (
        log_notes.SameData("run1", 0.0),
        (
            "holds the same samples as 'run1' of the training: nothing is held out, and its error says nothing. "
            "Give another recording for validation."
        ),
    ),
    (
        log_notes.SlowMotion(1.5, 6.0, 4.0),
        (
            "accelerations explain only 1.5 % of the torque, less than the 6 % that the fit leaves: the motion is"
            " too slow to show inertias, and faster motion would not be predicted. Record one at least 4 times as"
            " fast."
        ),
    ),
    (
        log_notes.TorqueSpikes(2, (7, 9), (1.0, 1.5), 30.0, True, False),
        (
            "2 torques stand out by up to 30, unlike the motion: samples 7, 9 (t = 1, 1.5 s). They are left out "
            "of the fit. Look for a loose cable, a lost message, or a full buffer where it was recorded."
        ),
    ),
    (
        channel_notes.WrappedPosition(3, 6.2832, 7, 1.25),
        (
            "the position wraps: it jumps 3 times by 6.2832 rad, its whole range, first after sample 7 (t = 1.25 "
            "s). Set `wraps` in its position channel: the value at which the column starts anew, such as 360 for "
            "degrees or 6.283185307179586 for rad."
        ),
    ),
    (
        channel_notes.WrongTimeUnit(200000.0, 40000.0, 1000.0),
        (
            "a rate of 2e+05 Hz with speeds up to 4e+04 rad/s or m/s is not that of a robot; with stamps "
            "multiplied by 1000 both would be usual: are the stamps in s and declared as ms? Set `unit: s`."
        ),
    ),
]


@pytest.mark.parametrize(("note", "said"), SAID, ids=lambda x: x[:30] if isinstance(x, str) else "")
def test_notes_say_their_figures_and_what_to_do(note: Note, said: str) -> None:
    assert str(note) == said


def test_factors_are_rounded_and_small_ones_in_percent() -> None:
    def said(factor: float) -> str:
        return str(channel_notes.SamplingJitter(0.2, factor))

    assert "would be 5 % noisier" in said(1.05)
    assert "would be 2 times noisier" in said(2.0)
    assert "would be over 1000 times noisier" in said(2e3)


def test_repeated_positions_that_are_not_every_other_have_another_remedy() -> None:
    assert "Drop the repeated rows" in str(channel_notes.RepeatedPositions(0.2, 1))
    assert "Drop the repeated rows" in str(channel_notes.RepeatedPositions(1.0, 0))


@pytest.mark.parametrize(
    ("lag", "place"),
    [(0.0, "'a', to 3 %"), (0.4, "'a', 0.4 s later in it, to"), (-0.4, "'a', begun 0.4 s before it, to")],
)
def test_a_repeat_may_begin_after_the_other_log_or_before(lag: float, place: str) -> None:
    assert place in str(log_notes.RepeatedMotion("a", lag, 3.0))
    same = str(log_notes.SameData("a", lag))
    assert ("later" in same, "before it" in same) == (lag > 0, lag < 0)
