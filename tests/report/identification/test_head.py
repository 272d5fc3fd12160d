"""The numbers at the head of a report: the error over what the sensors allow first, where it is known."""

from dynident.identification import judge
from dynident.report.identification import identification_page
from dynident.report.identification.head import head_numbers, summary_lines
from dynident.validation import FloorOrigin, NoiseFloor
from tests.report.conftest import identification_of

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


def test_of_one_joint_at_the_floor_it_is_said_where():
    floor = at_floor({"elbow": AT, "shoulder": AT})
    floor.validations[1].at_floor = False
    assert "in elbow (reach.csv), where it is at the noise floor, 1.02 times" in judge(floor).sentences()[2]


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
