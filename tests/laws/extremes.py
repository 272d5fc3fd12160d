"""Extreme values for every setting: the sections of a configuration by introspection, and what the commands do then."""

import math
from collections.abc import Iterator, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import yaml

from dynident.apps.excitation.config import ExcitationSettings
from dynident.apps.ranking.config import CompareSettings
from dynident.project import drive_settings as loops
from dynident.project import fields as channels
from dynident.project import settings
from dynident.project.fields import Section
from dynident.project.parts import section
from dynident.runtime.families import ESTIMATORS, SMOOTHERS, TERMS

URDF = """<robot name="arm"><link name="base"/>
<link name="rod"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
<joint name="slider" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="10" effort="100"/></joint></robot>
"""
NUMBERS: tuple[Any, ...] = (
    0, -1, 1, 2, 0.5, -0.0, 1e-9, -1e-9, 1e-300, 5e-324, 1e9, -1e9, 1e18, 1e100, 1e300, -1e300, 1.7e308,
    500, 100_000, 2**31, 2**63, 2**64, int("f" * 4000, 16), -int("f" * 4000, 16),
    math.nan, math.inf, -math.inf, True, False, None,
)  # fmt: skip
OTHERS: tuple[Any, ...] = (
    "", " ", "nan", "1e400", "1e-3", "no", "slider", "pos", "0x10", "\x1b[31m", "../..", "a" * 5000, "[red]{}%s",
    [], [None], [[]], {}, {"slider": None}, {"": 1}, {1: 2}, [1, 2], [0, 0, 0], ["slider"], "2024-01-01", [1] * 1000,
)  # fmt: skip

NEEDED: Mapping[str, Mapping[str, Any]] = {
    "asymmetric_coulomb": {"width": 0.1},
    "wide_coulomb": {"width": 0.5},
    "coupled_friction": {"coefficients": {"slider": 1}, "name": "m", "law": "coulomb"},
    "stribeck": {"velocity": 0.1},
    "power": {"exponent": 2},
    "ripple": {"cycles": 10},
    "load_ripple": {"cycles": 10},
    "counterbalance": {"base_arm": 0.5, "link_arm": 0.2, "angle": 3, "free_length": 0.4},
}


def wrapped(value: Any) -> Iterator[Any]:
    """A number alone, by joint, and in lists of two and three."""
    yield value
    yield {"slider": value}
    yield [value, value]
    yield [value] * 3
    yield [0, value]
    yield {"slider": [value, value]}


def write_inputs(folder: Path) -> None:
    """A short recording of a slider, or of a rod on a hinge, and the robot file of the latter."""
    (folder / "arm.urdf").write_text(URDF)
    (folder / "law.py").write_text(
        "def spring(t, q, dq, reference, stiffness=9.0):\n    return stiffness * (reference - q) - dq\n"
    )
    t = np.arange(400) * 0.01
    q, dq, ddq = 0.3 * np.sin(3 * t), 0.9 * np.cos(3 * t), -2.7 * np.sin(3 * t)
    tau = 5.0 * ddq + 8.0 * dq + 3.0 * np.sign(dq) + 0.5
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((2, 400))
    columns = {"time": t, "pos": q + 1e-5 * noise[0], "force": tau + 0.01 * noise[1], "more": q, "three": 0 * t + 3}
    quick = 0.02 * np.sin(20 * t)  # several periods in each window
    columns |= {"quick": quick + 1e-5 * noise[0], "pull": -2000.0 * quick + 3.2 * np.cos(20 * t) + 0.01 * noise[1]}
    pl.DataFrame(columns).write_csv(folder / "log.csv")


def base(robot: bool = False) -> dict[str, Any]:
    """A configuration that works."""
    metres, newtons = ("rad", "N m") if robot else ("m", "N")
    return {
        "model": {"file": "arm.urdf"} if robot else "gallery:slider",
        "time": {"column": "time", "unit": "s"},
        "position": {"slider": {"column": "pos", "unit": metres}},
        "torque": {"slider": {"column": "force", "unit": newtons}},
        "train": [{"file": "log.csv", "window": [0, 3]}],
        "validation": [{"file": "log.csv", "window": [3, 4]}],
        "smoother": {"kind": "spline"},
        "time_offset": 0,
    }


def sections() -> dict[str, tuple[type[Section], tuple[Any, ...], dict[str, Any]]]:
    """Every section of settings: its class, the place in a configuration, and a configuration that has it there."""
    plain, robot = base(), base(robot=True)
    channel = {"column": "pos", "unit": "m"}
    cascade = {"kind": "cascade", "joints": {"slider": {"reference": channel, "kp": 10, "kv": 50, "gain": 1}}}
    pd, pid = ({"kind": kind, "joints": {"slider": {"reference": channel, "kp": 9, "kd": 1}}} for kind in ("pd", "pid"))
    pid["joints"]["slider"]["ki"] = 2
    law = {"kind": "law.py:spring", "joints": {"slider": {"reference": channel}}}
    servo = {"kind": "servo", "joints": {"slider": {"command": {"column": "more", "unit": "rad"}, "kp": 9}}}
    driven = {key: value for key, value in robot.items() if key != "torque"} | {"simulation": servo}
    couplings = {"motor": {"joints": {"slider": 2.0}}}
    result: dict[str, tuple[type[Section], tuple[Any, ...], dict[str, Any]]] = {
        "": (settings.Config, (), plain),
        "time": (settings.Time, ("time",), plain),
        "position": (channels.PositionChannel, ("position", "slider"), plain),
        "torque": (channels.Channel, ("torque", "slider"), plain),
        "train": (settings.LogSpec, ("train", 0), plain),
        "model": (settings.RobotSettings, ("model",), robot),
        "coupling": (
            settings.CouplingSettings, ("model", "couplings", "motor"),
            robot | {"model": {"file": "arm.urdf", "couplings": couplings}},
        ),
        "filter": (settings.FilterSettings, ("filter",), plain | {"filter": {"decimate": 2}}),
        "restart": (
            loops.TorqueInputSettings, ("simulation",), plain | {"simulation": {"kind": "measured_torque"}},
        ),
        "cascade": (loops.CascadeSettings, ("simulation",), plain | {"simulation": cascade}),
        "drive": (loops.CascadeJoint, ("simulation", "joints", "slider"), plain | {"simulation": cascade}),
        "pd": (loops.PDSettings, ("simulation",), plain | {"simulation": pd}),
        "pd drive": (loops.PDJoint, ("simulation", "joints", "slider"), plain | {"simulation": pd}),
        "pid": (loops.PIDSettings, ("simulation",), plain | {"simulation": pid}),
        "pid drive": (loops.PIDJoint, ("simulation", "joints", "slider"), plain | {"simulation": pid}),
        "law": (loops.FunctionSettings, ("simulation",), plain | {"simulation": law}),
        "law drive": (loops.FunctionJoint, ("simulation", "joints", "slider"), plain | {"simulation": law}),
        "servo": (loops.ServoSettings, ("simulation",), driven),
        "servo drive": (loops.ServoJoint, ("simulation", "joints", "slider"), driven),
        "excitation": (ExcitationSettings, ("excitation",), plain | {"excitation": {"duration": 12}}),
        "compare": (CompareSettings, ("compare",), plain | {"compare": {"smoothers": ["spline"]}}),
        "reference": (
            channels.Angle, ("simulation", "joints", "slider", "reference"), plain | {"simulation": cascade},
        ),
    }  # fmt: skip
    for family, key in ((SMOOTHERS, "smoother"), (ESTIMATORS, "estimator")):
        for kind in family.table:
            given: dict[str, Any] = {"kind": kind}
            if kind == "time_shifted":
                given |= {"smoother": {"kind": "spline"}, "time_offset": 0.01}
            if kind == "butterworth":
                given |= {"cutoffs": [10, 8, 8], "settle": [0.1, 0.1]}
            start = plain
            if kind == "fourier":
                quick, pull = {"column": "quick", "unit": "m"}, {"column": "pull", "unit": "N"}
                start = plain | {"position": {"slider": quick}, "torque": {"slider": pull}}
            if kind == "didim":
                start = plain | {"simulation": cascade}
            if kind == "consistent":
                result["consistent robot"] = (section(family, family.get(kind)), (key,), robot | {key: given})
            result[kind] = (section(family, family.get(kind)), (key,), start | {key: given})
    kinds = list(TERMS.table)
    for k, kind in enumerate(kinds):  # five of them in one model
        terms = [{"kind": other} | NEEDED.get(other, {}) for other in kinds[k % 3 :: 3]]
        config = robot | {"model": {"file": "arm.urdf", "base_tilt": "none", "terms": terms}}
        result[f"term {kind}"] = (section(TERMS, TERMS.get(kind)), ("model", "terms", k // 3), config)
    return result


def changed(config: Mapping[str, Any], place: tuple[Any, ...], name: str, value: Any) -> dict[str, Any]:
    """The configuration with one setting of the section at the place replaced."""
    out = deepcopy(dict(config))
    inside: Any = out
    for step in place:
        inside = inside[step]
    inside[name] = value
    return out


def trials() -> list[tuple[str, str, Any]]:
    """All trials: section, field, value."""
    values = [*(x for number in NUMBERS for x in wrapped(number)), *OTHERS]
    return [
        (where, name, value)
        for where, (kind, _, _) in sections().items()
        for name in kind.model_fields
        for value in values
    ]


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def _number(dumper: yaml.SafeDumper, value: int) -> yaml.ScalarNode:
    """Huge integers have no decimal text in Python; YAML reads hexadecimal ones."""
    return dumper.represent_scalar("tag:yaml.org,2002:int", hex(value) if abs(value) > 10**300 else str(value))


_Dumper.add_representer(int, _number)


def as_yaml(config: Mapping[str, Any]) -> str:
    return yaml.dump(config, Dumper=_Dumper, sort_keys=False)
