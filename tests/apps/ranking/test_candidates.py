"""Which parts are compared, and their names."""

from __future__ import annotations

from pathlib import Path

import pytest

import dynident as dy
from dynident.apps.ranking.config import estimator_candidates, smoother_candidates
from dynident.estimators import LinearEstimator
from dynident.models.lagrangian import slider
from dynident.project.config import parse_config
from dynident.project.settings import Config
from dynident.runtime import ConfigError
from dynident.runtime.families import ESTIMATORS, SMOOTHERS
from tests.apps.ranking.made import CONFIG, Greedy

BODIES = dy.read_robot(Path(__file__).parents[3] / "src/dynident/apps/demo/files/arm.urdf")


def config(more: str = "", smoother: str = "{ kind: spline }") -> Config:
    return parse_config(CONFIG.replace("{ kind: spline }", smoother) + more)


def names(found: tuple[object, ...]) -> list[str]:
    return [one.name for one in found]  # type: ignore[attr-defined]


def test_all_that_need_no_settings_take_part_the_configured_one_first() -> None:
    found = smoother_candidates(config())
    assert found[0].is_configured
    assert found[0].name == "spline (rule constraint)"
    assert set(names(found[1:])) == set(SMOOTHERS.kinds()) - {"time_shifted"}
    usual = smoother_candidates(config(smoother="{ kind: spline, rule: torque }"))
    assert names(usual)[0] == "spline"
    assert len(usual[0].parts) > 1
    assert len(usual) == len(found) - 1
    assert (
        names(smoother_candidates(config(smoother="{ kind: spline, rule: torque, ends: 50 }"), []))[0]
        == "spline (ends 50)"
    )


def test_linear_estimators_are_made_consistent_where_there_are_bodies() -> None:
    found = estimator_candidates(config(), BODIES)
    linear = [one.part for one in found if isinstance(one.part, LinearEstimator)]
    assert "consistent+least_squares" in names(found)
    assert sum(name.startswith("consistent+") for name in names(found)) == len(linear)
    plain = estimator_candidates(config(), slider())
    assert not [name for name in names(plain) if name.startswith("consistent")]
    assert set(names(plain)) == set(ESTIMATORS.kinds()) - {"consistent"}


def test_kinds_parts_and_settings_may_be_given() -> None:
    given = estimator_candidates(
        config(), BODIES, ["consistent+least_squares", "consistent", dy.LeastSquares(weights="per_joint")]
    )
    assert names(given) == [
        "least_squares", "consistent+least_squares", "consistent", "least_squares (weights per_joint)",
    ]  # fmt: skip
    assert names(smoother_candidates(config(), [Greedy(), Greedy()])) == ["spline (rule constraint)", "Greedy"]
    section = "compare: { smoothers: [butterworth, { kind: spline, ends: 9 }], estimators: [maximum_likelihood] }\n"
    assert names(smoother_candidates(config(section)))[1] == "butterworth"
    assert names(estimator_candidates(config(section), BODIES)) == ["least_squares", "maximum_likelihood"]
    assert names(smoother_candidates(config(section), ["difference"]))[1:] == ["difference"]


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("splin", "'splin' is not a choice; did you mean 'spline'"),
        ("time_shifted", "'time_shifted' needs settings; give them in the section `compare`"),
    ],
)
def test_a_wrong_smoother_is_named(kind: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        smoother_candidates(config(), [kind])


def test_what_is_not_linear_cannot_be_made_consistent() -> None:
    with pytest.raises(ConfigError, match="'maximum_likelihood' is not linear in the parameters"):
        estimator_candidates(config(), BODIES, ["consistent+maximum_likelihood"])
    with pytest.raises(ConfigError, match=r"compare.estimators\[0\]"):
        config("compare: { estimators: [nothing] }\n")
