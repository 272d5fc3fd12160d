"""Logs from the declared channels of a recording."""

import textwrap

import numpy as np
import polars as pl
import pytest

from dynident.checks.motion_notes import LoopUnused
from dynident.models import Joint
from dynident.project import logs
from dynident.project.config import parse_config
from dynident.project.logs import read_logs
from dynident.runtime import ConfigError, InputError, Severity
from tests.project.files import npz, written

ELBOW = (Joint("elbow"),)
SLIDER = (Joint("slider", "prismatic"),)
HEAD = """
model: gallery:pendulum
time: {column: t, unit: s}
position: {elbow: {column: q, unit: rad}}
torque: {elbow: {column: tau, unit: N m}}
"""


def spacing(how: str) -> str:
    return HEAD.replace("unit: s}", f"unit: s, spacing: {how}}}")


def recording(**changes) -> str:
    """A sound CSV of 200 rows; a change is a function from the row's number to its cell."""
    cells = {
        "t": lambda k: f"{k * 0.01:.2f}",
        "q": lambda k: f"{np.sin(0.02 * k):.9f}",
        "tau": lambda k: f"{np.cos(0.03 * k):.9f}",
    } | changes
    rows = [",".join(str(cell(k)) for cell in cells.values()) for k in range(200)]
    return "\n".join([",".join(cells), *rows])


def read(folder, text: str, settings: str = "", spec: str = "", joints=ELBOW, head=HEAD):
    written(folder, "a.csv", text)
    config = parse_config(head + textwrap.dedent(settings) + f"\ntrain: [{{file: a.csv{spec}}}]\n", folder)
    return read_logs(config.train[0], config, joints)


def test_bad_samples_outside_the_window_do_not_matter(tmp_path):
    text = recording(q=lambda k: "" if k < 20 else np.sin(0.02 * k))
    assert len(read(tmp_path, text, spec=", window: [0.2, 1.5]").logs[0]) == 131


def test_rows_without_values_at_the_ends_are_left_out(tmp_path):
    text = recording(
        q=lambda k: "nan" if k < 5 or k > 180 else np.sin(0.02 * k), t=lambda k: "" if k > 190 else k * 0.01
    )
    reading = read(tmp_path, text)
    assert (reading.logs[0].t[0], len(reading.logs[0])) == (0.05, 176)
    assert reading.warnings == ("a: 24 rows at the ends left out, where columns are empty or NaN.",)
    with pytest.raises(InputError, match="'tau' is empty or NaN at line 12"):
        read(tmp_path, recording(q=lambda k: "" if k < 5 else np.sin(k), tau=lambda k: "" if k == 10 else 1))


def test_rows_without_values_are_left_out_where_gaps_may_be_split(tmp_path):
    columns = {"q": lambda k: "" if k == 50 else np.sin(0.02 * k), "tau": lambda k: "" if 100 <= k < 130 else k}
    reading = read(tmp_path, recording(**columns), "gaps: split")
    first, second = reading.logs
    assert (len(first), len(second)) == (99, 70)
    assert reading.warnings[0] == "a: 31 rows left out, where columns are empty or NaN."
    assert first.t[50] == 0.51
    with pytest.raises(InputError, match="31 such rows in all"):
        read(tmp_path, recording(**columns))


def test_rows_written_twice_are_left_out(tmp_path):
    header, *rows = recording().splitlines()
    text = "\n".join([header, *(row for k, row in enumerate(rows) for _ in range(1 + (k % 50 == 7)))])
    reading = read(tmp_path, text)
    assert len(reading.logs[0]) == 200
    assert reading.warnings == ("a: 4 rows left out as equal to the previous one, including its time.",)


def test_a_long_rest_is_warned_of_unless_it_is_left_out(tmp_path):
    text = recording(t=lambda k: k * 0.05, q=lambda k: np.sin(0.1 * max(k - 80, 0)))
    assert "the arm is at rest from 0.0 to 4.0 s" in read(tmp_path, text, "rests: keep").warnings[0]
    assert read(tmp_path, text, "rests: keep\nmin_speed: 0.01").warnings == ()
    assert read(tmp_path, text).warnings == ()


def test_samples_are_equally_spaced_where_the_stamps_only_jitter(tmp_path):
    jitter = 0.002 * np.random.default_rng(0).uniform(-1, 1, 200)
    text = recording(t=lambda k: f"{k * 0.01 + jitter[k]:.6f}")
    spaced, kept, forced = (read(tmp_path, text, head=spacing(how)) for how in ("auto", "stamps", "even"))
    np.testing.assert_allclose(np.diff(spaced.logs[0].t), 0.01, rtol=2e-3)
    assert "a: samples are taken as equally spaced, at 99.991 Hz: the steps of the stamps" in spaced.warnings[0]
    np.testing.assert_allclose(kept.logs[0].t, np.arange(200) * 0.01 + jitter, atol=1e-6)
    assert not any("equally spaced" in warning for warning in kept.warnings)
    np.testing.assert_array_equal(forced.logs[0].t, spaced.logs[0].t)
    with pytest.raises(ConfigError, match="spacing"):
        read(tmp_path, text, head=spacing("sometimes"))


def test_gaps_can_be_split(tmp_path):
    text = recording(t=lambda k: k * 0.01 + (k >= 50) + (k >= 60))
    reading = read(tmp_path, text, "gaps: split")
    assert [(log.source, len(log)) for log in reading.logs] == [("a part 1", 50), ("a part 2", 140)]
    assert reading.warnings == ("a: 10 samples are left out, in pieces between gaps too short to be smoothed.",)


def test_rows_right_after_the_previous_one_are_dropped_or_kept(tmp_path):
    """Two stamps 10 ns apart, and two that are equal."""
    text = recording(t=lambda k: (k - (k in (51, 71))) * 0.01 + (k == 51) * 1e-8)
    with pytest.raises(InputError, match="the time at line 53 is 1e-08 s after the previous one"):
        read(tmp_path, text)
    reading = read(tmp_path, text, "close_stamps: drop")
    assert len(reading.logs[0]) == 198
    assert np.diff(reading.logs[0].t).min() > 0.009
    assert reading.warnings[0].startswith(
        "a: 2 rows less than 0.0001 of the usual step after the previous one, the first at line 53"
    )
    with pytest.raises(InputError, match="at line 73 repeats"):
        read(tmp_path, text, "close_stamps: keep")
    kept = read(tmp_path, recording(t=lambda k: k * 0.01 + (k == 51) * (1e-8 - 0.01)), "close_stamps: keep")
    assert len(kept.logs[0]) == 200


BAD_DATA = {
    "unknown column": (recording().replace("q", "pos", 1), "", ("position.elbow: no column 'q'", "'pos'")),
    "text in a cell": (recording(q=lambda k: "1.2x" if k == 9 else k), "", ("column 'q' has '1.2x' at line 11",)),
    "empty cell": (recording(q=lambda k: "" if k == 9 else k / 99), "", ("column 'q' is empty or NaN at line 11",)),
    "no common rows": (
        recording(q=lambda k: "" if k % 2 else k / 99, tau=lambda k: k if k % 2 else ""),
        "",
        ("no row has values in all columns", "Interpolate the torques"),
    ),
    "infinite": (recording(tau=lambda k: "-inf" if k > 8 else k), "", ("'tau' is -inf at line 11", "191 such")),
    "absurd": (recording(tau=lambda k: "1e300" if k == 3 else k), "", ("'tau' is 1e+300 at line 5",)),
    "no time": (recording(t=lambda k: "" if k == 4 else k), "", ("'t' has no valid time at line 6",)),
    "time repeats": (recording(t=lambda k: min(k, 50)), "", ("time 50 s at line 53 repeats (149 such",)),
    "close": (
        recording(t=lambda k: k * 0.01 + (k == 51) * (1e-8 - 0.01)),
        "",
        (
            "column 't': the time at line 53 is 1e-08 s after the previous one, where 0.01 s is usual (1 row less",
            "`close_stamps: drop`",
        ),
    ),
    "time restarts": (recording(t=lambda k: k % 100), "", ("line 102 runs backwards", "the clock was set back there")),
    "counter starts anew": (
        recording(t=lambda k: (4294966500 + 10 * k) % 2**32),
        "",
        ("runs backwards from", "(1 such row); the counter of 32 bits starts anew: add 2^32 to the rows from there on"),
    ),
    "since 1970": (
        recording(t=lambda k: f"{1714550000 + (5 - k if k in (2, 3) else k) / 100:.2f}"),
        "",
        ("the time 1714550000.02 s at line 5 runs backwards from 1714550000.03 s", "sort"),
    ),
    "gap": (recording(t=lambda k: k * 0.01 + (k > 50)), "", ("a.csv (a): a gap of 1.01 s", "gaps: split")),
    "outside": (recording(), ", window: [5, 9]", ("window 5-9 s holds 0 samples", "from 0 to 1.99 s")),
    "one row": ("t,q,tau\n0,1,2\n", "", ("holds 1 sample;",)),
    "too short": (recording(), ", window: [0, 0.1]", ("only 11 samples",)),
    "degrees": (recording(q=lambda k: 90 * np.sin(0.02 * k)), "", ("joint 'elbow'", "unit: deg", "multi_turn")),
}


@pytest.mark.parametrize(("text", "spec", "fragments"), BAD_DATA.values(), ids=BAD_DATA)
def test_bad_data_are_worded_with_file_line_and_column(tmp_path, text, spec, fragments):
    with pytest.raises(InputError) as caught:
        read(tmp_path, text, spec=spec)
    assert all(fragment in str(caught.value) for fragment in ("a.csv", *fragments)), caught.value


def test_columns_of_different_lengths_and_gaps_that_leave_nothing_are_refused(tmp_path):
    written(tmp_path, "a.npz", npz(t=np.arange(50), q=np.arange(50), tau=np.arange(49)))
    config = parse_config(HEAD + "train: [{file: a.npz}]", tmp_path)
    with pytest.raises(InputError, match="'t' has 50 rows, 'tau' has 49"):
        read_logs(config.train[0], config, ELBOW)
    with pytest.raises(InputError, match="leave no piece long enough"):
        read(tmp_path, recording(t=lambda k: k * 0.01 + k // 20), "gaps: split")


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_reference_positions_that_no_controller_uses_are_named_once(tmp_path, kind):
    q = np.sin(0.02 * np.arange(200))
    table = pl.DataFrame({"t": 0.01 * np.arange(200), "q": q, "tau": q, "q_ref": q, "tau_cmd": q, "dq_ref": q})
    getattr(table, f"write_{kind}")(tmp_path / f"a.{kind}")
    text = f"{HEAD}train: [{{file: a.{kind}}}]\nvalidation: [{{file: a.{kind}, window: [0, 1]}}]\n"
    (with_finding,) = logs.read_with_findings(parse_config(text, tmp_path), ELBOW)[1]
    assert (with_finding.message, with_finding.severity) == (LoopUnused(("q_ref",)), Severity.INFO)
    loop = "simulation: {kind: pd, joints: {elbow: {reference: {column: q_ref, unit: rad}, kp: 9, kd: 1}}}"
    assert logs.read_with_findings(parse_config(text + loop, tmp_path), ELBOW)[1] == ()


def test_samples_are_excluded_that_the_configuration_names(tmp_path):
    reading = read(tmp_path, recording(), spec=", window: [[0, 0.9], [1, 1.9]], exclude: [[null, 0.1], [0.8, 1.2]]")
    first, second = reading.logs
    np.testing.assert_allclose(first.t[first.excluded], [*np.arange(11) * 0.01, *np.arange(80, 91) * 0.01])
    np.testing.assert_allclose(second.t[second.excluded], np.arange(100, 121) * 0.01)
    assert reading.warnings == ()
    assert read(tmp_path, recording()).logs[0].excluded is None


def test_a_window_in_which_nothing_is_to_be_excluded_is_a_warning(tmp_path):
    (warning,) = read(tmp_path, recording(), spec=", window: [0, 1], exclude: [1.2, 1.3]").warnings
    assert warning == "a: there is no sample to exclude in 1.2-1.3 s; what is used runs from 0 to 1 s."
