"""What a log says of its channels, and of gaps in its time."""

import numpy as np
import pytest

from dynident.checks import channel_facts, channel_notes, check_log, check_log_fully
from dynident.motion.log import Log
from dynident.runtime import InputError, Note

N = 2000


def log(**changes) -> Log:
    """A sound log of one revolute joint at 500 Hz, with some fields replaced."""
    t = np.arange(N) * 0.002
    fields = {"t": t, "q": np.sin(2 * t)[:, None], "tau": np.cos(3 * t)[:, None], "joints": ("elbow",)}
    return Log(**(fields | changes))


def stretched(rows: int, gap: float) -> np.ndarray:
    t = np.arange(N) * 0.002
    t[rows:] += gap
    return t


def jittered() -> np.ndarray:
    return np.cumsum(np.random.default_rng(1).uniform(0.001, 0.003, N))


T = np.arange(N) * 0.002
COARSE = np.round(np.sin(2 * T) / 0.001)[:, None] * 0.001
CASES = {
    "gap": ({"t": stretched(500, 0.1)}, "error", None, channel_notes.LongGap(0.102, 0.998, 51.0, 1)),
    "jitter": ({"t": jittered()}, "warning", None, channel_notes.UnevenSteps(0.29, 0.002, 0.001, 0.003)),
    "still": ({"q": np.full((N, 1), 0.3)}, "warning", "elbow", channel_notes.NeverMoves(1, 0.3)),
    "dead torque": ({"tau": np.zeros((N, 1))}, "warning", "elbow", channel_notes.ConstantTorque(0.0)),
    "degrees": ({"q": 90 * np.sin(2 * T)[:, None]}, "error", "elbow", channel_notes.PerhapsDegrees(180.0, 180.0)),
    "fast": ({"q": 4 * np.sin(12 * T)[:, None]}, "error", "elbow", channel_notes.PerhapsDegrees(8.0, 47.88)),
    "unordered": (
        {"q": np.random.default_rng(3).permutation(np.sin(2 * T))[:, None]},
        "error",
        None,
        channel_notes.UnorderedRows(),
    ),
    "quantised": ({"q": COARSE}, "warning", "elbow", channel_notes.QuantisedPosition(0.001, 10.0)),
}


@pytest.mark.parametrize(("changes", "severity", "joint", "note"), CASES.values(), ids=CASES)
def test_each_fault_is_found_and_is_the_only_one(changes, severity, joint, note):
    (finding,) = check_log(log(**changes), {"elbow": "revolute"})
    assert (finding.severity, finding.joint, type(finding.message)) == (severity, joint, type(note))
    assert vars(finding.message) == pytest.approx(vars(note), rel=0.01)


TURNING = {"q": 90 * np.sin(2 * T)[:, None]}
NOISY = np.sin(2 * T)[:, None] + np.random.default_rng(2).normal(0, 0.01, (N, 1))
SOUND = {
    "sound": ({}, "revolute", ()),
    "noise is no speed": ({"q": NOISY}, "revolute", ()),
    "many turns": (TURNING, "revolute", {"elbow"}),
    "a rail": (TURNING, "prismatic", ()),
    "torques in fine steps": ({"tau": 0.1 * np.round(np.cos(3 * T)[:, None] / 0.1)}, "revolute", ()),
    "torques in coarse steps": ({"tau": 0.5 * np.round(np.cos(3 * T)[:, None] / 0.5)}, "revolute", ()),
}  # fmt: skip


@pytest.mark.parametrize(("changes", "kind", "multi_turn"), SOUND.values(), ids=SOUND)
def test_a_sound_log_has_no_findings(changes, kind, multi_turn):
    assert check_log(log(**changes), {"elbow": kind}, multi_turn) == ()
    assert "tau" not in changes or check_log_fully(log(**changes), {"elbow": kind}) == ()


def test_a_joint_without_a_kind_is_refused():
    with pytest.raises(InputError, match="'elbow' has no kind"):
        check_log(log(), {"wrist": "revolute"})


def told(case: Log) -> dict[str, Note]:
    return {finding.topic: finding.message for finding in check_log_fully(case, dict.fromkeys(case.joints, "revolute"))}


@pytest.mark.parametrize("hold", [2, 4])
def test_positions_that_are_read_less_often_than_logged(hold):
    q = np.sin(2 * T)[np.arange(N) // hold * hold]
    test_log = log(q=q[:, None])
    assert channel_facts(test_log)[0].repeats == pytest.approx(1 - 1 / hold, abs=0.05)
    assert told(test_log)["stale"] == channel_notes.RepeatedPositions(channel_facts(test_log)[0].repeats, hold)


def test_a_rest_of_the_whole_arm_is_named_with_its_time():
    q = np.sin(2 * np.minimum(T, 2.5)) + np.random.default_rng(6).normal(0, 1e-6, N)
    rest = told(log(q=q[:, None]))["rest"]
    assert isinstance(rest, channel_notes.ArmAtRest)
    assert (rest.start, rest.stop) == pytest.approx((2.5, 4.0), rel=0.01)
    assert channel_facts(log(q=q[:, None]))[0].still == pytest.approx(1.5 / 4, abs=0.05)
    beside_another = np.column_stack([np.sin(2 * np.minimum(T, 2)), np.sin(2 * T)])
    assert told(Log(T, beside_another, np.cos(beside_another), ("a", "b"))) == {}


def test_the_facts_on_a_channel_are_those_put_in():
    rng = np.random.default_rng(7)
    q = np.round((np.sin(2 * T) + rng.normal(0, 2e-3, N)) / 1e-4) * 1e-4
    tau = np.round((3 * np.cos(3 * T) + rng.normal(0, 0.1, N)) / 0.05) * 0.05
    (result,) = channel_facts(log(q=q[:, None], tau=tau[:, None]))
    assert result.noise == pytest.approx(2e-3, rel=0.1)
    assert result.torque_noise == pytest.approx(0.1, rel=0.1)
    assert result.resolution == pytest.approx(1e-4)
    assert result.torque_resolution == pytest.approx(0.05)
    assert result.rms == pytest.approx(3 / np.sqrt(2), rel=0.05)
    assert np.isnan(channel_facts(log())[0].resolution)


@pytest.mark.parametrize(
    ("kind", "topic", "height"), [("revolute", "degrees", 3.0), ("prismatic", "millimetres", 30.0)]
)
def test_spikes_of_positions_are_no_other_unit(kind: str, topic: str, height: float) -> None:
    """Nine spikes of 3 rad in 2000 samples: over 20 ms they move by 150 rad/s, in 2 % of the samples."""
    rng = np.random.default_rng(3)
    q = np.sin(2 * T) + 1e-4 * rng.standard_normal(N)
    q[rng.choice(np.arange(50, N - 50, 20), 9, replace=False)] += height * rng.choice([-1, 1], 9)
    topics = {finding.topic for finding in check_log_fully(log(q=q[:, None]), {"elbow": kind})}
    assert "position spikes" in topics
    assert topic not in topics
