"""What a motion will tell, in sentences and tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynident.apps.excitation import Program
from dynident.apps.excitation.expected_report import expected_findings, expected_section, has_value
from tests.report.designs import designed


def with_shares(*percents: float):
    """A design whose parameters that have a value are expected to so many per cent, the others to 1 unit."""
    found = designed()[1]
    one = found.expected
    value, std = np.zeros(len(one.std)), np.ones(len(one.std))
    value[: len(percents)], std[: len(percents)] = 2.0, np.array(percents) / 50
    return replace(found, expected=replace(one, value=value, std=std))


def test_parameters_are_counted_by_how_well_they_will_be_known() -> None:
    first, longer, worst, rest, *others = expected_findings(with_shares(1.0, 9.0, 25.0, 50.0, 200.0))
    assert "5 of which have a nominal value" in first
    assert "2 will be known well (to 10 %), 1 fairly (to 30 %) and 2 poorly" in first
    assert "2 will be known well (to 10 %), 2 fairly (to 30 %) and 1 poorly" in longer
    assert worst.startswith(f"The least known is {designed()[1].expected.basis.groupings[4].split(' ')[0]}")
    assert "2.00 +- 4.0" in worst
    assert f"Of the other {len(designed()[1].expected.std) - 5}" in rest
    assert others == []


def test_what_was_known_before_and_what_stays_open() -> None:
    found = designed()[1]
    one = found.expected
    B = one.basis.combination
    before = 0.01 * B.T @ np.diag(1 / one.std**2) @ B
    prior = replace(found, request=replace(found.request, prior=before))
    (line,) = [line for line in expected_findings(prior) if line.startswith("Together with")]
    assert "smaller than now by a factor of" in line
    std = one.std.copy()
    std[0] = np.inf
    said = list(expected_findings(replace(found, expected=replace(one, std=std))))
    assert said[-1] == f"1 base parameter stays open: {one.basis.leading[0]}."
    slow = replace(found.request, program=Program.FRICTION)
    *_, said = expected_findings(replace(found, request=slow, expected=replace(one, std=std)))
    assert "`--program motion`" in said
    assert list(expected_findings(replace(found, expected=replace(one, std=np.full_like(std, np.inf))))) == [
        "The motion tells nothing: it shows no base parameter."
    ]


def test_the_table_marks_what_is_open_or_has_no_value() -> None:
    found = with_shares(5.0)
    std = found.expected.std.copy()
    std[1] = np.inf
    section = expected_section(replace(found, expected=replace(found.expected, std=std)))
    (table,) = [fold.blocks[0] for fold in section.blocks if getattr(fold, "title", "") == "All numbers"]
    assert table.rows[0][1:] == ("2.000", "0.10", "5.0")
    assert table.rows[1][1:] == ("-", "open", "-")
    assert has_value(found.expected).sum() == 1
    rounded = np.where(found.expected.value == 0, 1e-12, found.expected.value)
    assert has_value(replace(found.expected, value=rounded)).sum() == 1
