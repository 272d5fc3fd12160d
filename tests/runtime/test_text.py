"""Numbers and words as users read them."""

from dynident.runtime.text import capitalise, shorten


def test_only_the_first_letter_becomes_upper_case() -> None:
    assert capitalise("iSAM of q_1") == "ISAM of q_1"
    assert capitalise("x") == "X"
    assert capitalise("") == ""


def test_a_text_is_cut_at_a_word() -> None:
    assert shorten("one two three", 13) == shorten("one two three", None) == "one two three"
    assert shorten("one two three", 12) == "one two …"
