"""What of a robot can change, as directions of its base parameters."""

import numpy as np
from scipy.stats import f

from dynident.apps.demo.arm import true_model
from dynident.models import CoupledMotor, Joint, Model, RotorInertia
from dynident.models.friction import Coulomb, Offset, Ripple, Viscous
from dynident.motion.log import Motion
from dynident.regression import GroupKind, evidence, groups_of, structural_base_parameters
from dynident.regression.groups import repeated_rows


def test_each_joint_has_its_groups_and_the_last_body_a_payload() -> None:
    arm = true_model()
    joints = arm.joints
    arm = Model((*arm.terms[:1], RotorInertia(joints), Viscous(joints), Coulomb(joints), Offset(joints)))
    arm = arm.with_terms(Ripple(joints, on=(joints[1].name,), cycles=(50.0, 100.0)))
    basis = structural_base_parameters(arm)
    groups = groups_of(arm, basis)
    result = {(group.kind, group.joint): group for group in groups}
    assert len(result) == len(groups) == 6 + 1 + 6 + 1
    assert result[GroupKind.FRICTION, joints[3].name].names == (f"Fv_{joints[3].name}", f"Fc_{joints[3].name}")
    assert len(result[GroupKind.RIPPLE, joints[1].name].names) == 4
    payload = result[GroupKind.PAYLOAD, joints[-1].name]
    assert len(payload.names) == 10
    for group in groups:
        assert group.directions.shape == (basis.rank, len(group.names))
        assert np.linalg.matrix_rank(group.directions / np.linalg.norm(group.directions, axis=0)) == len(group.names)


def test_the_friction_of_a_coupled_motor_is_its_own() -> None:
    joints = (Joint("five"), Joint("six"))
    motor = CoupledMotor(joints, {"five": 1, "six": 1}, name="wrist", offset=True)
    arm = Model((Viscous(joints), motor))
    result = {(x.kind, x.joint): x.names for x in groups_of(arm, structural_base_parameters(arm))}
    assert result == {
        (GroupKind.FRICTION, "five"): ("Fv_five",),
        (GroupKind.FRICTION, "six"): ("Fv_six",),
        (GroupKind.FRICTION, "wrist"): ("Fv_wrist", "Fc_wrist"),
        (GroupKind.OFFSET, "wrist"): ("offset_wrist",),
    }


def test_a_tenth_of_a_motion_is_passed_again() -> None:
    t = np.arange(2000) * 0.01
    q = np.column_stack([np.sin(t), np.sin(1.7 * t)])
    first, second = (Motion(t, q, 0 * q, 0 * q, 0 * q, ("a", "b"), np.arange(2000) < n) for n in (2000, 210))
    pairs = repeated_rows(first, second)
    assert np.array_equal(pairs, [np.arange(210)] * 2)
    assert repeated_rows(first, Motion(t, q, 0 * q, 0 * q, 0 * q, ("a", "b"), np.arange(2000) < 190)) is None


def test_evidence_is_minus_the_logarithm_of_the_tail_of_f_also_where_that_underflows() -> None:
    gain = np.array([0.0, 1.0, 10.0, 80.0, 300.0])
    for rank in (1, 2, 10):
        np.testing.assert_allclose(evidence(gain, rank, 60.0), -f.logsf(gain / rank, rank, 60.0), rtol=1e-9, atol=1e-12)
    far = evidence(np.array([1e4, 1e10, 1e14, 1e18, 1e22]), 2, 60.0)
    assert np.diff(far)[0] > 0
    np.testing.assert_allclose(np.diff(far)[1:], 30 * np.log(1e4), rtol=1e-6, atol=1e-3)
    assert evidence(np.array([5.0]), np.array([0]), 60.0).tolist() == [0.0]
