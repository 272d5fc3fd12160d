"""Short calls from Python: files for models, one log for several, and mistakes in words."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_type_hints

import numpy as np
import polars as pl
import pytest
import yaml

import dynident as dy
from dynident.apps.online import Watcher
from dynident.identification import NotLogged
from dynident.models.lagrangian import pendulum, slider
from dynident.project.shortcuts import RecipeFields
from dynident.runtime import ConfigError, DynidentError, InputError, ModelError
from tests.robots import ARM, joint, link, urdf

T = np.arange(1001) * 0.01
RAIL = {"slider": ("x", "mm")}
FORCE = {"slider": {"column": "f", "gain": 2.0, "unit": "N"}}


def sliding(name: str = "monday") -> dy.Log:
    q = 0.1 * np.sin(3 * T)[:, None]
    noise = 0.01 * np.random.default_rng(0).standard_normal((1001, 1))
    return dy.Log(T, q, 5.0 * -9.0 * q + 8.0 * 0.3 * np.cos(3 * T)[:, None] + noise, ("slider",), name)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    log = sliding()
    table = np.column_stack([1e3 * T, 1e3 * log.q[:, 0], log.tau[:, 0] / 2])
    np.savetxt(tmp_path / "monday.csv", table, delimiter=",", header="ms,x,f", comments="")
    return tmp_path / "monday.csv"


class TestReadLog:
    def test_a_window_a_name_a_rate_and_other_settings(self, file: Path) -> None:
        read = dy.read_log(
            file, time={"rate": 100}, position=RAIL, torque=FORCE, window=(2, 5), name="part", zero={"slider": 1.0}
        )
        assert (read.source, read.t[0], read.t[-1]) == ("part", 2.0, 5.0)
        np.testing.assert_allclose(read.q, sliding().window(2, 5).q + 1.0, atol=1e-9)

    def test_a_configuration_says_how_to_read(self, file: Path) -> None:
        settings = {
            "model": "gallery:slider", "time": {"column": "ms", "unit": "ms"},
            "position": {"slider": {"column": "x", "unit": "mm"}}, "torque": FORCE, "train": [{"file": "gone.csv"}],
        }  # fmt: skip
        config = file.parent / "robot.yaml"
        config.write_text(yaml.safe_dump(settings))
        declared = dy.read_log(file, time=("ms", "ms"), position=RAIL, torque=FORCE)
        np.testing.assert_array_equal(dy.read_log(file, config=config).tau, declared.tau)
        with pytest.raises(ConfigError, match="either `config`"):
            dy.read_log(file, config=config, position=RAIL)

    @pytest.mark.parametrize(
        ("changes", "error", "words"),
        [
            ({"time": "ms"}, ConfigError, r"time is 'ms'; give a column and its unit, such as \('ms', 'ms'\)"),
            ({"torque": None}, ConfigError, "'torque' is missing"),
            ({"position": {"slider": ("x", "furlong")}}, ConfigError, "'furlong' is not a unit of angle"),
            ({"position": {"slider": ("X", "mm")}}, InputError, "no column 'X'; choose from 'ms', 'x', 'f'"),
            ({"torque": {"slidr": ("f", "N")}}, ConfigError, "no joint 'slidr'; did you mean 'slider'"),
            ({"torque": {"slider": ("f", "N m")}}, ConfigError, "a unit of torque, not of force"),
            ({"transmision": {}}, ConfigError, "unknown key 'transmision'; did you mean 'transmission'"),
            ({"window": (5, 2)}, ConfigError, "must stop after it starts"),
        ],
    )
    def test_mistakes_are_named(self, file: Path, changes: dict, error: type, words: str) -> None:
        with pytest.raises(error, match=words):
            dy.read_log(file, **{"time": ("ms", "ms"), "position": RAIL, "torque": FORCE, **changes})

    def test_what_is_odd_in_the_file_is_a_warning(self, file: Path) -> None:
        with pytest.warns(UserWarning, match="extends beyond the recording"):
            dy.read_log(file, time=("ms", "ms"), position=RAIL, torque=FORCE, window=(2, 50))

    def test_pieces_between_gaps_are_to_be_chosen_from(self, file: Path) -> None:
        lines = file.read_text().splitlines()
        file.write_text("\n".join(lines[:400] + lines[600:]))
        with pytest.raises(InputError, match=r"2 pieces; choose one by `window`: 0 to 3\.98 s, 5\.99 to 10 s"):
            dy.read_log(file, time=("ms", "ms"), position=RAIL, torque=FORCE, gaps="split")


class TestReadRobot:
    def test_mistakes_are_named(self, tmp_path: Path) -> None:
        (tmp_path / "arm.urdf").write_text(ARM)
        with pytest.raises(ConfigError, match="read_robot: unknown key 'gravty'; did you mean 'gravity'"):
            dy.read_robot(tmp_path / "arm.urdf", gravty=(0, 0, 0))
        with pytest.raises(ModelError, match="did you mean 'shoulder'"):
            dy.read_robot(tmp_path / "arm.urdf", joints=["sholder"])
        with pytest.raises(ConfigError, match="stiction"):
            dy.read_robot(tmp_path / "arm.urdf", terms=["stiction"])
        with pytest.raises(ModelError, match=r"did you mean 'arm\.urdf'"):
            dy.read_robot(tmp_path / "amr.urdf")


class TestIdentify:
    def test_keywords_replace_fields_of_the_recipe(self) -> None:
        recipe = dy.Recipe(dy.Difference(), min_speed=0.1)
        result = dy.identify("gallery:slider", sliding(), recipe=recipe, smoother=dy.Difference("central"))
        assert (result.recipe.smoother, result.recipe.min_speed) == (dy.Difference("central"), 0.1)
        with pytest.raises(ConfigError, match="'estimtor' is no field of a recipe; did you mean 'estimator'"):
            dy.identify("gallery:slider", sliding(), estimtor=dy.LeastSquares())

    def test_the_keywords_are_the_fields(self) -> None:
        hints = get_type_hints(dy.Recipe)
        named = {name: hints[name] | str for name in ("smoother", "estimator")}
        assert get_type_hints(RecipeFields) == hints | named

    @pytest.mark.parametrize(
        ("robot", "logs", "error", "words"),
        [
            (pendulum(), None, InputError, "logs: a NoneType is given"),
            ("gallery:slidr", sliding(), ModelError, "did you mean 'slider'"),
            ("robot.yaml", sliding(), ModelError, r"run it with `dynident\.run\('robot\.yaml'\)`"),
            ("gone.urdf", sliding(), ModelError, "cannot be read"),
            (3, sliding(), ModelError, "a int is given"),
            ("gallery:slider", "monday.csv", InputError, "'monday.csv' is a file; read it with `read_log`"),
            (
                "gallery:slider",
                {"monday": "monday.csv"},
                InputError,
                "logs: 'monday' is a str, not a Log; read the file with",
            ),
            ("gallery:slider", [sliding(), sliding()], ConfigError, "two logs have the same source"),
            ("gallery:slider", (), ConfigError, "no training log"),
            ("gallery:pendulum", sliding(), InputError, "no joint 'pivot'; the log has slider"),
        ],
    )
    def test_mistakes_are_named(self, robot: object, logs: object, error: type, words: str) -> None:
        with pytest.raises(error, match=words):
            dy.identify(robot, logs, recipe=dy.Recipe(dy.Difference()))

    def test_a_recipe_is_one(self) -> None:
        with pytest.raises(ConfigError, match="a Difference is given; give a Recipe, or its fields as keywords"):
            dy.identify("gallery:slider", sliding(), recipe=dy.Difference())  # type: ignore[arg-type]

    def test_a_file_cannot_be_predicted_before_it_is_read(self) -> None:
        result = dy.identify("gallery:slider", sliding(), recipe=dy.Recipe(dy.Difference()))
        with pytest.raises(InputError, match="a str is given; give q, dq, ddq, or a Log, as of `read_log`"):
            result.predict("monday.csv")  # type: ignore[arg-type]

    def test_a_recording_of_a_simulation_is_asked_for_its_log(self) -> None:
        arm = dy.two_link_arm()
        motion = dy.simulate(arm, arm.values, lambda _: [0.1, 0.0], [0.0, 0.1, 0.2])
        with pytest.raises(InputError, match="is a Recording, not a Log; give its `log`"):
            dy.identify(arm, {"monday": dy.record(motion, 0.0, 0.0, np.random.default_rng(0))})


def test_a_check_finds_what_is_wrong_before_a_fit() -> None:
    silent = dy.Log(T, sliding().q, np.zeros((1001, 1)), ("slider",), "silent")
    result = dy.check("gallery:slider", silent)
    assert result.has_errors
    assert "torque is zero in every sample" in repr(result)
    fine = dy.check("gallery:slider", sliding())
    assert not fine.has_errors
    assert repr(fine).startswith("<CheckResult: ")
    assert "<td" in fine._repr_html_()


SWING = dy.Log(np.arange(100) * 0.01, np.zeros((100, 1)), np.zeros((100, 1)), ("pivot",), "swing")
LIVELY = replace(SWING, q=np.sin(5 * SWING.t)[:, None], tau=np.cos(4 * SWING.t)[:, None])
WRONG: dict[str, Callable[[], object]] = {
    "validation: a int is given": lambda: dy.identify(pendulum(), SWING, 3),
    "recipe: a str is given": lambda: dy.identify(pendulum(), SWING, recipe="spline"),
    "recipe: smoother is None": lambda: dy.Recipe(None),
    "recipe: smoother is <class": lambda: dy.Recipe(dy.Spline),
    "recipe: estimator is 3": lambda: dy.Recipe(estimator=3),
    "recipe: filter is 20": lambda: dy.Recipe(filter=20),
    "recipe: min_speed is {'pivot': -1}": lambda: dy.Recipe(min_speed={"pivot": -1}),
    "recipe: time_offset is nan": lambda: dy.Recipe(time_offset=np.nan),
    "recipe: base_tilt is 0.1": lambda: dy.Recipe(base_tilt=0.1),
    "recipe: restart is 0": lambda: dy.Recipe(restart=0),
    "numbers are expected": lambda: replace(SWING, q="q"),
    "joints is 'pivot'": lambda: replace(SWING, joints="pivot"),
    "a int is no term": lambda: dy.Model((3,)),
    "a str is no term": lambda: dy.Model("ab"),
    "export_model: a dict is given": lambda: dy.export_model({}, "out"),
    "path: a int is given; give the path of a file": lambda: dy.run(3),
    "path: a Model is given": lambda: dy.excite(pendulum()),
    "path: a DataFrame is given": lambda: dy.read_log(pl.DataFrame({"t": [0.0]})),
    "find_payload: a str is given": lambda: dy.find_payload("result.json", SWING),
    "Watcher: a str is given": lambda: Watcher("result.json", np.random.default_rng(0)),
    "sigma = .*give one value, or a mapping": lambda: dy.Recipe(dy.Spline(sigma=[1e-3])),
    # none of these may pass for numbers in SI units
    r"q\[7, 0\] is nan": lambda: replace(SWING, q=np.ma.masked_array(SWING.q, SWING.t[:, None] == 0.07)),
    r"not datetime64\[ms\]; give s": lambda: replace(SWING, t=np.datetime64("2026-11-29") + SWING.t.astype("m8[ms]")),
    "not complex128; give its real part": lambda: dy.smooth(SWING.t, LIVELY.q + 1j),
    "sigma_q of pivot is 'x'": lambda: dy.accuracy_bound(pendulum(), LIVELY, dy.Recipe(), sigma_q="x"),
    "torque is 'sensors'": lambda: dy.accuracy_bound(pendulum(), LIVELY, dy.Recipe(), torque="sensors"),
}


@pytest.mark.parametrize("words", WRONG)
def test_an_argument_of_another_type_is_named(words: str) -> None:
    with pytest.raises(DynidentError, match=words):
        WRONG[words]()


def two_link_file(folder: Path, gripper: str = "") -> Path:
    """Return an arm of two links in a vertical plane, with a finger that slides where one is named."""
    tensor = np.diag([0.003, 0.02, 0.02])
    limits = '<limit effort="1" velocity="1" lower="0.01" upper="0.05"/>'
    hand = (
        (link("hand", 0.1, (0.02, 0, 0)), joint(gripper, "prismatic", "fore", "hand", inside=limits)) if gripper else ()
    )
    file = folder / "arm.urdf"
    file.write_text(
        urdf(
            link("base"), link("upper", 2.0, (0.15, 0, 0), tensor=tensor),
            link("fore", 1.0, (0.1, 0, 0), tensor=tensor),
            joint("shoulder", "revolute", "base", "upper", axis=(0, 1, 0)),
            joint("elbow", "revolute", "upper", "fore", (0.3, 0, 0), axis=(0, 1, 0)), *hand,
        )
    )  # fmt: skip
    return file


def two_link_log(rate: float = 1.0, name: str = "monday") -> dy.Log:
    """Return a recording of that arm with friction of which its file says nothing."""
    with TemporaryDirectory() as folder:
        robot = dy.read_robot(two_link_file(Path(folder)))
    t, rng, w = np.arange(2001) * 0.004, np.random.default_rng(0), rate * np.array([0.9, 1.5])
    phase = np.multiply.outer(t, w)
    motion = np.sin(phase), w * np.cos(phase), -(w**2) * np.sin(phase)
    tau = robot.torque(*motion, [0.5 if parameter.value is None else parameter.value for parameter in robot.parameters])
    return dy.Log(t, motion[0], tau + 0.02 * rng.standard_normal(tau.shape), ("shoulder", "elbow"), name)


class TestChosenTerms:
    @pytest.mark.parametrize(("terms", "recipe"), [("auto", None), (["auto", "viscous"], dy.Recipe(time_offset=0.0))])
    def test_a_model_knows_that_its_terms_are_to_be_chosen(
        self, tmp_path: Path, terms: str | list[str], recipe: dy.Recipe | None
    ) -> None:
        robot, log = dy.read_robot(two_link_file(tmp_path), terms=terms), two_link_log().window(0.0, 5.0)
        assert robot.chooses_terms
        assert "to be chosen" in repr(robot)
        result = dy.identify(robot, log, {"tuesday": two_link_log(1.2)}, recipe)
        assert {"Fc_shoulder", "Fv_elbow"} <= set(result.model.names)
        assert not result.model.chooses_terms
        assert all(validation.errors.relative_error < 2 for validation in result.validations)
        result.save(tmp_path / "result.json")
        again = dy.load(tmp_path / "result.json", robot)
        assert again.model.names == result.model.names
        assert not again.model.chooses_terms


QUICK: dict = {"smoother": dy.Difference("central"), "estimator": dy.LeastSquares(), "time_offset": 0.0, "terms": None}


class TestJointsThatAreNotLogged:
    def test_they_are_locked_with_a_note_that_stays(self, tmp_path: Path) -> None:
        file, log = two_link_file(tmp_path, "grip"), two_link_log()
        result = dy.identify(file, log, **QUICK)
        assert result.warnings[0] == NotLogged(("grip",), (0.01,))
        result.save(tmp_path / "result.json")
        again = dy.load(tmp_path / "result.json")
        assert again.model.names == result.model.names
        assert again.predict(log).errors.relative_error == result.validations[0].errors.relative_error
        assert "'grip' at 0.01" in str(dy.check(file, log).findings[0])
        bound = dy.accuracy_bound(file, log, dy.Recipe(**QUICK), sigma_q=1e-4, sigma_tau=0.02)
        assert "'grip' at 0.01" in str(bound.identification.warnings[0])

    def test_a_position_that_is_given_is_used_and_kept(self, tmp_path: Path) -> None:
        file, log = two_link_file(tmp_path, "grip"), two_link_log()
        result = dy.identify(file, log, lock={"grip": 0.03}, joints=["elbow", "shoulder"], **QUICK)
        assert not any(isinstance(note, NotLogged) for note in result.warnings)
        result.save(tmp_path / "result.json")
        (bodies,) = dy.load(tmp_path / "result.json").model.terms
        assert (bodies.locked, bodies.joints_used) == ((("grip", 0.03),), ("elbow", "shoulder"))

    @pytest.mark.parametrize(
        ("robot", "options", "words"),
        [
            ("file", {"joints": ["grip", "elbow"]}, "monday: no joint 'grip'; .* or lock it"),
            ("file", {"lock": {"gripp": 0.0}}, "did you mean 'grip'"),
            ("model", {}, "monday: no joint 'grip'; .* or lock it"),
            ("model", {"lock": {"grip": 0.0}}, "`read_robot`"),
        ],
    )
    def test_others_are_named_with_the_remedy(self, tmp_path: Path, robot: str, options: dict, words: str) -> None:
        file = two_link_file(tmp_path, "grip")
        with pytest.raises(DynidentError, match=words):
            dy.identify(file if robot == "file" else dy.read_robot(file), two_link_log(), **options)


@pytest.mark.parametrize(
    ("speed", "words"),
    [
        (1e9, "min_speed: is 1e\\+09 for 'shoulder', whose speed reaches"),
        ({"elbow": 1e9}, "min_speed: is 1e\\+09 for 'elbow', whose speed reaches"),
        (0.89998, "lower `min_speed` .*shoulder at 0.89998, which reaches 0.9"),
    ],
)
def test_a_minimum_speed_that_leaves_too_little_is_named(tmp_path: Path, speed: float | dict, words: str) -> None:
    robot = dy.read_robot(two_link_file(tmp_path), joints=["shoulder"]) if speed == 0.89998 else two_link_file(tmp_path)
    log = two_link_log()
    log = log.select(("shoulder",)).window(0.0, 5.0) if speed == 0.89998 else log
    with pytest.raises(DynidentError, match=words):
        dy.identify(robot, log, min_speed=speed, smoother=dy.Difference("central"), time_offset=0.0)


def test_a_result_is_asked_by_names_and_arrays(tmp_path: Path) -> None:
    identification = dy.identify("gallery:slider", sliding(), validation={"b": sliding()}, estimator="least_squares")
    assert identification.recipe.estimator == dy.LeastSquares()
    friction = identification.parameters["Fc"]
    row = identification.frame().row(by_predicate=pl.col("parameter") == "Fc", named=True)
    assert (friction.value, friction.std, friction.unit) == (row["value"], row["std"], row["unit"])
    with pytest.raises(InputError, match="there is no parameter 'Fd'"):
        identification.parameters["Fd"]
    again = dy.load(identification.save(tmp_path / "result.json"), slider())
    assert again.parameters == identification.parameters
    assert again.verdict == identification.verdict
    assert repr(again) == repr(identification)
    motion = identification.validations[0].motion
    tau = again.predict(motion.q, motion.dq, motion.ddq)
    np.testing.assert_array_equal(tau, identification.validations[0].predicted_torque)
    with pytest.raises(ConfigError, match=r"estimator.*'least_square'"):
        dy.identify("gallery:slider", sliding(), estimator="least_square")
