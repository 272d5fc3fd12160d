"""Units and numbers as pages show them."""

import pytest

from dynident.report.page import cell, sentence, typeset, unit_text


@pytest.mark.parametrize(
    ("plain", "shown"),
    [
        ("N m s/rad", "N m s/rad"),
        ("kg m^2", "kg m²"),
        ("N m (s/rad)^0.5", "N m (s/rad)^0.5"),
        ("m^-1", "m⁻¹"),
        ("arm_m^2", "arm_m^2"),
    ],
)
def test_units(plain, shown):
    assert unit_text(plain) == shown


@pytest.mark.parametrize(
    ("plain", "shown"),
    [
        ("-1.20e-5", "−1.20 × 10⁻⁵"),
        ("3e+07", "3 × 10⁷"),
        ("-", "-"),
        ("", ""),
        ("-1.5 rad", "−1.5 rad"),
        ("∞", "∞"),
    ],
)
def test_cells_with_numbers(plain, shown):
    assert cell(plain).replace("\u00a0", " ") == shown


def test_sentences_are_escaped_and_typeset():
    found = sentence("p = 1.0e-05, 5 % +- 1 of <b> in `a+-b %` at 3 m/s^2")
    assert found == "p = 1.0\u00a0×\u00a010⁻⁵, 5\u00a0% ± 1 of &lt;b&gt; in <code>a+-b %</code> at 3 m/s²"


def test_negative_numbers_in_sentences_have_a_true_minus():
    assert typeset("-0.5 (-0.49 +- 0.07), -1.0e-05 on log 5-7.4 s") == (
        "−0.5 (−0.49 ± 0.07), −1.0\u00a0×\u00a010⁻⁵ on log 5-7.4 s"
    )


@pytest.mark.parametrize("name", ["run 1e-5.csv", "log_1e-5", "robot1e5", "1e5", "v2.1e3a"])
def test_names_in_sentences_stay_as_they_are(name):
    assert typeset(f"{name}: too short") == f"{name}: too short"
