"""Texts of configurations of a slider."""

import yaml

from dynident.models import Joint

FULL = """
model: gallery:slider
time: {column: t, unit: s}
position:
  slider: {column: qm, unit: m}
torque:
  slider: {column: vir, unit: N, gain: gtau}
train:
  - file: DATA_EMPS.mat
    window: [0, 20]
validation:
  - file: DATA_EMPS_PULSES.mat
    name: pulses
gaps: split
smoother: {kind: spline, rule: constraint, sigma: 1e-6}
estimator: {kind: least_squares, tolerance: 1e-10}
filter: {decimate: 10, cutoff: null, order: 4}
"""
SLIDER = (Joint("slider", "prismatic"),)
TWO = {
    "model": "gallery:slider",
    "time": {"rate": 100},
    "position": {"a": {"column": "q1", "unit": "rad"}, "b": {"column": "q2", "unit": "rad"}},
    "torque": {"a": {"column": "i1", "unit": "N m"}, "b": {"column": "i2", "unit": "N m"}},
    "train": [{"file": "one.csv", "window": [0, 5]}],
}


def changed(**sections) -> str:
    """The full configuration with some sections replaced, or removed where they are ... ."""
    data = yaml.safe_load(FULL) | sections
    return yaml.safe_dump({key: value for key, value in data.items() if value is not ...}, sort_keys=False)


def with_channel(**keys) -> str:
    return changed(position={"slider": {"column": "qm", "unit": "m"} | keys})


def with_train(**keys) -> str:
    return changed(train=[{"file": "a.mat"} | keys])
