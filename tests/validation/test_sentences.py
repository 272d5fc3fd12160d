"""What a residual, a failed simulation and the data themselves say."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.models.lagrangian import two_link_arm
from dynident.models.simulation import RunsAway
from dynident.regression import UnexcitedParameters
from dynident.validation import ResidualRipple

SENTENCES = [
    (
        UnexcitedParameters(("Fv_b", "Fc_b"), ("b",), still=("b",)),
        "Fv_b; Fc_b: not excited by these data; move b (at rest in these data: b).",
    ),
    (UnexcitedParameters(("x",), ("a", "b")), "x: not excited by these data; move a, b each by itself."),
    (
        UnexcitedParameters(("x",), ("a", "b"), together=True),
        "x: not excited by these data; move a, b at the same time.",
    ),
    (ResidualRipple(26.04), "a ripple at 26 Hz"),
    (RunsAway(0.1234), "the simulated position diverges after 0.123 s"),
]


@pytest.mark.parametrize(("fact", "sentence"), SENTENCES, ids=lambda x: type(x).__name__)
def test_a_fact_says_its_figures(fact: object, sentence: str) -> None:
    assert str(fact) == sentence


def test_the_mass_matrix_says_where_it_is_weakest() -> None:
    arm, q = two_link_arm(), np.stack([np.zeros(5), np.linspace(0.0, np.pi, 5)], axis=1)
    assert arm.values is not None
    good = str(arm.check_mass_matrix(q, arm.values))
    assert good.startswith("The mass matrix is positive definite: smallest eigenvalue 0.00")
    wrong = arm.values.copy()
    wrong[2] = 0.02
    bad = str(arm.check_mass_matrix(q, wrong))
    assert "not positive definite: eigenvalue -0.0" in bad
    assert "at q = (0, 3.142)" in bad
