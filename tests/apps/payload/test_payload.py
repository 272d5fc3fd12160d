"""What an arm carries is found within its errors: gains right and wrong, drift, and ten parameters as a body."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from dynident.apps.payload import (
    ArmEvidence,
    DriveGains,
    ErrorSource,
    GainsUnknown,
    NoPayload,
    NotShown,
    OtherArm,
    Payload,
    PayloadOrDrift,
    PayloadRequest,
    PhysicalBody,
    find_payload,
    mount_of,
)
from dynident.apps.payload.body import (
    _centre_pose,
    best_turning,
    make_consistent,
    mass_bound,
    physical_components,
    physical_jacobian,
    turnings,
)
from dynident.identification import identify
from dynident.models import Model, RigidBodies, smallest_eigenvalue
from dynident.models.friction import LoadCoulomb, Viscous
from dynident.project.export import with_payload_link
from dynident.runtime import ConfigError, InputError, ModelError
from tests.apps.payload.arms import CARRIED, RECIPE, SIX, arm, fit, loaded_result, recorded, result
from tests.kept import check_kept, facts
from tests.robots import joint, link, urdf

GAINS = DriveGains(("a",), np.array([1.1]), np.array([[1e-4]]), 2.0)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"known_mass": 0.0}, "known mass is 0 kg"),
        ({"known_mass": np.inf}, "known mass is inf kg"),
        ({"gain_error": -1.0}, "gain error is -1 %"),
        ({"friction_change": 101.0}, "friction change is 101 %"),
        ({"load_friction": np.nan}, "friction by the load is nan %"),
        ({"known_mass": 1.0, "known_centre": (0.0, 0.0, 50.0)}, "50 m away; give it in m"),
        ({"gains": GAINS, "known_mass": 1.0}, "give one of them"),
        ({"known_centre": (0.0, 0.0, 0.1)}, "known centre of mass needs the known mass"),
        ({"known_mass": 1.0, "known_centre": (0.0, 0.0, np.nan)}, "three numbers in m"),
    ],
)
def test_what_cannot_be_is_refused(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        PayloadRequest(**settings)


def test_the_values_differ_from_the_truth_by_about_their_errors() -> None:
    evidence, (_, theta) = ArmEvidence.of(result()), arm()
    white = evidence.whitening_matrix()
    assert 0.5 < np.mean((white @ (evidence.value - evidence.combination @ theta)) ** 2) < 2
    np.testing.assert_allclose(white @ evidence.covariance @ white.T, np.eye(len(evidence.value)), atol=1e-6)


def test_results_that_do_not_know_their_covariance_are_refused() -> None:
    old = replace(result(), errors=replace(result().errors, base_covariance=None))
    with pytest.raises(InputError, match=r"does not hold the covariance .* identify again"):
        find_payload(old, loaded_result())
    case = ArmEvidence.of(result())
    for covariance, words in ((case.covariance * 0 + 1.0, "is singular"), (0 * case.covariance, "no standard error")):
        with pytest.raises(InputError, match=words):
            replace(case, covariance=covariance).whitening_matrix()


TRUTH = physical_components(CARRIED)
KNOWN = PayloadRequest(gain_error=0.0, gain_change=0.0)
GAIN = 1.05


@cache
def payload_result() -> Payload:
    return find_payload(result(), {"loaded": recorded("loaded", CARRIED)}, request=KNOWN)


@cache
def weighed() -> Payload:
    return find_payload(result(GAIN), loaded_result("weighed", GAIN), request=PayloadRequest(known_mass=3.0))


def distance(payload: Payload) -> float:
    """The largest error over its standard error."""
    return float(np.max(np.abs(payload.body.values - TRUTH) / payload.body.std))


def test_a_payload_is_found_within_its_errors() -> None:
    case = payload_result()
    assert distance(case) < 4
    assert case.body.mass == pytest.approx(3.0, rel=0.01)
    assert case.body.centre == pytest.approx(TRUTH[1:4], abs=0.003)
    assert case.body.std[0] < 0.02
    assert case.factor < 1.5
    assert case.notes == ()
    assert np.sum(list(case.shares.values()), axis=0) == pytest.approx(np.ones(10), abs=1e-6)
    (log,) = case.logs
    assert log.without > 10 * log.with_payload
    assert log.with_payload == pytest.approx(log.free, rel=0.2)
    two_results = find_payload(result(), loaded_result(), request=KNOWN)
    assert two_results.body.values == pytest.approx(case.body.values, rel=1e-9)
    assert two_results.body.std == pytest.approx(case.body.std, rel=1e-9)


def test_a_tool_that_was_removed_is_found_the_other_way_round() -> None:
    with_it = loaded_result()
    payload = find_payload(with_it, result(), request=replace(KNOWN, removed=True))
    assert distance(payload) < 4
    with pytest.raises(InputError, match=r"less than when it was identified.*--removed"):
        find_payload(with_it, result(), request=KNOWN)
    with pytest.raises(InputError, match=r"more than when it was identified.*drop --removed"):
        find_payload(result(), with_it, request=replace(KNOWN, removed=True))


def test_a_common_gain_error_scales_the_payload_and_is_counted() -> None:
    payload = find_payload(result(GAIN), loaded_result("weighed", GAIN))
    assert payload.body.mass == pytest.approx(GAIN * 3.0, rel=0.02)  # nothing tells it
    assert distance(payload) < 3
    assert payload.body.std[0] == pytest.approx(0.03 * 3.0, rel=0.5)
    assert payload.shares[ErrorSource.GAINS][0] > 0.9
    (note,) = (note for note in payload.notes if isinstance(note, GainsUnknown))
    assert note.data < 0.3 * note.std


def test_a_known_mass_tells_the_gains_and_these_the_next_payload() -> None:
    gains = weighed().gains
    assert gains.known_mass == 3.0
    assert gains.factor == pytest.approx(np.full(6, GAIN), abs=0.03)
    assert (np.abs(gains.factor - GAIN) < 4 * gains.std).all()
    assert gains.correction == pytest.approx(1 / gains.factor)
    assert weighed().body.mass == pytest.approx(3.0, abs=1e-3)
    lighter = 0.5 * CARRIED
    payload = find_payload(
        result(GAIN), {"next": recorded("next", lighter, GAIN)}, request=PayloadRequest(gains=gains, gain_change=0.0)
    )
    assert payload.body.mass == pytest.approx(1.5, rel=0.01)
    assert payload.body.centre == pytest.approx(TRUTH[1:4], abs=0.006)
    assert not any(isinstance(note, GainsUnknown) for note in payload.notes)


def test_gains_that_change_from_day_to_day_count_unless_a_recording_of_the_day_tells_them() -> None:
    warm = np.array([1.015, 0.99, 1.01, 0.985, 1.0, 1.01])
    loaded, unloaded = ({name: recorded(name, body, warm)} for name, body in (("loaded", CARRIED), ("unloaded", None)))
    fixed, counted = (
        find_payload(result(), loaded, request=replace(KNOWN, gain_change=change)) for change in (0.0, 1.0)
    )
    both = find_payload(result(), loaded, unloaded, replace(KNOWN, gain_change=1.0))
    assert abs(counted.body.mass - 3.0) < 2 * counted.body.std[0]
    assert fixed.factor > 2 * counted.factor  # what does not fit makes all errors larger
    assert abs(both.body.mass - 3.0) < 0.5 * abs(fixed.body.mass - 3.0)
    assert abs(both.body.mass - 3.0) < 3 * both.body.std[0]
    assert both.body.std[0] < counted.body.std[0]


def test_gains_are_of_the_joints_of_the_result_in_any_order() -> None:
    gains, loaded = weighed().gains, loaded_result("weighed", GAIN)
    turned = DriveGains(gains.joints[::-1], gains.factor[::-1], gains.covariance[::-1, ::-1], 3.0)
    first, second = (find_payload(result(GAIN), loaded, request=PayloadRequest(gains=each)) for each in (gains, turned))
    assert first.body.values == pytest.approx(second.body.values, rel=1e-9)
    strange = replace(gains, joints=("a", *gains.joints[1:]))
    with pytest.raises(InputError, match="'j1'"):
        find_payload(result(GAIN), loaded, request=PayloadRequest(gains=strange))


def drifted(scale: float = 0.2) -> np.ndarray:
    """Changes of friction and offsets in % of the friction."""
    _, theta = arm()
    changed = np.zeros(len(theta))
    signs = np.array([1, -1, 1, 1, -1, 1.0])
    for start in range(len(theta) - 18, len(theta), 6):
        changed[start : start + 6] = scale * signs * np.abs(theta[-12:-6])
    return changed


def test_drift_is_told_from_the_payload_and_recordings_without_it_help() -> None:
    loaded = fit(recorded("loaded", CARRIED, more=drifted()))
    alone = find_payload(result(), loaded, request=KNOWN)
    both = find_payload(result(), loaded, {"unloaded": recorded("unloaded", more=drifted())}, KNOWN)
    assert distance(alone) < 4
    assert distance(both) < 4
    assert (both.body.std[:4] < alone.body.std[:4]).all()
    assert alone.drift + alone.friction == pytest.approx(drifted(), abs=0.2)
    fixed = find_payload(result(), loaded, request=replace(KNOWN, friction_change=0.0))
    assert fixed.factor > 5
    assert any(isinstance(note, OtherArm) for note in fixed.notes)


def test_what_one_joint_does_not_show_is_said_with_the_motion_that_would_show_it() -> None:
    payload = find_payload(result(), {"still": recorded("still", CARRIED, still=(0, 2, 3, 4, 5))}, request=KNOWN)
    notes = [note for note in payload.notes if isinstance(note, NotShown)]
    assert notes
    joints = [note.joint for note in notes]
    assert set(joints) <= {"", "j1", "j2", "j3", "j4", "j5", "j6"}
    assert len(set(joints)) == len(joints)  # one line for each
    helped = [note for note in notes if note.joint]
    assert helped
    assert all(then < std for note in helped for then, std in zip(note.then, note.std, strict=True))
    assert distance(payload) < 4


def test_what_a_turning_wrist_does_not_tell_from_drift_is_said() -> None:
    wrist, request = (0, 1, 2, 3), replace(KNOWN, friction_change=100.0)
    loaded = fit(recorded("loaded", CARRIED, more=drifted(), still=wrist))
    alone = find_payload(result(), loaded, request=request)
    notes = [note for note in alone.notes if isinstance(note, PayloadOrDrift)]
    assert {note.component for note in notes} >= {"mass", "z"}
    assert all(note.share > 0.9 and not note.unloaded for note in notes)
    unloaded = {"unloaded": recorded("unloaded", more=drifted(), still=wrist)}
    both = find_payload(result(), loaded, unloaded, request)
    assert both.body.std[0] < 0.2 * alone.body.std[0]
    assert not any(isinstance(note, PayloadOrDrift) for note in both.notes)
    assert both.body.mass == pytest.approx(3.0, abs=4 * float(both.body.std[0]))


def test_the_base_is_tilted_once() -> None:
    tilt = (0.3, -0.2)
    recipe = replace(RECIPE, base_tilt=tilt)
    tilted = identify(arm()[0], {"arm": recorded("arm", tilt=tilt)}, recipe=recipe)
    payload = find_payload(tilted, {"loaded": recorded("loaded", CARRIED, tilt=tilt)}, request=KNOWN)
    assert distance(payload) < 4
    assert payload.factor < 1.5


def test_friction_by_the_load_sees_that_of_the_payload() -> None:
    model, _ = arm()
    model = model.with_terms(LoadCoulomb(model.joints))
    by_load = identify(model, {"arm": recorded("arm", by_load=0.1)}, recipe=RECIPE)
    loaded = {"loaded": recorded("loaded", CARRIED, by_load=0.1)}
    payload = find_payload(by_load, loaded, request=KNOWN)
    assert payload.body.mass == pytest.approx(3.0, rel=0.01)
    assert payload.body.centre == pytest.approx(TRUTH[1:4], abs=0.003)
    blind, blind_loaded = fit(recorded("arm", by_load=0.1)), fit(loaded["loaded"])
    other = find_payload(blind, blind_loaded, request=KNOWN)
    assert np.linalg.norm(other.body.values[:4] - TRUTH[:4]) > np.linalg.norm(payload.body.values[:4] - TRUTH[:4])
    assert other.shares[ErrorSource.FRICTION].max() > 0.3  # it is an unknown there
    without = find_payload(blind, blind_loaded, request=replace(KNOWN, load_friction=0.0))
    assert distance(other) < 2 < distance(without)
    assert np.linalg.norm(other.body.values[:4] - TRUTH[:4]) < np.linalg.norm(without.body.values[:4] - TRUTH[:4])


def test_no_payload_is_said() -> None:
    payload = find_payload(result(), {"empty": recorded("empty")}, request=KNOWN)
    assert [type(note) for note in payload.notes] == [NoPayload]
    assert not payload.is_significant
    assert payload.body.mass < 0.05
    J = physical_jacobian(payload.value)  # the shift to a body that can be counts as an error
    shift = payload.body.values - physical_components(payload.free)
    np.testing.assert_allclose(payload.body.std**2, np.diag(J @ payload.covariance @ J.T) + shift**2)
    assert smallest_eigenvalue(payload.value) > 0


def test_a_mass_on_which_no_torque_depends_is_not_bounded_by_its_prior() -> None:
    assert mass_bound(0.0, 0.1) == "its mass is 0 ± 0.10 kg, so it is below 0.3 kg"
    assert "the mass stays unknown" in mass_bound(0.0, 999.0)


def test_recordings_of_another_arm_and_results_of_other_terms_are_refused() -> None:
    log = recorded("other")
    other = replace(log, tau=log.tau[:, ::-1] * [1, -1, 1, -1, 1, -1])
    with pytest.raises(InputError, match=r"other: the arm of the result with any payload leaves .* of another arm"):
        find_payload(result(), {"other": other})
    for loaded, unloaded in (({"a": log, "b": log}, None), ({"a": log}, {"b": log})):
        with pytest.raises(InputError, match="b: holds the same samples as 'a'"):
            find_payload(result(), loaded, unloaded)
    with pytest.raises(InputError, match="no joint 'j1'"):
        find_payload(result(), {"renamed": replace(log, joints=("a", "b", "c", "d", "e", "f"))})
    model, _ = arm()
    fewer = identify(replace(model, terms=model.terms[:-1]), {"loaded": recorded("loaded", CARRIED)}, recipe=RECIPE)
    with pytest.raises(InputError, match=r"different parameters .*offset"):
        find_payload(result(), fewer)


def test_a_known_mass_far_beyond_the_arm_is_refused() -> None:
    for mass in (30.0, 1e5, 1e9):
        with pytest.raises(InputError, match="known mass is"):
            find_payload(result(GAIN), loaded_result("weighed", GAIN), request=PayloadRequest(known_mass=mass))


def test_the_figures_of_a_payload_stay() -> None:
    check_kept(
        "payloads", "\n".join(line for payload in (payload_result(), weighed()) for line in facts(payload, depth=2))
    )


@pytest.mark.parametrize("k", [4, 6, 9])
def test_another_becomes_consistent_where_it_is_least_known_and_no_further_than_needed(k: int) -> None:
    phi, information = CARRIED.copy(), np.diag(np.full(10, 1e8))
    phi[k], information[k, k] = -0.01, 1.0
    body = make_consistent(phi, information)
    assert smallest_eigenvalue(body) > 0
    is_other = np.arange(10) != k
    np.testing.assert_allclose(body[is_other], phi[is_other], atol=1e-4)
    body, rng = make_consistent(phi, np.eye(10)), np.random.default_rng(0)
    others = body + 1e-3 * rng.standard_normal((200, 10))
    others = others[smallest_eigenvalue(others) > 1e-7]
    assert len(others) > 5
    assert (np.linalg.norm(others - phi, axis=1) > np.linalg.norm(body - phi) - 1e-6).all()


def test_mass_centre_and_inertia_and_their_derivatives() -> None:
    values = physical_components(CARRIED)
    np.testing.assert_allclose(values, [3.0, 0.02, -0.03, 0.08, 0.012, 0, 0.015, 0, 0, 0.006], atol=1e-15)
    body, J = PhysicalBody(values, np.ones(10)), physical_jacobian(CARRIED)
    assert body.mass == pytest.approx(3.0)
    np.testing.assert_allclose(body.tensor, np.diag([0.012, 0.015, 0.006]), atol=1e-15)
    step = 1e-4 * np.random.default_rng(0).standard_normal(10)
    np.testing.assert_allclose(physical_components(CARRIED + step) - values, J @ step, atol=1e-7)


def test_the_flange_is_the_link_that_is_called_so() -> None:
    mount = mount_of(arm()[0])
    assert (mount.frame, mount.body, mount.joint) == ("arm_tool0", "turn", "j6")
    assert mount_of(Model((RigidBodies(SIX.replace("arm_tool0", "spindle")),))).frame == "turn"


@pytest.mark.parametrize("frame", ["arm_tool0", "turn", "fore"])
def test_parameters_in_a_frame_are_those_of_a_link_fixed_to_it(frame: str) -> None:
    model, _ = arm()
    values = physical_components(CARRIED)
    xx, xy, yy, xz, yz, zz = values[4:]
    text = with_payload_link(SIX, frame, values[0], values[1:4], np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    before, after = RigidBodies(SIX), RigidBodies(text)
    added = np.array([parameter.value for parameter in after.parameters]) - [
        parameter.value for parameter in before.parameters
    ]
    np.testing.assert_allclose((mount_of(model, frame).transform @ CARRIED)[: len(added)], added, atol=1e-12)


def test_frames_that_do_not_exist_or_do_not_move_are_refused() -> None:
    model, _ = arm()
    bare = replace(model, terms=model.terms[1:])
    for robot, frame, words in (
        (model, "arm_tool", r"'arm_tool' is no link.*did you mean 'arm_tool0'"),
        (model, "base", "'base' does not move"),
        (bare, None, "has no links to carry a payload"),
    ):
        with pytest.raises(ModelError, match=words):
            mount_of(robot, frame)


def test_an_arm_with_two_ends_needs_a_frame() -> None:
    text = urdf(
        link("base"), link("left", 1.0), link("right", 1.0),
        joint("l", "continuous", "base", "left"), joint("r", "continuous", "base", "right"),
    )  # fmt: skip
    bodies = RigidBodies(text)
    model = Model((bodies, Viscous(bodies.joints)))
    with pytest.raises(ModelError, match=r"several ends .'left', 'right'.; name the payload's frame"):
        mount_of(model)
    assert mount_of(model, "right").joint == "r"


def test_turning_the_last_joint_shows_the_inertia_about_its_axis() -> None:
    model, _ = arm()
    reference = np.diag([1e6, *[1e6] * 3, *[1e2] * 6])
    ways = turnings(model, mount_of(model), CARRIED, reference, np.full(6, 1e-3), np.zeros((4, 6)))
    assert [way.joint for way in ways] == ["j1", "j2", "j3", "j4", "j5", "j6"]
    assert best_turning(ways, 9, np.inf).joint in ("j4", "j6")
    assert best_turning(ways, 6, np.inf).joint not in ("j6",)
    before = np.sqrt(np.diag(np.linalg.inv(reference)))
    assert (best_turning(ways, 9, np.inf).std[9], best_turning(ways, 6, np.inf).std[6]) < (before[9], before[6])
    assert {way.speed for way in ways} == {1.5}


def test_a_joint_turns_within_its_limits() -> None:
    model, _ = arm()
    limited = SIX.replace('type="continuous"', 'type="revolute"').replace(
        "<axis", '<limit effort="9" velocity="1" lower="0.1" upper="0.5"/><axis'
    )
    bodies = RigidBodies(limited)
    slow = replace(model, terms=(bodies, *model.terms[1:]))
    ways = turnings(slow, mount_of(slow), CARRIED, np.eye(10), np.ones(6), np.zeros((4, 6)))
    assert [way.speed for way in ways] == pytest.approx([0.7] * 6)
    assert _centre_pose(slow, 0, np.zeros(6), 0.8)[0] == pytest.approx(0.3)
