"""The words of reasons against a model hold their figures."""

from __future__ import annotations

import pytest

from dynident.identification import Reason
from dynident.identification import verdict as why
from dynident.models.simulation import Singular
from dynident.report.terminal import words
from dynident.validation import Driver


@pytest.mark.parametrize(
    ("reason", "said"),
    [
        (why.NegativeValues(tuple("abcdefg")), "negative values, which are not physical: a, b, c, d, e and 2 more"),
        (
            why.JointErrorsTooLarge("fast", (("a", 40.0), ("b", 26.4)), 25.0),
            "on fast some joints have a torque error above 25 %: a 40 %, b 26.4 %",
        ),
        (
            why.UnfilteredErrorTooLarge("fast", 26.0, 25.0),
            "unfiltered, the torque error on fast is 26 %, above 25 %",
        ),
        (why.TorqueErrorTooLarge("fast", 11.0, 10.0), "the torque error on fast is 11 %, above 10 %"),
        (
            why.NotCarriedOver("fast", 2.51),
            "the error on fast is 2.5 times the training error: the model does not generalise",
        ),
        (
            why.Repeats((("b", "a"),)),
            "b repeats the motion of a: the error on another motion is not known",
        ),
        (
            why.SilentTorque(("a", "b")),
            "the torque of a, b does not change in any training log",
        ),
        (why.MassMatrixNotPositive(-0.1), "the mass matrix is not positive definite (eigenvalue -0.1)"),
        (why.MostlyUnexcited(3, 7), "the data do not excite 3 of 7 base parameters"),
        (
            why.PartlyUnexcited(1, 7),
            "the data do not excite 1 of 7 base parameters: motions that do are not predicted",
        ),
        (why.FreeRunFails(("a", "b"), Singular()), "the free simulation of a, b fails: the mass matrix is singular"),
        (
            why.FreeRunAstray("fast", "a", 30.0, Driver.TORQUE, 0.5),
            "the free simulation of fast has an error of 30 % of the motion of a within 0.5 s of the measured torque",
        ),
        (
            why.FreeRunAstray("fast", "a", 2.0, Driver.CONTROLLER, None),
            "the free simulation of fast has an error of 2 % of the motion of a in the controller's loop",
        ),
    ],
    ids=lambda x: x[:30] if isinstance(x, str) else "",
)
def test_words_hold_the_figures(reason: Reason, said: str) -> None:
    assert words(reason) == said
