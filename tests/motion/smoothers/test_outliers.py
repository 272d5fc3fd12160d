"""A log without its outliers: positions replaced, and rows that are not kept for the fit."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Spline, TimeShifted, repair_log, smooth_log
from dynident.motion.smoothers.smoother import suspects
from dynident.runtime import ConfigError

T = np.arange(3000) * 0.002


def log(seed: int = 0) -> Log:
    rng = np.random.default_rng(seed)
    q = np.column_stack([np.sin(3 * T), np.cos(2 * T)]) + 1e-5 * rng.standard_normal((len(T), 2))
    tau = np.column_stack([4 * np.sin(3 * T), np.cos(2 * T)]) + 0.02 * rng.standard_normal((len(T), 2))
    return Log(T, q, tau, ("a", "b"))


def changed(name: str, rows: slice | list[int], joint: int, value: float, *, add: bool = False) -> Log:
    test_log = log()
    x = getattr(test_log, name).copy()
    x[rows, joint] = x[rows, joint] + value if add else value
    return Log(T, x if name == "q" else test_log.q, x if name == "tau" else test_log.tau, test_log.joints)


def test_a_spike_of_the_position_is_replaced_and_its_row_not_fitted_for_any_joint() -> None:
    clean = repair_log(changed("q", [900], 1, 0.5, add=True), torque=True)
    assert np.argwhere(~clean.keep).tolist() == [[900, 0], [900, 1]]
    assert np.abs(clean.q - log().q).max() < 1e-4
    motion = smooth_log(Spline(), clean)
    assert not motion.keep[900].any()
    assert motion.mask[900]  # no gap: a filter or a simulation runs on


def test_a_frozen_position_is_bridged() -> None:
    clean = repair_log(changed("q", slice(900, 950), 0, 0.1), torque=False)
    assert np.abs(clean.q - log().q).max() < 0.01
    assert not clean.keep[892:958].any()
    assert clean.keep[:890].all()


def test_too_many_spikes_belong_to_the_signal() -> None:
    rows = list(range(100, 2900, 20))
    case = changed("q", rows, 0, 0.5, add=True)
    assert suspects(case).position_spikes[rows, 0].mean() > 0.9
    assert np.array_equal(repair_log(case, torque=False).q, case.q)


def test_suspect_torques_are_not_kept_where_asked() -> None:
    case = changed("tau", [700], 0, 5000.0)
    clean = repair_log(case, torque=True)
    assert np.argwhere(~clean.keep).tolist() == [[700, 0]]
    assert np.array_equal(clean.tau, case.tau)
    assert repair_log(case, torque=False) is case


@pytest.mark.parametrize("samples", [9, 10])
def test_a_single_run_of_torques_at_a_limit_is_suspect_where_it_is_long(samples: int) -> None:
    tau = np.sin(np.linspace(0.0, np.pi, 200))
    start = 100 - samples // 2
    tau[start : start + samples] = 2.0
    log = Log(0.01 * np.arange(200), tau[:, None], tau[:, None], ("a",))
    assert suspects(log).torque_clipped.sum() == (samples if samples > 9 else 0)


def test_a_motion_of_other_samples_than_the_log_is_refused() -> None:
    def shorter(one: Log) -> Motion:
        full = Spline()(one)
        cut = {name: getattr(full, name)[5:] for name in ("t", "q", "dq", "ddq", "tau", "mask")}
        return replace(full, **cut)

    with pytest.raises(ConfigError, match="returns 2995 samples for 3000; return all of them"):
        smooth_log(shorter, log())
    with pytest.raises(ConfigError, match="the smoother function returns"):
        smooth_log(TimeShifted(shorter, 0.0), log())


def test_excluded_samples_are_smoothed_through_and_not_in_the_mask() -> None:
    full, gone = (smooth_log(Spline(), x) for x in (log(), log().exclude([(2.0, 2.5)])))
    np.testing.assert_array_equal(full.q, gone.q)
    left_out = (gone.t >= 2.0) & (gone.t <= 2.5)
    assert gone.mask.tolist() == (full.mask & ~left_out).tolist()
    assert full.keep is None
    assert gone.keep.tolist() == np.stack([~left_out, ~left_out], axis=1).tolist()
