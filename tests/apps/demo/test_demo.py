"""The demo: recordings as sensors make them, whole files, and fits against the truth."""

import runpy
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import polars as pl
import pytest

import dynident as dy
from dynident.apps.demo import compare_with_truth, demo_files, demo_truth
from dynident.apps.demo.arm import BASE, JOINTS, LINKS, urdf
from dynident.apps.demo.files import SEED
from dynident.identification import Calibration, Identification, TimeOffset
from dynident.models import Model, consistency_violations
from dynident.runtime import InputError

MADE = runpy.run_path(str(Path(__file__).parents[3] / "benchmarks" / "demo_files.py"))  # the files made anew
DAYS = MADE["DAYS"]


@pytest.mark.parametrize("link", LINKS, ids=lambda link: link.name)
def test_truth_is_physical_and_5_to_15_percent_off(link) -> None:
    true, drawn = link.true_parameters, link.shape.inertia(link.mass)
    assert not list(consistency_violations(true))
    assert 0.05 <= abs(true[0] / drawn[0] - 1) <= 0.15
    assert np.linalg.norm(true[1:4] / true[0] - drawn[1:4] / drawn[0]) > 0.003


SOME = 0.4  # s of a recording that a test makes anew


@pytest.fixture(scope="module")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pl.DataFrame]:
    folder = demo_files(tmp_path_factory.mktemp("arm"))
    return {day.name: pl.read_parquet(folder / f"{day.name}.parquet") for day in DAYS}


@pytest.mark.parametrize("k", range(len(DAYS)), ids=[day.name for day in DAYS])
def test_the_shipped_recordings_are_those_of_the_seed(shipped: dict[str, pl.DataFrame], k: int) -> None:
    made = MADE["simulate_log"](np.random.default_rng([SEED, k]), DAYS[k], SOME)
    there = shipped[DAYS[k].name]
    assert made.schema == there.schema
    assert len(there) == round(DAYS[k].duration / 0.004)
    for name in made.columns:
        step = MADE["ENCODER_STEP"] if "position" in name else MADE["TORQUE_STEP"] if "torque" in name else 1e-6
        np.testing.assert_allclose(made[name], there[name][: len(made)], rtol=0, atol=2.01 * step, err_msg=name)


@pytest.mark.parametrize("day", DAYS, ids=lambda day: day.name)
def test_the_arm_keeps_to_its_limits_and_to_its_reference(shipped: dict[str, pl.DataFrame], day) -> None:
    log = shipped[day.name]
    for joint in JOINTS:
        q, tau, reference = (
            log[f"{joint.name}.{what}"].to_numpy() for what in ("position_rad", "torque_Nm", "reference_rad")
        )
        assert np.abs(q).max() < joint.reach
        assert np.abs(np.diff(q) / 0.004).max() < joint.velocity
        assert np.abs(tau).max() < joint.effort
        assert 1e-3 < np.abs(q - reference).max() < 0.15


def log_of(table: pl.DataFrame) -> dy.Log:
    names = tuple(joint.name for joint in JOINTS)
    q, tau = (table.select(f"{name}.{what}" for name in names).to_numpy() for what in ("position_rad", "torque_Nm"))
    return dy.Log(table["time_s"].to_numpy(), q, tau, names, "monday")


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_files_are_those_of_the_description_and_small(tmp_path: Path) -> None:
    there = contents(demo_files(tmp_path / "an arm"))
    assert there["arm.urdf"].decode() == urdf() == MADE["urdf"]()
    assert there["controller.yaml"].decode() == MADE["controller"]()
    for link in (BASE, *LINKS):
        assert there[f"meshes/{link.name}.stl"][80:] == MADE["stl"](link.shape)[80:]
    assert {"monday.parquet", "tuesday.parquet"} < set(there)
    assert len(there) == 4 + 1 + len(LINKS)
    assert sum(map(len, there.values())) < 500_000


def test_a_second_time_changes_nothing_and_adds_what_is_missing(tmp_path: Path) -> None:
    first = contents(demo_files(tmp_path))
    (tmp_path / "meshes" / "hand.stl").unlink()
    (tmp_path / "mine.txt").write_text("kept")
    assert contents(demo_files(tmp_path)) == first | {"mine.txt": b"kept"}


@pytest.mark.parametrize(
    ("name", "words"), [("tuesday.parquet", "exists already"), ("meshes", "nothing can be written here")]
)
def test_files_of_the_user_stay_and_nothing_is_written_beside(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / name).write_bytes(b"my own")
    with pytest.raises(InputError, match=f"{name}: {words}"):
        demo_files(tmp_path)
    assert contents(tmp_path) == {name: b"my own"}


def test_a_link_that_leads_nowhere_is_left(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").symlink_to(tmp_path / "elsewhere" / "mine.urdf")
    with pytest.raises(InputError, match=r"arm\.urdf: exists already"):
        demo_files(tmp_path)
    assert (tmp_path / "arm.urdf").is_symlink()


def test_what_cannot_be_read_is_another_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    demo_files(tmp_path)
    for error in (PermissionError(13, "Permission denied"), OSError(5, "Input/output error")):
        monkeypatch.setattr(Path, "is_file", Mock(side_effect=error))
        with pytest.raises(InputError, match="exists already"):
            demo_files(tmp_path)


@pytest.fixture(scope="module")
def identification(shipped: dict[str, pl.DataFrame]) -> Identification:
    """Least squares, with the true time offset and tilt, for speed."""
    bodies = dy.RigidBodies(urdf(), source="arm.urdf")
    terms = (bodies, *(term(bodies.joints) for term in (dy.RotorInertia, dy.Viscous, dy.Coulomb, dy.Offset)))
    truth = demo_truth()
    recipe = dy.Recipe(dy.Spline(), dy.LeastSquares(), time_offset=truth.time_offset, base_tilt=truth.tilt)
    return dy.identify(Model(terms), {"monday": log_of(shipped["monday"].head(3000))}, recipe=recipe)


def test_a_fit_is_near_the_truth_and_the_file_is_not(identification: Identification) -> None:
    compared = compare_with_truth(identification)
    assert compared.torque_error < 0.6
    assert compared.file_error > 5
    assert compared.base == 60
    assert 50 <= compared.within <= 60
    for value in compared.values:
        assert value.estimate == pytest.approx(value.true, rel=0.08), value.name


def test_values_have_their_names_and_units(identification: Identification) -> None:
    offset = TimeOffset(-0.002, 3.0, 2.0, 0.0005)
    values = {
        value.name: value
        for value in compare_with_truth(replace(identification, calibration=Calibration(None, offset))).values
    }
    lag = values["torque stamped later by"]
    assert (lag.estimate, lag.true) == pytest.approx((2.0, 3.0))
    assert lag.std == pytest.approx(0.5)
    assert values["Fv_elbow"].unit == "N m s/rad"
    assert values["Fc_wrist_roll"].true == 0.25
    assert values["gravity, arm stretched out"].unit == "N m"
    assert len(values) == 1 + 1 + 2 * len(JOINTS)
