"""Arms with ten laws of friction: the terms of the package are the laws, and the right ones are chosen.

The laws and their arms are those of benchmarks/friction_laws.py, written independently of the terms.
"""

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from dynident.models import Joint, Model, Past
from dynident.runtime.families import TERMS

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def benchmarks() -> Iterator[Path]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "benchmarks"))
        yield ROOT / "benchmarks"


@pytest.fixture(scope="module")
def laws(benchmarks: Path) -> ModuleType:
    return import_module("friction_laws")


SETTINGS: dict[str, tuple[str, ...]] = {  # a term's settings, as the law calls them
    "viscous": (), "coulomb": ("width",), "stribeck": ("width", "velocity"), "power": ("width", "exponent"),
    "load_coulomb": ("width",), "dahl": ("length",), "load_dahl": ("length",), "ripple": ("cycles",),
    "asymmetric_coulomb": ("width",), "asymmetric_viscous": (), "drift": ("time",),
}  # fmt: skip


@pytest.mark.parametrize("kind", SETTINGS)
def test_a_term_is_the_law_of_its_name(laws: ModuleType, kind: str) -> None:
    """On a motion sampled as logs are, from rest on; the law follows the path in steps of a tenth of that."""
    shape = laws.Shape()
    reference = {
        "width": shape.width if kind != "power" else 0.0, "velocity": shape.stribeck, "exponent": 0.5,
        "length": shape.length, "cycles": 2 * np.pi * shape.cycles, "time": shape.slow,
    }  # fmt: skip
    motion = laws.course(1, np.random.default_rng(5))
    at, load = slice(None, None, laws.DENSE), 10.0 * np.sin(2.0 * motion.q + 0.3)
    moved = laws.Moved(motion.t, motion.q[:, 0], motion.dq[:, 0], load[:, 0])
    column = laws.COLUMNS[kind](moved, shape)[at]
    settings = {name: reference[name] for name in SETTINGS[kind]}
    term = TERMS.get(kind)(joints=(Joint("one"),), **settings)
    states = motion.q[at], motion.dq[at], motion.ddq[at]
    memory = (term.remember(Past(motion.t[at], *states, load[at])),) if kind in REMEMBERED else ()
    result = term.regressor(*states, *memory)[:, 0]
    if kind == "ripple":  # of any phase
        result = result @ np.linalg.lstsq(result, column, rcond=None)[0][:, None]
    size = np.sqrt(np.mean(column**2))
    assert np.sqrt(np.mean((result[:, 0] - column) ** 2)) < (2e-3 if "dahl" in kind else 1e-9) * size
    assert Model((term,)).memory == (memory[0].shape[1] if memory else 0)


REMEMBERED = ("load_coulomb", "dahl", "load_dahl", "drift")


MIXED = {  # laws of all joints, and of every other one: two kinds on an arm cost no more than one
    "stribeck and load": ({"viscous": 0.1, "coulomb": 0.1}, {"stribeck": 0.1, "load_coulomb": 0.12}),
    "dahl and ripple": ({"viscous": 0.1}, {"dahl": 0.2, "ripple": 0.04}),
    "power and asymmetric": ({"coulomb": 0.1}, {"power": 0.2, "asymmetric_viscous": 0.06, "drift": 0.05}),
}


@pytest.fixture(scope="module")
def rows(laws: ModuleType) -> Iterator[list[dict[str, Any]]]:
    """Each law on an arm of three joints, the same noise in every run."""
    choice = import_module("friction_choice")
    with pytest.MonkeyPatch.context() as patch:
        for law, shares in MIXED.items():
            patch.setitem(laws.LAWS, law, shares)
        patch.setitem(laws.COULOMB, "dahl and ripple", laws.COULOMB["dahl"])
        yield [choice.study("three", law, seed=8) for law in MIXED]


def test_the_right_groups_are_found(rows: list[dict[str, Any]]) -> None:
    """At least nine of ten. Were each found with a probability of 0.75 only, this would fail in 90 of 100 draws."""
    needed, missed = (sum(len(row[key]) for row in rows) for key in ("needed", "missed"))
    assert needed == 14
    assert missed <= 1, [(row["law"], row["missed"]) for row in rows]


def test_no_wrong_groups_are_entered(rows: list[dict[str, Any]]) -> None:
    """At none of nine joints. With a wrong group at 1 of 6, this would fail in 81 of 100 draws."""
    assert [(row["law"], row["wrong"]) for row in rows if row["wrong"]] == []


def test_errors_are_those_of_an_oracle_that_knows_the_law(rows: list[dict[str, Any]]) -> None:
    """Held out, on motion of the same speed and twice as fast: within a tenth."""
    for row in rows:
        for role in ("same", "fast"):
            assert row[f"auto_{role}"] < 1.1 * row[f"oracle_{role}"], (row["law"], role)


def test_the_oracle_leaves_the_noise_alone(rows: list[dict[str, Any]]) -> None:
    """2 % of noise is all that it leaves: the laws of an arm and of its oracle agree."""
    for row in rows:
        assert row["oracle_same"] == pytest.approx(2.0, rel=0.03)
        assert row["oracle_same_true"] < 0.3
