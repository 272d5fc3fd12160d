"""The command ``dynident compare``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from dynident.cli import main
from tests.apps.ranking.made import make_project


def run_command(*words: str | Path) -> tuple[int, str]:
    done = CliRunner().invoke(main, ["compare", *map(str, words)])
    return done.exit_code, done.output


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The configuration of a slider."""
    return make_project(tmp_path_factory.mktemp("slider"))


def test_a_comparison_is_printed_and_written(project: Path, tmp_path: Path) -> None:
    out, numbers = tmp_path / "out", tmp_path / "numbers.json"
    few = ("--smoothers", "difference", "--estimators", "least_squares", "--folds", "0", "--workers", "1")
    code, said = run_command(project, *few, "--out", out, "--json", numbers)
    assert code == 0, said
    assert len(said.splitlines()) <= 12
    assert "predicts the torque best: mean joint error" in said.splitlines()[-1]
    assert "yours" in said
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
    code, said = run_command(project, *words, "--workers", "1")
    assert code != 0
    assert message in " ".join(said.split())


def test_where_nothing_has_an_estimate_the_command_fails(project: Path) -> None:
    made = Path(__file__).parents[1] / "apps" / "ranking" / "made.py"
    config = project.with_name("raising.yaml")
    config.write_text(project.read_text() + f"estimator: {{ kind: '{made}:Raising' }}\n")
    code, said = run_command(config, "--smoothers", "spline", "--estimators", f"{'least_squares'}", "--workers", "1",
                             "--folds", "0")  # fmt: skip
    assert code == 0, said
    section = "compare: { smoothers: [], estimators: [] }\n"
    config.write_text(config.read_text() + section)
    code, said = run_command(config, "--workers", "1", "--folds", "0")
    assert code == 1
    assert "no combination has an estimate" in said
