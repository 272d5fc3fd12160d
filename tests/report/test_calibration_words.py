"""The words of what is chosen before the fit hold its figures."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.identification import BaseTilt, Gain, Rests, SmootherChoice, TimeOffset
from dynident.motion.smoothers import Difference, Spline
from dynident.report.terminal import words


@pytest.mark.parametrize(
    ("noun", "said"),
    [
        (
            TimeOffset(0.005, 4.0, 2.0),
            "positions are stamped 5 ms later than torques; with it, the training error is 2 % instead of 4 %",
        ),
        (
            TimeOffset(-0.005, 4.0, 2.0),
            "torques are stamped 5 ms later than positions; with it, the training error is 2 % instead of 4 %",
        ),
        (TimeOffset(0.0, 4.0, 4.0), "none, as none lowers the training error (4 %)"),
        (
            TimeOffset(0.0, 4.0, 4.0, 1e-4),
            "none, as none lowers the training error (4 %) significantly; its standard error would be 0.1 ms",
        ),
        (
            TimeOffset(0.0021, 4.0, 2.0, 2e-4),
            "positions are stamped 2.1 +- 0.2 ms later than torques; with it, the training error is 2 % instead of 4 %",
        ),
        (
            BaseTilt(0.02, -0.035, (1e-3, 2e-3), 4.0, 2.0),
            (
                "the base is tilted by 1.15 deg about x and -2.01 deg about y (+- 0.06 and 0.11); with it, the "
                "training error is 2 % instead of 4 %"
            ),
        ),
        (
            BaseTilt(0.0, 0.0, (1e-3, 2e-3), 4.0, 4.0, Gain(31.2, 4.1), (1.57, 0.0)),
            (
                "the base is taken as level (+- 0.06 and 0.11 deg about x and y): the best tilt would gain 31 +- 4.1 % "
                "of the squared cross-validated error, but is 90.0 deg about x and 0.0 deg about y, more than a "
                "mounting error"
            ),
        ),
        (
            TimeOffset(0.0, 2.0, 2.0, 1e-3, Gain(-9.94, 12.2)),
            (
                "none, as the best one does not predict left-out stretches better: -9.9 +- 12 % of the squared "
                "cross-validated error"
            ),
        ),
        (
            Rests("a", 4.7, 0.52, 0.0),
            "a: 4.7 s at its start and 0.52 s at its end, where the arm is at rest, are left out of fit and errors",
        ),
        (
            Rests("a", 0.0, 1.2, 2.5, Gain(12.3, 1.2)),
            (
                "a: 1.2 s at its end, where the arm is at rest, are left out of fit and errors; rests of 2.5 s within "
                "are left out of the fit, which gains 12 +- 1.2 % of the squared cross-validated error in motion"
            ),
        ),
        (
            Rests("a", 0.0, 0.0, 2.5, Gain(1.0, 2.0)),
            (
                "a: rests of 2.5 s within are fitted: without them 1 +- 2 % of the squared cross-validated error in "
                "motion would be gained"
            ),
        ),
        (Rests("a", 0.0, 0.0, 2.5), "a: rests of 2.5 s within are counted in its errors"),
        (
            SmootherChoice(Difference(), (Difference(), Spline()), (1.5, np.inf)),
            (
                "forward differences, by the cross-validated torque error on the training logs (forward differences: "
                "1.5 %; smoothing spline, S = n: cannot smooth these logs)"
            ),
        ),
    ],
    ids=lambda x: x[:30] if isinstance(x, str) else "",
)
def test_words_hold_the_figures(noun: object, said: str) -> None:
    assert words(noun) == said
