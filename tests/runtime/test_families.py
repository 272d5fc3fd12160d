"""Parts of a family: tables, descriptions that build the same part again, and entry points."""

import json
import math
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import pytest

from dynident.estimators import (
    GeneralisedLeastSquares,
    InstrumentalVariables,
    LeastSquares,
    OutputError,
    PhysicallyConsistent,
    Ridge,
    TotalLeastSquares,
)
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.models.friction import Offset, Viscous
from dynident.motion.smoothers import (
    Butterworth,
    Difference,
    FourierSeries,
    KalmanSmoother,
    SavitzkyGolay,
    Spline,
    TimeShifted,
)
from dynident.motion.splines import Constraint, Fixed
from dynident.project.parts import build, schemas, unusable
from dynident.runtime import ConfigError
from dynident.runtime.families import ESTIMATORS, SMOOTHERS, TERMS
from tests.cli.commands import succeed
from tests.laws.test_models import JOINTS, LAGRANGIANS
from tests.laws.test_models import TERMS as LAWFUL
from tests.project.parts import SAVITZKY

SMOOTHING = [  # beside those of tests/laws/test_smoothers.py
    Butterworth((2, 2, 2), (40.0, 40.0, 40.0), (0.5, 2.5)),
    Spline(Constraint(12.5), 1e-4, 3.0, 1.4),
    Spline(Constraint((10.0, 12.0))),
    Spline(Fixed(p=math.inf)),
    Spline(Fixed(p=(1.0, 2.0))),
    KalmanSmoother(sigma={"a": 1e-4, "b": 2e-5}, intensity={"a": 3.0, "b": 0.0}, ends=3.0),
    SavitzkyGolay({"a": 0.1, "b": math.inf}, 3, 1.5),
    FourierSeries(12.5, {"a": 5, "b": 0}, (0.5, 1.0)),
    TimeShifted(TimeShifted(Difference(), 0.1), 0.2),
]
ESTIMATING = [  # beside those of tests/laws/test_estimators.py
    LeastSquares(1e-9, "per_joint", 5),
    PhysicallyConsistent(fit=GeneralisedLeastSquares(5)),
    PhysicallyConsistent(total_mass=12.0, bounds={"Fv_a": (None, 3.0), "Fc_a": (0.1, math.inf)}, prior={"a.mass": 2.0}),
    PhysicallyConsistent(
        total_mass=(None, 20.0), centre_of_mass={"arm": ((0.0, 0.0, 0.0), (0.1, 0.2, 0.3))}, prior="none"
    ),
    PhysicallyConsistent(inertia=False, distance="euclidean", margin=1e-4, costs=False),
    InstrumentalVariables("lagged", 3, 0.05),
    OutputError("open", "commanded", 0.5, 7),
    MaximumLikelihood("test", 40.0, True, 1.345, profile=None, rate=None),
    Ridge({"J": 0.1}, 0.3),
    TotalLeastSquares({"J": 0.1}, torque=0.2),
]
LAWFUL_TERMS = [make() for name, make in LAWFUL.items() if name not in LAGRANGIANS]  # those take seconds
ON_JOINTS = [
    *(term for term in LAWFUL_TERMS if TERMS.kind_of(term) in TERMS.table),
    Viscous(JOINTS, on=("wrist",), names=("Fv",), values=(2.0,)),
    Offset(JOINTS, expressions=("one", "two", "three")),
]


def again(family, part, **extra):
    """Describe a part, send it through strict JSON, and build it again."""
    return build(family, json.loads(json.dumps(family.describe(part), allow_nan=False)), "part", **extra)


@pytest.mark.parametrize(
    ("family", "part"),
    [(SMOOTHERS, part) for part in SMOOTHING] + [(ESTIMATORS, part) for part in ESTIMATING],
    ids=repr,
)
def test_a_described_part_builds_itself(family, part):
    assert again(family, part) == part


@pytest.mark.parametrize("part", ON_JOINTS, ids=repr)
def test_a_described_term_builds_itself(part):
    assert again(TERMS, part, joints=JOINTS) == part


def test_every_term_is_tried_here():
    assert {TERMS.kind_of(part) for part in ON_JOINTS} == set(TERMS.table)


def test_a_value_without_a_plain_form_is_refused():
    @dataclass(frozen=True)
    class Odd:
        value: object

    with pytest.raises(ConfigError, match=r"Odd.value is a object; settings are numbers"):
        SMOOTHERS.describe(Odd(object()))


def entry(name: str, value: str, group: str) -> metadata.EntryPoint:
    return metadata.EntryPoint(name, value, group)


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A distribution that adds a smoother, and one that cannot be loaded."""
    (tmp_path / "dynident_lab.py").write_text(SAVITZKY)
    (tmp_path / "dynident_ends.py").write_text("raise SystemExit('it ends')")
    monkeypatch.syspath_prepend(tmp_path)
    result = [
        entry("polynomials", "dynident_lab:SavitzkyGolay", "dynident.smoothers"),
        entry("spline", "dynident_lab:SavitzkyGolay", "dynident.smoothers"),
        entry("lost", "dynident_lost:Smoother", "dynident.smoothers"),
        entry("ends", "dynident_ends:Smoother", "dynident.smoothers"),
        entry("silent", "dynident_lab:Silent", "dynident.smoothers"),
        entry(".lab", "dynident_lab:read", "dynident.readers"),
    ]
    real = metadata.entry_points

    def entry_points(**given: str) -> object:
        group = given.get("group", "")
        return [x for x in result if x.group == group] if group.startswith("dynident.") else real(**given)

    monkeypatch.setattr(metadata, "entry_points", entry_points)


@pytest.mark.usefixtures("lab")
def test_a_package_adds_a_part_by_an_entry_point():
    assert SMOOTHERS.kinds()[: len(SMOOTHERS.table)] == tuple(SMOOTHERS.table)
    assert set(SMOOTHERS.kinds()) == {*SMOOTHERS.table, "polynomials", "lost", "ends", "silent"}
    part = build(SMOOTHERS, {"kind": "polynomials", "width": 0.2}, "smoother")
    assert type(part).__name__ == "SavitzkyGolay"
    assert SMOOTHERS.describe(part) == {"kind": "polynomials", "width": 0.2, "order": 4}
    assert again(SMOOTHERS, part) == part
    assert SMOOTHERS.get("spline") is Spline  # no package takes the place of a part of ours
    with pytest.raises(ConfigError, match=r"smoother: 'polynomial' is not a choice; did you mean 'polynomials'"):
        build(SMOOTHERS, {"kind": "polynomial"}, "smoother")
    with pytest.raises(ConfigError, match=r"'lost' of the entry point 'dynident_lost:Smoother' cannot be loaded"):
        build(SMOOTHERS, {"kind": "lost"}, "smoother")
    with pytest.raises(ConfigError, match=r"cannot be loaded: SystemExit: it ends"):
        build(SMOOTHERS, {"kind": "ends"}, "smoother")
    with pytest.raises(ConfigError, match=r"silent is no smoother: it lacks __call__"):
        build(SMOOTHERS, {"kind": "silent"}, "smoother")


@pytest.mark.usefixtures("lab")
def test_a_schema_is_made_where_an_installed_part_cannot_be_loaded():
    result = schemas(SMOOTHERS)
    assert {"spline", "polynomials", "lost", "ends", "silent"} <= result.keys()
    assert "cannot be loaded" in result["lost"]["description"]
    assert result["lost"]["properties"] == {"kind": {"const": "lost"}}
    assert len(list(unusable(SMOOTHERS))) == 3
    done = succeed("schema")
    assert json.loads(done.stdout)["title"] == "dynident configuration"
    assert done.stderr.count("Warning: its settings are not in the schema: ") == 3
