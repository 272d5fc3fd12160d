"""What identification makes of a model whose terms are left to the data."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from dynident.checks import with_findings
from dynident.estimators import LeastSquares, PhysicallyConsistent
from dynident.identification import Recipe, calibration, identify
from dynident.identification.calibration import with_plain_terms
from dynident.identification.terms import NotChosen
from dynident.models import Model
from dynident.models.friction import Dahl, Viscous
from dynident.motion.log import Log
from dynident.runtime import ConfigError
from tests.identification.terms import simulated
from tests.identification.terms.simulated import FEW, bodies, recorded


@pytest.fixture(autouse=True)
def few_kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few kinds of terms to choose from, which is quicker."""
    monkeypatch.setattr(calibration, "library_kinds", lambda: FEW)


def log(seed: int, source: str) -> Log:
    motion = recorded(simulated.dahl, seed, rows=2500)
    return Log(motion.t, motion.q, motion.tau, motion.joints, source)


def test_the_plain_set_is_added_where_it_lacks() -> None:
    names = with_plain_terms(Model((bodies(), Viscous(bodies().joints, on=("j2",))))).names
    assert [name for name in names if name.startswith(("Ia", "Fv", "Fc", "off"))] == [
        "Fv_j2", "Ia_j1", "Ia_j2", "Ia_j3", "Fv_j1", "Fv_j3", "Fc_j1", "Fc_j2", "Fc_j3",
        "offset_j1", "offset_j2", "offset_j3",
    ]  # fmt: skip


def test_identification_holds_the_choice_and_its_model_the_terms() -> None:
    """Bounds of parameters that are not chosen are ignored, and that is said."""
    bounds = {"Fv_j1": (0.5, None), "Fc_j1": (None, 2.0), "fore.mass": (0.1, 5.0)}
    recipe = Recipe(estimator=PhysicallyConsistent(bounds=bounds), terms="auto")
    result = identify(Model((bodies(),)), [log(1, "train")], [log(5, "other")], recipe)
    assert "Fc_j1" not in result.model.names
    assert [warning for warning in result.warnings if isinstance(warning, NotChosen)] == [NotChosen(("Fc_j1",))]
    assert result.recipe.estimator.named == ("Fv_j1", "fore.mass")  # type: ignore[attr-defined]
    assert result.estimate.value[result.model.names.index("Fv_j1")] >= 0.5 - 1e-9
    choice = result.calibration.terms
    assert result.recipe.terms is None
    assert "Dahl" in {type(term).__name__ for term in result.model.terms}
    assert result.model.terms[1:] == choice.terms
    before = identify(Model((bodies(),)).with_terms(Viscous(bodies().joints)), [log(1, "train")], [log(5, "other")])
    error = [x.validations[1].errors.relative_error for x in (result, before)]
    assert error[0] < 0.5 * error[1]


def test_a_second_round_finds_the_offset_that_the_plain_set_hides() -> None:
    """With the plain set alone it is found to be 0."""
    motion, delayed = recorded(simulated.wide, 1, rows=2000), 0.003
    t = motion.t
    q = CubicSpline(t, motion.q)(t[10:] - delayed) + 1e-5 * np.random.default_rng(5).standard_normal((len(t) - 10, 3))
    recipe = Recipe(estimator=LeastSquares(), terms="auto", time_offset="estimate")
    result = identify(Model((bodies(),)), [Log(t[10:], q, motion.tau[10:], motion.joints, "train")], recipe=recipe)
    offset = result.calibration.time_offset
    assert abs(offset.seconds - delayed) < 3 * offset.std < delayed


def test_the_checks_take_terms_that_remember_and_were_named() -> None:
    model = Model((bodies(), Dahl(bodies().joints, length=0.01)))
    logs, recipe = {"train": {"train": log(1, "train")}, "validation": {}}, Recipe(terms="auto")
    result = with_findings(identify(model, logs["train"], recipe=recipe), model, logs, recipe)
    assert not [finding for finding in result.findings if isinstance(finding.message, str)]  # what a stage failed with


def test_other_words_are_refused() -> None:
    with pytest.raises(ConfigError, match="terms is 'all'; it must be 'auto' or None"):
        Recipe(terms="all")  # type: ignore[arg-type]
