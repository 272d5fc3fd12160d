"""How far a fit of the demo arm is from the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

import dynident as dy
from dynident.apps.demo import compare_with_truth, demo_files, demo_truth
from dynident.apps.demo.arm import JOINTS, urdf
from dynident.identification import Calibration, Identification, TimeOffset
from dynident.models import Model


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Identification:
    """Least squares, with the true time offset and tilt, for speed."""
    table = pl.read_parquet(demo_files(tmp_path_factory.mktemp("arm")) / "monday.parquet")
    names = tuple(joint.name for joint in JOINTS)
    q, tau = (table.select(f"{name}.{what}" for name in names).to_numpy() for what in ("position_rad", "torque_Nm"))
    bodies = dy.RigidBodies(urdf(), source="arm.urdf")
    terms = (bodies, *(term(bodies.joints) for term in (dy.RotorInertia, dy.Viscous, dy.Coulomb, dy.Offset)))
    truth = demo_truth()
    recipe = dy.Recipe(dy.Spline(), dy.LeastSquares(), time_offset=truth.time_offset, base_tilt=truth.tilt)
    return dy.identify(Model(terms), {"monday": dy.Log(table["time_s"], q, tau, names)}, recipe=recipe)


def test_a_fit_is_near_the_truth_and_the_file_is_not(found: Identification) -> None:
    compared = compare_with_truth(found)
    assert compared.torque_error < 0.6
    assert compared.file_error > 5
    assert compared.base == 60
    assert 50 <= compared.within <= 60
    for one in compared.values:
        assert one.estimate == pytest.approx(one.true, rel=0.08), one.name


def test_values_have_their_names_and_units(found: Identification) -> None:
    offset = TimeOffset(-0.002, 3.0, 2.0, 0.0005)
    values = {one.name: one for one in compare_with_truth(replace(found, calibration=Calibration(None, offset))).values}
    assert (values["time offset"].estimate, values["time offset"].true) == pytest.approx((-2.0, -3.0))
    assert values["time offset"].std == pytest.approx(0.5)
    assert values["Fv_elbow"].unit == "N m s/rad"
    assert values["Fc_wrist_roll"].true == 0.25
    assert values["gravity, arm stretched out"].unit == "N m"
    assert len(values) == 1 + 1 + 2 * len(JOINTS)


def test_the_truth_itself_is_no_error_away(found: Identification) -> None:
    exact = replace(found, estimate=replace(found.estimate, value=demo_truth().value))
    compared = compare_with_truth(exact)
    assert compared.torque_error == pytest.approx(0.0, abs=1e-9)
    assert compared.within == compared.base == 60
    assert all(one.estimate == one.true for one in compared.values)
    assert not np.isclose(compared.file_error, 0.0)
