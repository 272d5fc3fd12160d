"""The command ``dynident compare``."""

import json
from pathlib import Path

import pytest

from tests.apps.ranking.made import make_project
from tests.cli.commands import refuse, run, succeed


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The configuration of a slider."""
    return make_project(tmp_path_factory.mktemp("slider"))


def test_a_comparison_is_printed_and_written(project: Path, tmp_path: Path) -> None:
    out, numbers = tmp_path / "out", tmp_path / "numbers.json"
    few = ("--smoothers", "difference", "--estimators", "least_squares", "--folds", 0, "--workers", 1)
    output = succeed("compare", project, *few, "--out", out, "--json", numbers).output
    assert len(output.splitlines()) <= 12
    assert "predicts the torque best: mean joint error" in output.splitlines()[-1]
    assert "yours" in output
    assert {path.name for path in out.iterdir()} == {"report.html", "compare.json", "compare.parquet"}
    assert json.loads(numbers.read_text()) == json.loads((out / "compare.json").read_text())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--smoothers", "splin"), "did you mean 'spline'"),
        (("--estimators", ","), "no kind is given"),
        (("--truth", "nowhere.yaml"), "nowhere.yaml"),
        (("--folds", "1"), "folds = 1"),
        (("--folds", "100000"), "a number from 2 to 100"),
    ],
)
def test_wrong_words_are_refused(project: Path, words: tuple[str, ...], message: str) -> None:
    done = run("compare", project, *words, "--workers", 1)
    assert done.exit_code != 0
    assert message in " ".join(done.output.split())


def test_where_nothing_has_an_estimate_the_command_fails(project: Path) -> None:
    made = Path(__file__).parents[1] / "apps" / "ranking" / "made.py"
    config, few = project.with_name("raising.yaml"), ("--workers", 1, "--folds", 0)
    config.write_text(project.read_text() + f"estimator: {{ kind: '{made}:Raising' }}\n")
    succeed("compare", config, "--smoothers", "spline", "--estimators", "least_squares", *few)
    config.write_text(config.read_text() + "compare: { smoothers: [], estimators: [] }\n")
    refuse("compare", config, *few, says="no combination has an estimate")
