"""Numbers and words as users read them."""

from dynident.runtime.text import capitalise, number_within


def test_only_the_first_letter_becomes_upper_case() -> None:
    assert capitalise("iSAM of q_1") == "ISAM of q_1"
    assert capitalise("x") == "X"
    assert capitalise("") == ""


def test_a_number_has_the_digits_that_its_standard_error_leaves() -> None:
    pairs = ((0.00185, 0.0067), (0.004308, 0.026), (2.99876, 0.012), (-41.26, 31.0), (12.0, 310.0), (4.2e-7, 3e-8))
    assert [number_within(*pair) for pair in pairs] == ["0.0019", "0.004", "2.999", "-41", "12", "4.20e-7"]
    assert [number_within(1e-4, 0.5), number_within(0.0, 0.5), number_within(2.0, float("nan"))] == ["0", "0", "2.000"]
