"""Results that last: what is saved is read again to the last bit, and older files say what they lack."""

import json
import random
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynident.estimators import LeastSquares, PhysicallyConsistent
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.estimators.notes import NotIdentifiable
from dynident.identification import Calibration, Gain, Identification, Recipe, Rests, TimeOffset, identify
from dynident.models import Model
from dynident.models.friction import Viscous
from dynident.models.lagrangian import slider, two_link_arm
from dynident.models.simulation import RunsAway, record, simulate
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Spline, TimeShifted
from dynident.project.project import run
from dynident.project.result_format import result_schema
from dynident.project.saved import load, read_log_like, save
from dynident.regression import ParallelFilter, Whitening
from dynident.runtime import ConfigError, DynidentError, InputError, ModelError
from tests.cli.commands import configure, write_log
from tests.identification.test_base_tilt import tilted
from tests.project.same import assert_same
from tests.project.schemas import wrong

DATA = Path(__file__).parents[1] / "data"
Made = tuple[Model, Identification]


@cache
def moved(rate: float, seconds: float) -> Motion:
    """The two-link arm, driven by sines, without base parameters that are tied."""
    arm, t = two_link_arm(), np.linspace(0, seconds, round(200 * seconds) + 1)
    return simulate(arm, arm.values, lambda s: (1.13 * np.sin(rate * s), 0.78 * np.cos(4 * s)), t, tolerance=1e-9)


def swing(model: Model, noise: float, seed: int, rate: float = 3.0, seconds: float = 4.0) -> Log:
    return record(moved(rate, seconds), noise, 0.01, np.random.default_rng(seed), source=f"swing {seed}").log


@cache
def by_least_squares() -> Made:
    """All settings of a recipe that are numbers, two parameters that are tied, and a smoother chosen among two."""
    arm = two_link_arm()
    model = replace(arm, terms=(*arm.terms, Viscous(arm.joints, names=("again1", "again2"))))
    sigma = {"joint1": 1e-3, "joint2": 1.1e-3}
    recipe = Recipe(
        (Spline(sigma=sigma), Spline(sigma=sigma, factor=1 / 3)),
        LeastSquares(weights="per_joint"),
        ParallelFilter(2, 20.0),
        {"joint2": 0.1},
        0.1 / 30,
        restart=0.25,
    )
    return model, identify(model, [swing(model, 1e-3, 0)], [swing(model, 1e-3, 1, 2.0)], recipe)


@cache
def by_consistent_fit() -> Made:
    """A robot whose base is tilted, with parameters that nothing determines and what the constraints cost."""
    model, motion = tilted(0.02, -0.035)
    log = Log(motion.t, motion.q, motion.tau, motion.joints, "moves")
    return model, identify(model, [log], (), Recipe(Spline(), PhysicallyConsistent(), base_tilt="estimate"))


@cache
def by_maximum_likelihood() -> Made:
    """Fisher's information, intervals that are not symmetric, and a time offset that is sought."""
    arm = two_link_arm()
    recipe = Recipe(Spline(), MaximumLikelihood(), time_offset="estimate")
    return arm, identify(arm, [swing(arm, 3e-2, 2)], (), recipe)


@pytest.fixture(scope="module", params=[by_least_squares, by_consistent_fit, by_maximum_likelihood])
def made(request: pytest.FixtureRequest) -> Made:
    result: Made = request.param()
    return result


def known(*values: object) -> bool:
    return all(value is not None for value in values)


def test_the_three_results_hold_every_group() -> None:
    """So that the law below is one of all that can be saved."""
    (_, plain), (_, consistent), (_, likely) = by_least_squares(), by_consistent_fit(), by_maximum_likelihood()
    assert isinstance(plain.recipe.smoother, TimeShifted)
    assert plain.recipe.time_offset == 0.1 / 30
    errors, base, residual = plain.errors, plain.base, plain.estimate.residual
    assert known(base.on_data, base.structural, plain.calibration.smoother, plain.recipe.filter, plain.mass)
    assert known(errors.base_std, errors.base_std_independent, residual.weights)
    assert len(plain.runs) == 2
    assert np.isinf(plain.estimate.covariance).any()
    assert isinstance(consistent.recipe.base_tilt, tuple)
    assert known(consistent.calibration.base_tilt, consistent.estimate.consistency)
    assert consistent.estimate.provenance
    assert consistent.estimate.notes
    assert known(likely.estimate.information, likely.estimate.interval, likely.calibration.time_offset)


def test_what_is_saved_is_read_again_to_the_last_bit(made: Made, tmp_path: Path) -> None:
    model, result = made
    path = result.save(tmp_path / "deep" / "result.json")
    again = load(path, model)
    assert_same(result, again)
    assert wrong(result_schema(), json.loads(path.read_text())) == []
    assert again.save(tmp_path / "again.json").read_text() == path.read_text()


def test_the_noise_of_whitened_rows_is_kept(tmp_path: Path) -> None:
    model, result = by_least_squares()
    noise = Whitening((np.array([0.9, -0.3]), np.zeros(0)), np.array([[2.0, 0.5], [0.5, 1.0]]))
    estimate = replace(result.estimate, residual=replace(result.estimate.residual, whitening=noise))
    path = replace(result, estimate=estimate).save(tmp_path / "result.json")
    again = load(path, model).estimate
    assert again.needs_samples
    assert_same(again.residual.whitening, noise)
    spoilt = path.read_text().replace("-0.3", "-1.3")
    path.write_text(spoilt)
    with pytest.raises(ConfigError, match=r"result.json: estimate: .* noise of joint 1: .* is not stable"):
        load(path, model)


def test_numbers_that_are_not_finite_and_rare_nouns_are_kept(tmp_path: Path) -> None:
    model, result = by_least_squares()
    first, *rest = result.validations
    errors = replace(first.errors, relative_error=np.nan, rmse={"joint1": np.inf, "joint2": -np.inf})
    run = replace(first.free_run, failure=RunsAway(np.nextafter(0.1, 1)))
    odd = replace(
        result,
        validations=(replace(first, errors=errors, free_run=run), *rest),
        warnings=(NotIdentifiable(3), Rests("a", 1.0, 0.0, 2.0, Gain(3.0, 1.0)), *result.warnings),
        calibration=Calibration(time_offset=TimeOffset(0.0, 2.0, 2.0, None, Gain(-1.0, 2.0))),
        mass=None,
    )
    text = save(odd, tmp_path / "r.json", {"verdict": "of no use"}).read_text()
    assert '"NaN"' in text
    assert '"-Infinity"' in text
    assert json.loads(text)["report"] == {"verdict": "of no use"}
    again = load(tmp_path / "r.json", model)
    assert_same(odd, again)
    assert str(again.warnings) == str(odd.warnings)
    assert str(odd.warnings).startswith(
        "Warning: 3 parameters are determined by neither data nor prior\nNote: a: 1 s at its start, where the arm is at"
    )


def test_a_model_from_python_must_be_given_again(tmp_path: Path) -> None:
    model, result = by_least_squares()
    path = result.save(tmp_path / "result.json")
    with pytest.raises(InputError, match=r"made from Python.*load\(path, model\)"):
        load(path)
    with pytest.raises(ModelError, match="not those of the model"):
        load(path, slider())
    with pytest.raises(InputError, match="predict a Log from Python"):
        read_log_like(load(path, model), "log.csv")


def test_a_result_of_version_1_is_read() -> None:
    result = load(DATA / "result-1.json")
    assert result.warnings == ()
    assert result.recipe.smoother == TimeShifted(Spline(factor=4.0), 0.001)
    assert [log.role for log in result.validations] == ["train", "validation"]
    assert result.calibration.smoother.smoother == result.recipe.smoother
    assert np.all(np.isfinite(result.estimate.covariance))


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (("version",), 2, "has version 2"),
        (("format",), "other", "is no result"),
        (("parameters", 0, "value"), "much", r"parameters\[0\]\.value: should be a valid number, .*; got 'much'"),
        (("parameters", 0, "value"), "NaN", "a parameter has no value"),
        (("parameters", 0, "provenance"), "guess", r"parameters\[0\]\.provenance"),
        (("estimate", "covariance"), [[1.0]], r"estimate\.covariance: has not the shape \(4, 4\)"),
        (("estimate", "notes"), [{"kind": "Nonsense"}], r"estimate\.notes\[0\]: 'Nonsense' is no kind of Note"),
        (("estimate", "notes"), [{"kind": "RankDeficient"}], r"estimate\.notes\[0\]\.rank: is missing"),
        (("recipe", "estimator", "kind"), "least_square", "did you mean 'least_squares'"),
        (("calibration", "smoother", "candidates"), [{}], "r.json: calibration: smoother: needs a `kind`"),
        (("estimate", "value"), [0.0], r"estimate\.value: is not read from a file"),
        (("mass_matrix", "q"), [[0.0]], r"mass_matrix\.q\[0\]: should be a valid number"),
        (("validations",), None, "validations: a list is expected; got None"),
        (("recipe", "base_tilt"), [0.1, 0.0], "no term has a gravity"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(
    tmp_path: Path, place: tuple[str | int, ...], value: object, words: str
) -> None:
    data: Any = json.loads((DATA / "result-1.json").read_text())
    part = data
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] = value
    (tmp_path / "r.json").write_text(json.dumps(data))
    with pytest.raises((InputError, ConfigError), match=words):
        load(tmp_path / "r.json")


VALUES = (None, True, -1, 10**30, 1.5, "x", "NaN", "auto", [], {}, [[]], [1, [2]], [None], {"a": 1}, {"kind": []})


@pytest.fixture(scope="module")
def saved(made: Made, tmp_path_factory: pytest.TempPathFactory) -> str:
    return made[1].save(tmp_path_factory.mktemp("saved") / "r.json").read_text()


@pytest.mark.parametrize("seed", range(20))
def test_a_result_with_any_value_anywhere_is_read_or_refused(made: Made, saved: str, tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    node = data = json.loads(saved)
    while True:
        key = rng.choice(list(node) if isinstance(node, dict) else range(len(node)))
        if not (isinstance(node[key], dict | list) and node[key]) or rng.random() < 0.25:
            break
        node = node[key]
    node[key] = rng.choice(VALUES)
    (tmp_path / "r.json").write_text(json.dumps(data))
    try:
        load(tmp_path / "r.json", made[0])
    except DynidentError as error:
        assert "r.json" in str(error)  # noqa: PT017


MARK = "from pathlib import Path\nPath(__file__).with_name('ran').touch()\n"
CODE = {
    "model": ("from dynident.models.lagrangian import slider as A", {"model": "mine.py:A"}),
    "smoother": ("from dynident.motion.smoothers import Spline as A", {"smoother": {"kind": "mine.py:A"}}),
    "estimator": ("from dynident.estimators import LeastSquares as A", {"estimator": {"kind": "mine.py:A"}}),
}


PLACES = [("configuration", part) for part in CODE] + [
    ("recipe", "smoother"),
    ("recipe", "estimator"),
    ("file", "model"),
]


@pytest.fixture(scope="module")
def configured(tmp_path_factory: pytest.TempPathFactory) -> Identification:
    """A slider, by a configuration."""
    folder = tmp_path_factory.mktemp("slider")
    write_log(folder)
    return run(configure(folder))


@pytest.mark.parametrize(("where", "part"), PLACES)
def test_a_result_runs_no_python_file_unless_it_is_allowed(
    configured: Identification, tmp_path: Path, where: str, part: str
) -> None:
    """Whatever place in it names the file: its configuration, the recipe as used, or the file of the model."""
    path = configured.save(tmp_path / "result.json")
    source, changes = CODE[part]
    (tmp_path / "mine.py").write_text(MARK + source)
    data = json.loads(path.read_text())
    origins = data["provenance"]
    if where == "configuration":
        config = configure(tmp_path, **changes)
        origins["configuration"] |= {"path": str(config), "text": config.read_text()}
    elif where == "recipe":
        data["recipe"][part] = {"kind": str(tmp_path / "mine.py") + ":A"}
    else:  # a text that stands for a file which is gone
        origins |= {"configuration": None, "model": {"path": f"{tmp_path}/mine.py:A", "sha256": "", "text": "-"}}
    path.write_text(json.dumps(data))
    with pytest.raises((ConfigError, ModelError), match=r"mine\.py:A' is of a Python file.*allow_code=True"):
        load(path)
    assert not (tmp_path / "ran").exists()
    load(path, allow_code=True)
    assert (tmp_path / "ran").exists()


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000, "1e999", "null"])
def test_json_of_any_other_form_is_no_result(tmp_path: Path, text: str) -> None:
    (tmp_path / "deep.json").write_text(text)
    with pytest.raises(InputError, match=r"is not a result\.json"):
        load(tmp_path / "deep.json")


def test_arguments_of_another_type_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="path: a NoneType is given"):
        load(None)  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="the model is a str"):
        load(tmp_path / "r.json", "gallery:slider")  # type: ignore[arg-type]
