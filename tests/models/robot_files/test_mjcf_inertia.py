"""Inertia of shapes: what bodies it belongs to, and the numbers of MuJoCo where that is installed."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.models import RigidBodies, from_physical, to_physical
from dynident.models.robot_files.mjcf_inertia import SHELLS, SOLIDS
from dynident.runtime import ModelError

SIZES = {"sphere": (0.3,), "capsule": (0.2, 0.4), "cylinder": (0.2, 0.3), "ellipsoid": (0.1, 0.2, 0.3),
         "box": (0.1, 0.2, 0.3)}  # fmt: skip
BOUNDS = {"sphere": (0.3,) * 3, "capsule": (0.2, 0.2, 0.6), "cylinder": (0.2, 0.2, 0.3), "ellipsoid": (0.1, 0.2, 0.3),
          "box": (0.1, 0.2, 0.3)}  # fmt: skip
INSIDE = {
    "sphere": lambda p, r: (p**2).sum(1) < r**2,
    "capsule": lambda p, r, h: p[:, 0] ** 2 + p[:, 1] ** 2 + np.maximum(np.abs(p[:, 2]) - h, 0) ** 2 < r**2,
    "cylinder": lambda p, r, h: (p[:, 0] ** 2 + p[:, 1] ** 2 < r**2) & (np.abs(p[:, 2]) < h),
    "ellipsoid": lambda p, *abc: ((p / abc) ** 2).sum(1) < 1,
    "box": lambda p, *abc: (np.abs(p) < abc).all(1),
}


def body(geoms: str, compiler: str = "") -> str:
    return (
        f'<mujoco><compiler angle="radian" {compiler}/><asset><mesh name="shell" file="none.stl"/></asset><worldbody>'
        f'<body name="arm" pos="0 0 1"><joint name="hinge" axis="0 1 0" pos="0.1 0 0"/>{geoms}</body>'
        "</worldbody></mujoco>"
    )


def theta(geoms: str, compiler: str = "") -> np.ndarray:
    values = [one.value for one in RigidBodies(body(geoms, compiler)).parameters]
    return np.array(values, dtype=float)


@pytest.mark.parametrize("kind", SOLIDS)
def test_a_solid_has_the_moments_of_its_points(kind: str) -> None:
    grid, bounds = (np.arange(60) + 0.5) / 30 - 1, np.array(BOUNDS[kind])
    points = np.stack(np.meshgrid(grid, grid, grid), axis=-1).reshape(-1, 3) * bounds
    held = points[INSIDE[kind](points, *SIZES[kind])]
    volume, gyration = SOLIDS[kind](*SIZES[kind])
    assert len(held) * bounds.prod() / 30**3 == pytest.approx(volume, rel=0.01)
    x, y, z = (held**2).mean(axis=0)
    np.testing.assert_allclose(gyration, (y + z, x + z, x + y), rtol=0.01)


@pytest.mark.parametrize("kind", [kind for kind in SHELLS if kind != "ellipsoid"])
def test_a_thin_wall_is_the_difference_of_two_solids(kind: str) -> None:
    sizes, thin = np.array(SIZES[kind]), 1e-6
    grown = sizes + (np.array([thin, 0.0]) if kind == "capsule" else thin)
    (inner, small), (outer, large) = SOLIDS[kind](*sizes), SOLIDS[kind](*grown)
    area, gyration = SHELLS[kind](*sizes)
    assert (outer - inner) / thin == pytest.approx(area, rel=1e-4)
    np.testing.assert_allclose(gyration, (outer * np.array(large) - inner * np.array(small)) / (area * thin), rtol=1e-4)


CASES = {
    **{f"{kind} by density": f'<geom type="{kind}" size="{" ".join(map(str, size))}" pos="0.1 0.2 -0.3" '
       f'euler="0.3 0.2 0.1" density="700"/>' for kind, size in SIZES.items()},
    **{f"thin {kind}": f'<geom type="{kind}" size="{" ".join(map(str, size))}" mass="3" shellinertia="true"/>'
       for kind, size in SIZES.items()},
    **{f"{kind} between ends": f'<geom type="{kind}" size="0.1" fromto="0 0.1 0.2 0.5 0.3 -0.1"/>'
       for kind in ("capsule", "cylinder", "ellipsoid", "box")},
    "several": '<geom size="0.1" mass="2"/><geom type="box" size="0.1 0.2 0.3" pos="0.4 0 0"/>'
               '<geom size="1" mass="0"/>',
    "another group": '<geom size="0.1" group="3"/><geom size="0.2" group="5"/>',
    "in a frame": '<frame pos="0.1 0.2 0.3" euler="0.1 0.2 0.3"><geom size="0.1" pos="0 0 0.5"/>'
                  '<frame quat="0 1 0 0"><geom type="box" size="0.1 0.2 0.3" pos="0.1 0 0"/></frame></frame>',
    "given": '<inertial mass="2" pos="0.1 0.2 0.3" diaginertia="0.1 0.2 0.15" euler="0.1 0.2 0.3"/><geom size="0.3"/>',
    "full": '<inertial mass="2" pos="0.1 0 0.3" fullinertia="0.1 0.2 0.15 0.01 -0.02 0.03"/>',
    "flat": '<inertial mass="2" pos="0.1 0 0.3" diaginertia="0.1 0.2 0.31"/>',
    "light": '<inertial mass="0.01" pos="0.1 0 0.3" diaginertia="0.0001 0.0002 0.00021"/>',
}  # fmt: skip
COMPILERS = {
    "": CASES,
    'inertiafromgeom="true"': ("given", "several"),
    'inertiafromgeom="false"': ("given",),
    'inertiagrouprange="0 3"': ("another group",),
    'boundmass="1" boundinertia="0.05" balanceinertia="true"': ("light", "flat"),
    'balanceinertia="true"': ("flat", "given"),
    'settotalmass="7"': ("given", "several"),
}


@pytest.mark.parametrize(
    ("case", "compiler"), [(case, compiler) for compiler, cases in COMPILERS.items() for case in cases if
                           (compiler or case != "flat")],
)  # fmt: skip
def test_a_body_has_the_inertia_that_mujoco_gives_it(case: str, compiler: str) -> None:
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: python3 dev.py robots")
    text = body(CASES[case], compiler).replace('<asset><mesh name="shell" file="none.stl"/></asset>', "")
    given, turn = mujoco.MjModel.from_xml_string(text).body("arm"), np.zeros(9)
    mujoco.mju_quat2Mat(turn, given.iquat)
    turn = turn.reshape(3, 3)
    tensor = turn * given.inertia @ turn.T
    expected = from_physical(given.mass[0], given.ipos - [0.1, 0, 0], (tensor + tensor.T) / 2)
    digits = 1e-9 if case == "thin ellipsoid" else 1e-12  # the difference of two solids, 1e-6 m apart
    np.testing.assert_allclose(theta(CASES[case], compiler), expected, rtol=digits, atol=1e-13)


def test_a_shape_of_the_default_class() -> None:
    defaults = '<default><geom type="box" size="0.1 0.2 0.3" density="10"/></default><worldbody>'
    text = body("<geom/>").replace("<worldbody>", defaults)
    found = np.array([one.value for one in RigidBodies(text).parameters])
    np.testing.assert_allclose(found, theta('<geom type="box" size="0.1 0.2 0.3" density="10"/>'), rtol=1e-15)


def test_the_least_mass_makes_no_inertia_of_its_own() -> None:
    mass, centre, tensor = to_physical(theta("", 'boundmass="2"'))
    assert mass == 2.0
    np.testing.assert_allclose(centre, [-0.1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(tensor, 0, atol=1e-15)


def test_what_meshes_weigh_is_not_known() -> None:
    for geoms in ('<geom type="mesh" mesh="shell"/>', '<geom size="0.1"/><geom type="box" mesh="shell"/>'):
        assert np.isnan(theta(geoms)).all()
        assert np.isnan(theta(geoms, 'settotalmass="3"')).all()
    weightless = '<geom size="0.1"/><geom type="mesh" mesh="shell" mass="0"/><geom type="mesh" group="6" mesh="shell"/>'
    np.testing.assert_array_equal(theta(weightless), theta('<geom size="0.1"/>'))


@pytest.mark.parametrize(
    ("geoms", "message"),
    [
        ('<geom name="g" type="cube" size="1"/>', "body 'arm', <geom> 'g': type 'cube'; .*'box'"),
        ('<geom name="g" size="-1"/>', "<geom> 'g': size = '-1'; a sphere needs 1 positive numbers"),
        ('<geom type="box" size="1 1"/>', "size = '1 1', expected 3 numbers"),
        ('<geom size="1" fromto="0 0 0 1 1 1"/>', "fromto is given for a sphere, which has no ends"),
        ('<geom type="capsule" size="1" fromto="0 0 0 0 0 0"/>', "has no direction"),
    ],
)
def test_impossible_shapes(geoms: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        theta(geoms)
