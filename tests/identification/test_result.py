"""The recipe as used, and what an identification does with a new log."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynident.estimators import LeastSquares
from dynident.identification import Identification, Recipe, identify
from dynident.models.simulation import PD
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline, TimeShifted, smooth_log
from dynident.runtime import ConfigError, InputError
from dynident.validation import free_run
from tests.identification.test_base_tilt import tilted
from tests.identification.test_time_offset import swing
from tests.project.same import assert_same


@pytest.fixture(scope="module")
def example() -> Identification:
    """Smoother, time offset and base tilt are all sought."""
    model, motion = tilted(0.02, -0.03)
    log = Log(motion.t, motion.q, motion.tau, motion.joints, "moves")
    sought = Recipe((Spline(), Spline(factor=2.0)), time_offset="estimate", base_tilt="estimate")
    return identify(model, [log], [replace(log, source="again")], sought)


def test_the_recipe_as_used_gives_the_same_again(example: Identification) -> None:
    """To the model as it was given: the tilt of the base is in the recipe."""
    model, _ = tilted(0.0, 0.0)
    log = example.validations[0].recorded_log
    again = identify(model, [log], [replace(log, source="again")], example.recipe)
    assert again.recipe == example.recipe
    assert_same(example.estimate, again.estimate)
    assert_same(example.validations, again.validations)


def test_a_time_offset_is_not_applied_twice() -> None:
    arm, motion = swing()
    log = Log(motion.t, motion.q, motion.tau, motion.joints, "swing")
    once = identify(arm, [log], (), Recipe(time_offset=0.004))
    twice = identify(arm, [log], (), once.recipe)
    assert once.recipe.smoother == twice.recipe.smoother == TimeShifted(Spline(), 0.004)
    assert (once.validations[0].motion.time_offset, twice.recipe.time_offset) == (0.004, 0.004)


@pytest.mark.parametrize("is_looped", [True, False])
def test_a_controller_sees_positions_when_they_were_stamped(is_looped: bool) -> None:
    """Other free runs start from the motion of the fit."""
    arm, motion = swing(401)
    ones = np.ones(2)
    drive = (
        PD(motion.joints, motion.t, motion.q, 10 * ones, ones, ones, ones * np.inf, 0 * motion.q) if is_looped else None
    )
    log = Log(motion.t, motion.q, motion.tau, motion.joints, "swing", controller=drive)
    result = identify(arm, [log], (), Recipe(time_offset=0.004, restart=None if is_looped else 0.5))
    (validation,) = result.validations
    start = smooth_log(Spline(), log) if is_looped else validation.motion
    expected = free_run(result.model, result.estimate.value, start, drive, restart=0.5)
    np.testing.assert_array_equal(validation.free_run.q, expected.q)


def test_a_recipe_with_several_smoothers_has_no_motion_yet(example: Identification) -> None:
    log = example.validations[0].recorded_log
    with pytest.raises(ConfigError, match="2 smoothers to choose from"):
        Recipe((Spline(), Spline(factor=2.0)), LeastSquares()).motion(log)


def test_signals_that_are_not_there_are_said_to_be_missing(example: Identification) -> None:
    bare = replace(example.validations[0], signals=None)
    for name in ("motion", "predicted_torque", "recorded_log"):
        with pytest.raises(InputError, match="moves: a saved result holds the errors"):
            getattr(bare, name)


def test_std_allows_for_correlated_residuals_everywhere_where_it_can(example: Identification, tmp_path: Path) -> None:
    errors, rows = example.errors, json.loads(example.save(tmp_path / "result.json").read_text())["parameters"]
    assert errors.allows_correlation
    assert not replace(errors, std=errors.std_independent, base_std=errors.base_std_independent).allows_correlation
    np.testing.assert_array_equal(errors.std_independent, example.estimate.std)
    for name in ("std", "std_independent"):
        np.testing.assert_array_equal(example.frame()[name], getattr(errors, name))
        np.testing.assert_array_equal([float(row[name]) for row in rows], getattr(errors, name))
