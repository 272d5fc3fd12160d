"""Rates of a ripple are found where they are, and by each fold from its own training."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.identification.terms.ripple import near, peaks

T = np.linspace(0.0, 20.0, 8000)
Q = 1.5 * np.sin(T)
BLOCK = np.arange(len(T)) * 8 // len(T)


def test_the_rate_of_a_ripple_is_found() -> None:
    noise = np.random.default_rng(0).normal(size=len(T))
    found = peaks(Q, np.sin(45.0 * Q + 0.3) + noise, BLOCK, 8, 200.0)
    assert len(found) == 1
    assert found[0] == pytest.approx(45.0, abs=0.5)


def test_a_ripple_of_one_block_alone_is_found_by_the_others() -> None:
    one = np.where(BLOCK == 3, 3.0 * np.sin(45.0 * Q), np.sin(90.0 * Q))
    assert sorted(peaks(Q, one, BLOCK, 8, 200.0))[-1] == pytest.approx(90.0, abs=0.5)


def test_a_joint_that_stands_has_none() -> None:
    assert peaks(np.zeros(len(T)), np.ones(len(T)), BLOCK, 8, 200.0) == ()


def test_slow_waves_are_not_ripples() -> None:
    assert peaks(Q, np.sin(2.0 * Q), BLOCK, 8, 200.0) == ()


def test_the_rates_tried_around_a_line_hold_the_true_one_closely() -> None:
    found = peaks(Q, np.sin(45.3 * Q + 0.3), BLOCK, 8, 200.0)
    assert min(abs(k - 45.3) for k in near(found, Q)) < 0.04
    assert max(abs(k - 45.3) for k in near(found, Q)) < 1.5
