"""Units, numbers and sentences as pages show them."""

import pytest

from dynident.report.page import cell, sentence, typeset, unit_text


@pytest.mark.parametrize(
    ("show", "plain", "shown"),
    [
        (unit_text, "kg m^2", "kg m²"),
        (unit_text, "N m (s/rad)^0.5", "N m (s/rad)^0.5"),
        (unit_text, "m^-1", "m⁻¹"),
        (unit_text, "arm_m^2", "arm_m^2"),
        (cell, "-1.20e-5", "−1.20 × 10⁻⁵"),
        (cell, "3e+07", "3 × 10⁷"),
        (cell, "-", "-"),
        (cell, "", ""),
        (cell, "-1.5 rad", "−1.5 rad"),
        (
            sentence,
            "p = 1.0e-05, 5 % +- 1 of <b> in `a+-b %` at 3 m/s^2",
            "p = 1.0 × 10⁻⁵, 5 % ± 1 of &lt;b&gt; in <code>a+-b %</code> at 3 m/s²",
        ),
        (
            typeset,
            "-0.5 (-0.49 +- 0.07), -1.0e-05 on log 5-7.4 s",
            "−0.5 (−0.49 ± 0.07), −1.0 × 10⁻⁵ on log 5-7.4 s",
        ),
        *((typeset, f"{name}: short", f"{name}: short") for name in ("run 1e-5.csv", "log_1e-5", "robot1e5", "1e5")),
        (typeset, "v2.1e3a: short", "v2.1e3a: short"),
    ],
)
def test_text_is_typeset_and_names_in_it_stay_as_they_are(show, plain, shown):
    assert show(plain).replace("\u00a0", " ") == shown
