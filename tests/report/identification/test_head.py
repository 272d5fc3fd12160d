"""The numbers at the head of a report: the error over what the sensors allow first, where it is known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from dynident.identification import SourceFile, judge
from dynident.report.identification import identification_page
from dynident.report.identification.head import head_numbers, summary_lines, worst_joint
from dynident.report.identification.validation import floor_ratio_text
from dynident.validation import FloorOrigin, HighFrequency, NoiseFloor, residual_text
from tests.report.conftest import identification_of
from tests.report.test_page import EVIL

AT = NoiseFloor(0.0196, 1.02, 1.06, FloorOrigin.REPEATS)
ABOVE = NoiseFloor(0.01, 2.0, 2.1, FloorOrigin.WHITE)


def at_floor(floors):
    identification = identification_of()
    for log in identification.validations:
        log.floors, log.over_floor, log.at_floor = (
            floors,
            1.02 if floors else None,
            all(x.is_reached for x in floors.values()),
        )
    return identification


def test_the_error_over_what_the_sensors_allow_comes_first():
    first, second, *_ = head_numbers(at_floor({"shoulder": AT, "elbow": AT}))
    assert first == ("1.02 ×", "torque error relative to noise", "at the noise floor")
    assert second[:2] == ("5.10 %", "torque error, held out")
    (first, *_) = head_numbers(at_floor({"shoulder": ABOVE}))
    assert first[2] == "at most, by white noise alone; 1 of 2 joints"


def test_where_it_is_not_known_the_relative_error_does():
    floor = at_floor({})
    floor.validations[1].at_floor = False
    (first, *_) = head_numbers(floor)
    assert first[:2] == ("5.10 %", "torque error, held out")
    assert first[2] == "training 1.10 %; the noise of the sensors is not known"


def test_a_residual_at_the_noise_floor_has_no_other_cause():
    floor = at_floor({"shoulder": AT, "elbow": AT})
    said = judge(floor).sentences()[2]
    assert said == (
        "The torque residual is at the noise floor: on reach.csv it is 1.02 times the noise of the sensors, and at "
        "each joint at most 1.15 times with 95 % confidence."
    )
    assert residual_text(floor.validations[1], "elbow") == "at the noise floor"
    assert "elasticity" not in identification_page(floor).partition("<main>")[2]
    assert floor_ratio_text(floor.validations[1], "elbow") == "1.02"


def test_of_one_joint_at_the_floor_it_is_said_where():
    floor = at_floor({"elbow": AT, "shoulder": AT})
    floor.validations[1].at_floor = False
    assert "in elbow (reach.csv), where it is at the noise floor, 1.02 times" in judge(floor).sentences()[2]


def test_what_is_above_the_floor_is_not_its_noise():
    floor = at_floor({"shoulder": ABOVE, "elbow": ABOVE})
    floor.validations[1].residuals = {"elbow": SimpleNamespace(causes=(HighFrequency(),), lag1=0.1)}
    words = "ripple, elasticity or a time offset, or coloured noise (mostly above 5 Hz)"
    assert residual_text(floor.validations[1], "elbow") == words
    assert f"2.0 times the white noise of the sensors, and points to {words}." in judge(floor).sentences()[2]
    floor.validations[1].floors = {}
    assert residual_text(floor.validations[1], "elbow").startswith("noise, ripple")
    assert floor_ratio_text(floor.validations[1], "elbow") == "-"


def test_a_residual_a_little_above_the_noise_is_called_so():
    floor = at_floor({"elbow": NoiseFloor(0.01, 1.3, 1.4, FloorOrigin.REPEATS)})
    assert ", only 1.3 times the noise of the sensors; what remains " in judge(floor).sentences()[2]


def test_every_error_after_the_low_pass_is_called_so_and_the_rms_stands_beside_that_as_measured():
    identification = identification_of()
    for log in identification.validations:
        log.errors.relative_error_filtered, log.errors.per_joint_filtered = 2.0, {"shoulder": 1.0, "elbow": 3.0}
        log.over_floor = None
    error, worst, _ = head_numbers(identification)
    assert error[:2] == ("2.00 %", "torque error after the low-pass, held out")
    assert error[2].startswith("training 2.00 %; as measured 5.10 %")
    assert worst == ("3.00 %", "worst joint after the low-pass, held out", "elbow, as measured 4.50 %, rms 0.0200 N m")
    *_, line = summary_lines(identification)
    assert line == "Worst joint: elbow, 4.50 % on reach.csv (3.00 % after the low-pass), rms 0.0200 N m"
    assert "elbow on reach.csv, 4.50 % error as measured." in identification_page(identification)


def test_the_worst_joint_is_held_out_and_has_an_error():
    identification = identification_of()
    identification.validations[1].errors.per_joint = {"shoulder": 3.0, "elbow": np.nan}
    assert worst_joint(identification) == (identification.validations[1], "shoulder")


def test_the_picture_of_the_worst_joint_and_the_dates_are_at_the_head():
    identification = identification_of(joints=(EVIL, "elbow"))
    logs = (
        SourceFile("a.csv", modified="2026-11-20T08:00:00+00:00"),
        SourceFile("b.csv", modified="2026-11-22T08:00:00"),
    )
    identification.provenance = replace(identification.provenance, identified="2026-11-22T14:05:09+00:00", logs=logs)
    page = identification_page(identification)
    assert "Identified 2026-11-22 14:05 UTC. Files of 2026-11-20 to 2026-11-22." in page
    assert "<script>alert" not in page
    assert page.index("facts large") < page.index("The worst joint: elbow on reach.csv") < page.index("What to do next")
    for log in identification.validations:
        log.motion = replace(log.motion, t=log.motion.t + 1.46e9)
    assert "Recorded 2016-04-07." in identification_page(identification)
