"""Robot files: what is read of them, and what is refused."""

import subprocess
import sys

import numpy as np
import pytest

from dynident.models import Model, RigidBodies, recursion_kernel
from dynident.models.robot_files import RobotJointLimits
from dynident.runtime import ModelError
from tests.robots import ARM, ARM_MJCF, GRIPPER, joint, link, urdf


def values(term):
    return np.array([p.value for p in term.parameters], dtype=float)


def test_limits_and_nominal_friction():
    text = ARM.replace('<axis xyz="0.0 1.0 0.0"/>', '<axis xyz="0 1 0"/><dynamics damping="0.3" friction="0.1"/>')
    term = RigidBodies(text, joints_used=("twist", "shoulder"))
    assert term.limits == {"twist": RobotJointLimits(), "shoulder": RobotJointLimits(10.0, 2.0, -1.0, 1.0)}
    assert (term.damping, term.friction, term.armature) == ({"twist": 0.3}, {"twist": 0.1}, {})


def test_missing_meshes_and_materials_do_not_matter():
    mesh = '<visual><geometry><mesh filename="package://no/where.stl"/></geometry><material name="none"/></visual>'
    text = ARM.replace("</inertial>", f"</inertial>{mesh}{mesh.replace('visual', 'collision')}")
    text = text.replace(
        "</robot>", '<gazebo reference="x"/><transmission name="t"><joint name="rail"/></transmission></robot>'
    )
    np.testing.assert_array_equal(values(RigidBodies(text)), values(RigidBodies(ARM)))


def test_a_mimic_joint_moves_with_its_master():
    """Two fingers of 0.1 kg: the follower at 2 q + 0.01 weighs twice on the finger, and its inertia four times."""
    term = RigidBodies(GRIPPER, gravity=(0.0, -10.0, 0.0))
    assert [x.name for x in term.joints] == ["elbow", "finger"]
    assert [p.body for p in term.parameters[::10]] == ["arm", "left", "right"]
    assert list(term.limits) == list(RigidBodies(GRIPPER, locked={"follower": 0.0}).limits) == ["elbow", "finger"]
    rest, pull = np.zeros((1, 2)), np.array([[0.0, 1.0]])
    np.testing.assert_allclose(term.torque(rest, rest, rest, values(term))[0, 1], 0.1 * 10 - 2 * 0.1 * 10)
    np.testing.assert_allclose(term.regressor(rest, rest, rest)[0, 1, [10, 20]], [10, -20])
    assert Model((term,)).mass_matrix(pull, values(term))[0, 1, 1] == pytest.approx(0.1 + 4 * 0.1)
    swapped = RigidBodies(GRIPPER, joints_used=("finger", "elbow"), gravity=(0.0, -10.0, 0.0))
    assert [p.body for p in swapped.parameters[::10]] == ["left", "arm", "right"]
    state = np.random.default_rng(0).normal(size=(3, 4, 2))
    first, second = term.torque(*state, values(term)), swapped.torque(*state[:, :, ::-1], values(swapped))
    np.testing.assert_allclose(second, first[:, ::-1], rtol=1e-12)


def test_a_joint_of_an_unknown_master_matters_only_where_it_moves():
    text = GRIPPER.replace('mimic joint="finger"', 'mimic joint="fin"')
    assert [j.name for j in RigidBodies(text, joints_used=("elbow",)).joints] == ["elbow"]
    assert len(RigidBodies(text, locked={"follower": 0.1}).joints) == 2


def test_a_base_that_floats_is_taken_as_fixed():
    text = urdf(link("world"), link("trunk", 3.0), link("leg", 1.0), joint("root", "floating", "world", "trunk"),
                joint("hip", "revolute", "trunk", "leg"))  # fmt: skip
    assert [j.name for j in RigidBodies(text).joints] == ["hip"]


def test_several_limbs_of_a_heavy_base_are_said():
    parts = (link("trunk", 3.0), link("left", 1.0), link("right", 1.0), joint("l", "revolute", "trunk", "left"),
             joint("r", "revolute", "trunk", "right"))  # fmt: skip
    assert RigidBodies(urdf(*parts)).notes == ("robot: 2 limbs move from the base 'trunk', which is taken as fixed.",)
    assert RigidBodies(urdf(*parts), locked={"r": 0.0}).notes == ()
    assert RigidBodies(urdf(link("trunk"), *parts[1:])).notes == ()


def test_unknown_inertia_is_not_zero():
    """MuJoCo would compute it from the mesh; a body without shapes has none."""
    inertial = '<inertial mass="0.7" pos="0.02 0 0.03" diaginertia="0.003 0.004 0.002"/>'
    shaped = RigidBodies(ARM_MJCF.replace(inertial, '<geom type="mesh" mesh="shell"/>'))
    assert [p.value for p in shaped.parameters[20:]] == [None] * 10
    assert shaped.notes == ("robot: body 'wrist': its inertia follows from meshes that were not found.",)
    bare = RigidBodies(ARM_MJCF.replace(inertial, ""))
    assert [p.value for p in bare.parameters[20:]] == [0.0] * 10


def test_what_an_mjcf_holds_besides_is_noted():
    text = ARM_MJCF.replace("<default>", '<option density="1.2"/><default>', 1)
    text = text.replace('<body name="slide"', '<body gravcomp="1" name="slide"')
    belt = '<tendon><spatial name="belt"><site site="a"/><site site="b"/></spatial></tendon>'
    text = text.replace("</worldbody>", f'<site name="a"/><site name="b" pos="0 0 1"/></worldbody>{belt}')
    notes = " ".join(RigidBodies(text).notes)
    for words in ("density = '1.2'", "compensation of slide", "'belt'"):
        assert words in notes


def test_constraints_among_locked_joints_are_no_loops():
    text = ARM_MJCF.replace(
        "</worldbody>",
        '</worldbody><equality><joint joint1="rail" joint2="twist"/><weld body1="upper" body2="wrist"/>'
        '<connect active="false" body1="base" body2="wrist" anchor="0 0 0"/></equality>',
    )
    assert [j.name for j in RigidBodies(text, joints_used=("shoulder",)).joints] == ["shoulder"]


def test_neither_pinocchio_nor_sympy_is_needed():
    script = (
        "import sys; sys.modules['pinocchio'] = sys.modules['sympy'] = None; import numpy as np\n"
        "import dynident.models.lagrangian, dynident.models.simulation.recording\n"
        "from dynident.models import RigidBodies; from tests.robots import ARM\n"
        "print(RigidBodies(ARM).regressor(*np.ones((3, 2, 3))).shape)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "(2, 3, 30)"


@pytest.mark.parametrize("kernel", [True, False])
def test_shapes_that_do_not_fit_are_errors(kernel, monkeypatch):
    """The kernel knows only where arrays begin."""
    if not kernel:
        monkeypatch.setattr(recursion_kernel, "function", lambda *_: None)
    term = RigidBodies(ARM)
    q, theta = np.ones((4, 3)), np.ones(30)
    for wrong in (q[:, :2], q[0], q[:2], np.ones((4, 4))):
        for states in ((wrong, q, q), (q, wrong, q), (q, q, wrong)):
            with pytest.raises(ModelError, match="expected"):
                term.regressor(*states)
        with pytest.raises(ModelError, match="expected"):
            term.mass_and_bias(q, wrong, theta)
    for short in (theta[:20], np.ones(40), np.ones((3, 10))):
        for call in (term.torque, term.partials):
            with pytest.raises(ModelError, match="theta has shape"):
                call(q, q, q, short)
    for row, column in (([3], [0]), ([0], [30]), ([-1], [0]), ([0, 1], [0]), (0, 0)):
        with pytest.raises(ModelError, match="joint"):
            term.entries(q, q, q, np.array(row), np.array(column))
    np.testing.assert_allclose(term.entries(q, q, q, [0, 2], [1, 25]).T, term.regressor(q, q, q)[:, [0, 2], [1, 25]])
