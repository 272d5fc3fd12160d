import io
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import rich.console

from dynident.checks import log_notes
from dynident.estimators import Consistency, DataRank, Provenance
from dynident.estimators.notes import RankDeficient, WhiteningCostly
from dynident.identification import BaseTilt, Calibration, Identifiability, StandardErrors, TimeOffset
from dynident.models import INERTIAL, Parameter
from dynident.motion.log import Log, Motion
from dynident.regression import BaseParameters, UnexcitedParameters
from dynident.report.identification import identification_notes, identification_page, identification_tables
from dynident.report.page import plotly_packed
from dynident.report.terminal import TerminalTable
from dynident.runtime import Finding, Remark
from tests.report.conftest import identification_of
from tests.report.test_page import Outline


def body(identification):
    return identification_page(identification).replace(plotly_packed(), "")


def test_seven_joints_of_long_logs_stay_below_six_megabytes():
    """Noise everywhere, so that no curve is thinner than any other; free simulations and recordings as well."""
    joints, rng = tuple(f"joint{i}" for i in range(7)), np.random.default_rng(1)
    identification = identification_of(joints, ("train", "test"))
    for log in identification.validations:
        t, (q, dq, ddq, tau) = np.arange(8000) / 1000, rng.standard_normal((4, 8000, 7))
        log.motion = Motion(t, q, dq, ddq, tau, joints, np.ones(len(t), bool), log.name)
        log.predicted_torque = tau + rng.standard_normal(tau.shape)
        log.recorded_log = Log(t, q + 0.1, tau, joints)
    each = dict.fromkeys(joints, 1.0)
    identification.runs = tuple(
        SimpleNamespace(
            name=log.name, joints=joints, driver="controller", restart=None, t=log.motion.t, q=log.motion.q + 0.1,
            measured=log.motion.q, relative_error=each, motion_error=each, rms=each, torque_error=each, failure="",
        )
        for log in identification.validations
    )  # fmt: skip
    page = body(identification)
    assert Outline(page).count("figure") == 3 + 2 * 7 * 3
    assert 2_000_000 < len(page) < 6_000_000


def test_the_page_says_whether_errors_count_those_of_the_motion_and_how_fast_the_held_out_one_is(identification, page):
    assert "They take the motion as exactly known" in page
    identification.errors = StandardErrors(2.0 * identification.estimate.std, identification.estimate.std)
    motion = identification.validations[1].motion
    identification.validations[1].motion = replace(motion, dq=3.0 * motion.dq)
    sampled = body(identification)
    assert "exactly known" not in sampled
    assert "They count the noise left in the motion, but not what the model lacks" in sampled
    assert '<th colspan="2" scope="colgroup">held out / training</th>' in sampled
    assert '<td class="number">3.0</td><td class="number">1.0</td></tr>' in sampled
    identification.estimate.information = np.eye(len(identification.estimate.names))
    assert "They count the errors of the motion, too." in body(identification)


def robot(bodies=5, basis=True):
    """An arm of two joints with ten inertial parameters per body; the last body shows nothing in the data."""
    inertial = [Parameter(f"{role}{k}", "kg", role=role, body=f"link{k}") for k in range(bodies) for role in INERTIAL]
    parameters = (*inertial, Parameter("Fv1", "N m s/rad", role="viscous"), Parameter("Fv2", "N m s/rad"))
    p = len(parameters)
    identification = identification_of()
    identification.model.parameters = parameters
    identification.errors = StandardErrors(np.full(p, 0.1), np.full(p, 0.1))
    identification.notes = (RankDeficient(42, 52, tied=(("mass1", "mass2"),) * 30),)
    vars(identification.estimate).update(
        value=np.arange(1.0, p + 1),
        std=np.full(p, 0.1),
        names=tuple(parameter.name for parameter in parameters),
        units=tuple(parameter.unit for parameter in parameters),
        notes=identification.notes,
        determined=DataRank(42, 143.7),
        provenance=(Provenance.DATA,) * (p - 1) + (Provenance.BOUND,),
        consistency=Consistency({"link0": 0.0123, "link1": 0.0}, {"inertia": 0.25, "all": 0.5}),
    )
    if basis:
        independent = tuple(range(42))
        combination = np.eye(p)[:42]
        combination[3, 50] = 2.0
        values = np.r_[np.ones(42), np.full(p - 42, 1e-12)]
        on_data = BaseParameters(identification.estimate.names, 42, values, independent, combination, np.ones(p))
        identification.errors = StandardErrors(np.full(p, 0.1), np.full(p, 0.1), np.full(42, 0.5), np.full(42, 0.5))
        identification.base = Identifiability(
            on_data, SimpleNamespace(rank=44), (UnexcitedParameters(("Izz4",), ("elbow",)),)
        )
    return identification


def printed(result):
    console = rich.console.Console(width=120, file=io.StringIO(), color_system=None)
    console.print(*map(TerminalTable, identification_tables(result)))
    return console.file.getvalue()


def test_a_robot_shows_its_base_parameters_verdicts_and_consistency():
    page = body(robot())
    assert "without constraints" not in page
    assert "The data determine 42 combinations of the 52 parameters, the base parameters, listed below." in page
    words = ("Base parameters", "42 of 52", "mz0 + 2*Fv1", "move elbow", "determined by", "at a bound", "consistency")
    for word in words:
        assert word in page, word
    assert '<td class="words">mz0 + 2*Fv1</td><td class="number">106.0</td>' in page
    assert '<button type="button">first moments</button>' in page
    assert '<td class="words">link0</td><td class="number">0.0123</td>' in page
    assert '<td class="words">inertia</td><td class="number">0.250</td>' in page


def test_a_base_parameter_that_constraints_moved_is_shown_without_them_too():
    result = robot()
    free = result.estimate.value - 0.25 * np.eye(len(result.estimate.value))[0]
    result.estimate.consistency = replace(result.estimate.consistency, unconstrained=free)
    page = body(result)
    assert page.count("without constraints</th>") == 1
    assert page.count(">0.7500</td>") == 1


def test_a_terminal_shows_of_a_large_robot_what_is_not_inertial():
    shown, notes = printed(robot()), [line.text for line in identification_notes(robot())]
    assert "Fv1" in shown
    assert "mass0" not in shown
    assert notes[0] == "50 inertial parameters are in the report."
    said = "The data determine 42 combinations of the 52 parameters, the base parameters, listed"
    assert notes[1] == f"{said} in the report."
    assert notes[2].startswith("Warning: rank 42 of 52;")
    assert notes[2].endswith("... (in full in the report)")
    assert max(map(len, notes)) < 350
    assert "mass0" in printed(robot(bodies=3, basis=False))


def test_where_the_estimator_gives_no_verdict_the_base_parameters_do():
    result = robot()
    result.estimate.provenance = ()
    result.base.on_data.combination[3, 50] = 1.0
    page = body(result)
    for name, word in (("mass0", "data"), ("mz0", "in combination"), ("Izz4", "not identifiable")):
        row = re.search(rf'<td class="words">{name}</td>.*?<td class="words">([^<]*)</td></tr>', page)
        assert row[1] == word


def test_what_the_checks_found_besides_is_said(identification):
    spikes = log_notes.TorqueSpikes(1, (3000,), (6.0,), 5000.0, True, False)
    result = [Finding(spikes, "elbow", source="swing")]
    said = "1 torque stands out by up to 5000, unlike the motion: sample 3000 (t = 6 s). It is left out of the fit."
    identification.findings = tuple(result)
    assert identification_notes(identification)[-1].text.startswith(f"Warning: swing: elbow: {said}")
    result += [Finding(Remark(f"odd {k}."), source="swing") for k in range(6)]
    identification.findings = tuple(result)
    assert identification_notes(identification)[-1].text == "Note: `dynident check` has 2 more warnings."
    page = body(identification)
    for text in ('<td class="words">swing: elbow</td>', said, "odd 5."):
        assert text in page


def test_errors_stand_beside_what_the_sensors_allow(identification, page):
    assert "noise floor" in " ".join(printed(identification).replace("─", "").split())
    assert "Over the noise floor: " in page
    identification.validations[1].errors.sensor_noise = {"shoulder": 0.01}
    identification.validations[1].floors = {}
    (_, said, *_) = identification_notes(identification)
    assert said.text.startswith("The sensors' noise is not known of elbow: the torque was filtered")


def test_a_note_that_stands_against_a_use_is_said_once(monkeypatch, identification):
    monkeypatch.setattr("dynident.report.identification.report.NAMED_REASONS", 0)
    note = WhiteningCostly("elbow", 1.3)
    identification.findings = (Finding(note),)
    identification.notes = (*identification.notes, note)
    said = [line.text for line in identification_notes(identification) if "whitened rows" in line.text]
    assert len(said) == 1


@pytest.mark.parametrize("result", [True, False])
def test_an_offset_and_a_tilt_that_were_found_are_printed(result):
    offset = TimeOffset(-0.0199 if result else 0.0, 5.0, 2.0, 1e-4)
    tilt = BaseTilt(0.0, np.deg2rad(4.9) if result else 0.0, (1e-3, 1e-3), 5.0, 2.0)
    identification = identification_of()
    identification.calibration = Calibration(time_offset=offset, base_tilt=tilt)
    text = "\n".join(line.text for line in identification_notes(identification))
    assert ("torques are stamped 20 +- 0.1 ms later than positions" in text) is result
    assert ("Note: the base is tilted by" in text and "4.9" in text and "+-" in text) is result
