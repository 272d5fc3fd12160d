"""The parts of docs/extending.md at work: named in a configuration by their file, from the command to the result."""

import json
import re
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
import yaml

from dynident.estimators import LeastSquares, Problem
from dynident.files.tables import DataTable, read_columns
from dynident.identification import Recipe, identify
from dynident.models import Joint
from dynident.models.lagrangian import slider
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline, strip_time_offset
from dynident.project.config import load_model, parse_config
from dynident.project.export import IdentifiedModel, Numpy, export, random_states
from dynident.project.project import build_recipe
from dynident.project.saved import load
from dynident.regression import Regression
from dynident.runtime import ConfigError, InputError
from dynident.testing.estimator import multisine_motion, truth
from dynident.validation import robust_covariance
from tests.cli.commands import succeed
from tests.robots import ARM

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"
PARTS = dict(
    zip(
        ("sg", "buffer", "creep", "huber", "raw"),
        re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.M | re.S),
        strict=True,
    )
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the parts of the page, one file each, and a robot."""
    for name, code in PARTS.items():
        (tmp_path / f"{name}.py").write_text(re.split(r"^(?:check_|np\.arange|model = )", code, flags=re.M)[0])
    (tmp_path / "arm.urdf").write_text(ARM)
    return tmp_path


def slide(folder: Path, **changes) -> Path:
    """Write a recording of the slider and a configuration for it."""
    model = slider(values=(5.0, 8.0, 3.0, 0.5))
    motion = multisine_motion(model, noise=0.01)
    rows = np.column_stack((motion.t, motion.q, motion.tau))
    np.savetxt(folder / "run.csv", rows, delimiter=",", header="t,q,f", comments="")
    config = {
        "model": "gallery:slider",
        "time": {"column": "t", "unit": "s"},
        "position": {"slider": {"column": "q", "unit": "m"}},
        "torque": {"slider": {"column": "f", "unit": "N"}},
        "train": [{"file": "run.csv"}],
        "time_offset": 0,
    } | changes
    (folder / "slide.yaml").write_text(yaml.safe_dump(config))
    return folder / "slide.yaml"


def test_a_smoother_of_a_file_identifies(folder: Path) -> None:
    path = slide(folder, smoother={"kind": "sg.py:SavitzkyGolay", "width": 0.08}, time_offset="estimate")
    out = folder / "out"
    succeed("identify", path, "--out", out)
    result = json.loads((out / "result.json").read_text())
    assert result["recipe"]["smoother"] == {
        "kind": f"{folder / 'sg.py'}:SavitzkyGolay", "width": 0.08, "order": 4,
    }  # fmt: skip
    actual = {row["name"]: row["value"] for row in result["parameters"]}
    np.testing.assert_allclose(list(actual.values()), truth(slider(values=(5.0, 8.0, 3.0, 0.5))), rtol=0.05)
    saved = load(out / "result.json", allow_code=True)
    assert repr(strip_time_offset(saved.recipe.smoothers[0])) == "SavitzkyGolay(width=0.08, order=4)"


def test_a_term_of_a_file_stands_beside_those_of_the_library(folder: Path) -> None:
    terms = ["viscous", "coulomb", {"kind": "buffer.py:Buffer", "begin": {"shoulder": 0.5}, "on": ["shoulder"]}]
    text = yaml.safe_dump(yaml.safe_load(slide(folder).read_text()) | {"model": {"file": "arm.urdf", "terms": terms}})
    model = load_model(parse_config(text, folder).model, folder)
    assert [type(term).__name__ for term in model.terms] == ["RigidBodies", "Viscous", "Coulomb", "Buffer"]
    assert model.names[-1] == "k_shoulder"
    assert model.terms[-1].constant("begin", "shoulder") == 0.5
    identified_model = IdentifiedModel(model, np.linspace(0.5, 1.5, len(model.names)))
    assert export(identified_model, Numpy(), random_states(len(model.joints), np.random.default_rng(0))).ready
    text = text.replace("begin:", "start:")
    with pytest.raises(ConfigError, match=r"model.terms\[2\]: unknown key 'start'"):
        parse_config(text, folder)


def test_a_term_of_a_file_remembers(folder: Path) -> None:
    assert len(PARTS["creep"].splitlines()) <= 40
    path = slide(folder)
    terms = ["viscous", {"kind": "creep.py:Creep", "time": 0.2}]
    text = yaml.safe_dump(yaml.safe_load(path.read_text()) | {"model": {"file": "arm.urdf", "terms": terms}})
    model = load_model(parse_config(text, folder).model, folder)
    creep = type(model.terms[-1])((Joint("slider", "prismatic"),), time=0.2)
    sliding = slider(values=(5.0, 8.0, 3.0, 0.5)).with_terms(creep)
    motion = sliding.remembering(multisine_motion(slider(values=(5.0, 8.0, 3.0, 0.5))))
    theta = np.array([5.0, 8.0, 3.0, 0.5, 40.0])
    log = Log(motion.t, motion.q, sliding.torque(**motion.states(), theta=theta), motion.joints)
    result = identify(sliding, [log], (), Recipe(Spline(sigma=1e-6)))
    np.testing.assert_allclose(result.estimate.value, theta, rtol=0.02)


def test_a_reader_of_a_package_reads(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(folder)
    real = metadata.entry_points
    mine = metadata.EntryPoint(".raw", "raw:read_raw", "dynident.readers")
    monkeypatch.setattr(
        metadata, "entry_points", lambda **given: [mine] if given["group"] == "dynident.readers" else real(**given)
    )
    np.arange(6.0).tofile(folder / "log.raw")
    table = read_columns(folder / "log.raw")
    assert isinstance(table, DataTable)
    np.testing.assert_array_equal(table.column("tau"), [2.0, 5.0])
    np.arange(5.0).tofile(folder / "log.raw")
    with pytest.raises(InputError, match=r"log.raw: is not a readable .raw file"):
        read_columns(folder / "log.raw")
    with pytest.raises(InputError, match=r"log.row: cannot be read: there is no such file; did you mean 'log.raw'"):
        read_columns(folder / "log.row")


def test_standard_errors_of_huber_are_honest_under_outliers(folder: Path) -> None:
    """5 % of outliers, 20 times as wide as the noise: the HAC errors are those of repeated runs."""
    path = slide(folder, estimator={"kind": "huber.py:Huber"})
    huber = build_recipe(parse_config(path.read_text(), folder)).estimator
    model = slider(width=1e-3, values=(5.0, 8.0, 3.0, 0.5))
    clean = multisine_motion(model, samples=800)
    rng = np.random.default_rng(0)
    values, told, plain = [], [], []
    for _ in range(120):
        noise = 0.1 * rng.standard_normal(clean.tau.shape)
        noise += np.where(rng.uniform(size=noise.shape) < 0.05, 2.0 * rng.standard_normal(noise.shape), 0.0)
        motion = type(clean)(clean.t, clean.q, clean.dq, clean.ddq, clean.tau + noise, clean.joints, clean.mask)
        regression = Regression(model, (motion,))
        result = huber(Problem(model, (motion,), regression))
        weighted = Regression(model, (motion,), weights=result.residual.sample_weights)
        covariance = robust_covariance(weighted, result.value, result.residual.weights, slopes=result.residual.slopes)
        values.append(result.value)
        told.append(np.sqrt(np.diag(covariance)))
        plain.append(LeastSquares()(Problem(model, (motion,), regression)).value)
    scatter = np.std(values, axis=0)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(told), axis=0)), scatter, rtol=0.2)
    inside = np.abs(np.array(values) - truth(model)) < 2 * np.array(told)
    assert 0.91 < inside.mean() < 0.98
    assert (scatter < 0.5 * np.std(plain, axis=0)).all()


def test_weights_of_samples_are_those_of_rows() -> None:
    """Weight zero leaves a sample out."""
    model = slider(values=(5.0, 8.0, 3.0, 0.5))
    motion = multisine_motion(model, noise=0.1)
    half = motion.select_between(stop=5.0)
    weights = (half.mask[:, None].astype(float),)
    all_rows = Regression(model, (motion,), weights=weights).triangular_factors.stack()
    some = Regression(model, (half,)).triangular_factors.stack()
    np.testing.assert_allclose(all_rows.T @ all_rows, some.T @ some, rtol=1e-9, atol=1e-9)
    with pytest.raises(ConfigError, match=r"weights have shapes"):
        Regression(model, (motion,), weights=(np.ones(3),))
