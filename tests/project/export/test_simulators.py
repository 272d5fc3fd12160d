"""Files for Drake, Isaac Lab and Pinocchio: what they hold, and that they cannot be tricked by names."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.project.config import parse_config
from dynident.project.export import Servo, export
from dynident.project.export.identified import drives
from dynident.project.export.servos import ranges, servos_of
from dynident.project.export.simulators import Drake, DrakeDirectives, IsaacLab, PinocchioFile
from dynident.runtime import DynidentError
from tests.project.export.arms import STATES, arm
from tests.robots import ARM, ARM_MJCF

FORMATS = [Drake(), DrakeDirectives(), IsaacLab(), PinocchioFile()]
SERVOS = {"shoulder": Servo(17.0, 1.5, 3.0, 0.02, 5.0)}


def identified(text=ARM, gravity=(1.0, 2.0, -9.0)):
    test_arm = arm(text, gravity=gravity)
    return replace(test_arm, std=np.full(len(test_arm.value), 0.01), servos=SERVOS)


@pytest.mark.parametrize("exporter", FORMATS, ids=lambda exporter: exporter.format)
@pytest.mark.parametrize("text", [ARM, ARM_MJCF], ids=["urdf", "mjcf"])
def test_each_file_has_the_torque_of_the_model(text, exporter):
    made = export(identified(text), exporter, STATES)
    assert made.ready, made.refusal
    assert made.proof.agreement < 1e-12
    assert not made.proof.skipped
    assert any("offset_shoulder = -0.3 N m" in line for line in made.written.left_out)
    (size,) = [note for note in made.written.notes if note.startswith("what it leaves out is")]
    # friction of 2 N m is left out by Drake, too
    assert ("0.3 N m at 'shoulder', 0.3 N at 'rail'" in size) == (exporter.format == "pinocchio")
    assert ("2 N m at 'shoulder'" in size) == exporter.format.startswith("drake")


def test_collision_meshes_that_drake_does_not_read_are_said():
    mesh = '<collision><geometry><mesh filename="{}"/></geometry></collision></link>'
    for file, is_said in (("a.STL", True), ("a.obj", False)):
        made = export(identified(ARM.replace("</link>", mesh.format(file), 1)), Drake(), STATES)
        assert any("reads no collision meshes such as a.STL" in note for note in made.written.notes) is is_said


@pytest.mark.parametrize(("offset", "is_said"), [(1e-6, False), (1e-3, True)])
def test_the_size_of_what_is_left_out_is_said_where_it_is_no_rounding(offset, is_said):
    some = identified()
    value = np.where([name.startswith("offset") for name in some.model.names], offset, some.value)
    notes = export(replace(some, value=value), PinocchioFile(), STATES).written.notes
    assert any(note.startswith("what it leaves out is") for note in notes) == is_said


@pytest.mark.parametrize("exporter", [FORMATS[0], *FORMATS[2:]], ids=lambda exporter: exporter.format)
def test_a_wrong_value_is_noticed(exporter):
    made = export(identified(), exporter, STATES)
    (reader,) = [reader for name, reader in exporter.readers.items() if name in ("dynident", "Pinocchio")][-1:]
    armature = {"drake": 'drake:rotor_inertia value="0.5"', "isaac": "'rail': 0.5", "pinocchio": "'rail': 0.5"}
    wrong = made.written.text.replace(armature[exporter.format], armature[exporter.format].replace("0.5", "0.6"), 1)
    assert wrong != made.written.text
    if exporter.format == "pinocchio":
        with pytest.raises(ValueError, match="expected is"):
            reader(wrong, identified(), STATES)
    else:
        difference = reader(wrong, identified(), STATES) - reader(made.written.text, identified(), STATES)
        np.testing.assert_allclose(difference[:, 1], 0.1 * STATES[2][:, 1], atol=1e-9)


def test_ranges_are_those_of_95_percent_and_not_below_zero():
    model = identified()
    narrow, wide = (ranges(replace(model, std=k * model.std), drives(model, armature=True)) for k in (1.0, 1e3))
    assert {"armature", "damping", "friction", "mass"} == {x.attribute for x in narrow}
    assert all(x.high - x.low == pytest.approx(2 * 1.96 * 0.01, rel=1e-4) for x in narrow)
    assert {x.low for x in wide} == {0.0}


def test_directives_weld_the_root_as_gravity_has_it():
    made = export(identified(), DrakeDirectives(), STATES)
    assert 'file: "package://dynident/robot.identified.drake.urdf"' in made.written.text
    assert any("gravity of 9.27362 m/s^2" in note for note in made.written.notes)
    (reader,) = DrakeDirectives.readers.values()
    for wrong in (made.written.text.replace("deg: [-12", "deg: [-13"), made.written.text.replace("arm::", "arm::x")):
        with pytest.raises(DynidentError, match="gravity differs"):
            reader(wrong, identified(), STATES)


def test_an_actuator_of_the_file_is_used():
    own = (
        '<transmission name="t"><joint name="shoulder"/><actuator name="m"><drake:gear_ratio value="9"/></actuator>'
        "</transmission></robot>"
    )
    made = export(identified(ARM.replace("</robot>", own)), Drake(), STATES)
    assert made.ready, made.refusal
    assert made.written.text.count("<transmission") == 3
    assert 'value="9"' not in made.written.text


CONFIG = """
model: gallery:slider
time: {{ column: t, unit: s }}
position: {{ slider: {{ column: x, unit: m }} }}
torque: {{ slider: {{ column: f, unit: N }} }}
train: [{{ file: a.csv }}]
simulation: {{ kind: {kind}, joints: {{ slider: {{ reference: {{ column: r, unit: m }}, {gains} }} }} }}
"""


@pytest.mark.parametrize(
    ("kind", "gains", "servo"),
    [
        ("pd", "kp: 20, kd: 2, gain: 3, saturation: 4", Servo(60.0, 6.0, 12.0)),
        ("cascade", "kp: 20, kv: 2", Servo(40.0, 2.0)),
        ("pid", "kp: 20, kd: 2, ki: 1, saturation: 4", Servo(limit=4.0)),
        ("pd", "kp: gain_of_file, kd: 2", Servo()),
    ],
)
def test_servos_are_those_of_the_configuration(kind, gains, servo):
    assert servos_of(parse_config(CONFIG.format(kind=kind, gains=gains))) == {"slider": servo}


def test_gears_are_those_of_motors_with_one_joint():
    text = CONFIG.format(kind="pd", gains="kp: 1, kd: 1").partition("simulation")[0]
    config = parse_config(text + "transmission: { m: { slider: 100 } }")
    assert servos_of(config) == {"slider": Servo(gear=100.0)}
