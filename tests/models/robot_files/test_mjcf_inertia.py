"""Inertias of bodies: as the file gives them, else as MuJoCo makes them from shapes."""

import numpy as np
import pytest

from dynident.models import RigidBodies, from_physical

BALL = from_physical(1000 * 4 / 3 * np.pi * 0.1**3, [-0.1, 0, 0], 4 * 4 / 3 * np.pi * 0.1**3 * np.eye(3))
GIVEN = '<inertial mass="2" pos="0.1 0.2 0.3" diaginertia="0.1 0.2 0.15" quat="0 1 0 0"/>'


def body(geoms: str, compiler: str = "") -> str:
    return (
        f'<mujoco><compiler angle="radian" {compiler}/><asset><mesh name="shell" file="none.stl"/></asset><worldbody>'
        f'<body name="arm" pos="0 0 1"><joint name="hinge" axis="0 1 0" pos="0.1 0 0"/>{geoms}</body>'
        "</worldbody></mujoco>"
    )


def theta(geoms: str, compiler: str = "") -> np.ndarray:
    values = [parameter.value for parameter in RigidBodies(body(geoms, compiler)).parameters]
    return np.array(values, dtype=float)


def physical(mass: float, moments: tuple[float, ...], centre: tuple[float, ...] = (0.0, 0.2, 0.3)) -> np.ndarray:
    """Parameters about the joint, which is at x = 0.1."""
    return from_physical(mass, centre, np.diag(moments))


@pytest.mark.parametrize(
    ("geoms", "compiler", "expected"),
    [
        (GIVEN, "", physical(2.0, (0.1, 0.2, 0.15))),
        (GIVEN.replace("0.15", "0.31"), "", physical(2.0, (0.1, 0.2, 0.31))),  # not physical
        (GIVEN.replace('mass="2"', 'mass="-2"'), "", physical(-2.0, (0.1, 0.2, 0.15))),
        (GIVEN + '<geom size="0.3"/>', "", physical(2.0, (0.1, 0.2, 0.15))),
        ('<geom size="0.1"/>', "", BALL),
        ('<geom size="0.1"/><geom size="0.2" group="5"/>', 'inertiagrouprange="0 3"', BALL),
        (GIVEN + '<geom size="0.1"/>', 'inertiafromgeom="true"', BALL),
        ('<geom size="0.1"/>', 'inertiafromgeom="false"', np.zeros(10)),
        ('<geom size="0.1"/><geom type="mesh" mesh="shell" mass="0"/>', "", BALL),
        ('<geom size="0.1"/><geom type="mesh" group="5" mesh="shell"/>', 'inertiagrouprange="0 3"', BALL),
        (GIVEN, 'settotalmass="7"', 3.5 * physical(2.0, (0.1, 0.2, 0.15))),
        (GIVEN, 'boundmass="3" boundinertia="0.15"', physical(3.0, (0.15, 0.2, 0.15))),
        (GIVEN.replace("0.15", "0.36"), 'balanceinertia="true"', physical(2.0, (0.22, 0.22, 0.22))),
        ("", "", np.zeros(10)),
    ],
)
def test_a_body_has_the_inertia_of_the_compiled_model(geoms: str, compiler: str, expected: np.ndarray) -> None:
    np.testing.assert_allclose(theta(geoms, compiler), expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("compiler", ["", 'settotalmass="3"'])
@pytest.mark.parametrize(
    "geoms", ['<geom type="mesh" mesh="shell"/>', '<geom size="0.1"/><geom type="box" mesh="shell"/>']
)
def test_what_missing_meshes_weigh_is_not_known(geoms: str, compiler: str) -> None:
    assert np.isnan(theta(geoms, compiler)).all()
