"""``dynident bound``: what it prints and writes, its options, and how it says what is wrong."""

import json
from pathlib import Path

import pytest

from tests.cli.commands import configure, refuse, succeed, write_log

KEYS = {
    "name", "alone", "value", "unit", "std", "relative", "fit", "position_share", "inflation", "partner", "correlation"
}  # fmt: skip


@pytest.fixture
def config(tmp_path: Path) -> Path:
    write_log(tmp_path)
    return configure(tmp_path)


def test_table_numbers_and_report(config: Path, tmp_path: Path) -> None:
    done = succeed("bound", config, "--out", tmp_path / "out", "--json", tmp_path / "numbers.json")
    *others, last = done.output.splitlines()
    assert len(others) < 12
    assert last.startswith("4 of 4 base parameters can be known")
    done = succeed("bound", config, "--out", tmp_path / "out", "--json", tmp_path / "numbers.json", "-v")
    for word in ("M", "Fv", "Fc", "torque x 10", "+1 bit", "4 x record", "limited by", "position noise", "report.html"):
        assert word in done.output
    content = json.loads((tmp_path / "numbers.json").read_text())
    assert content == json.loads((tmp_path / "out" / "bound.json").read_text())
    assert content.keys() == {"parameters", "noise", "samples", "findings", "warnings", "provenance"}
    assert {x["name"] for x in content["parameters"]} == {"M", "Fv", "Fc", "offset"}
    for case in content["parameters"]:
        assert case.keys() == KEYS
        assert case["std"].keys() == {"now", "bit", "torque", "twice", "longer"}
        assert case["std"]["longer"] == pytest.approx(case["std"]["now"] / 2)
        assert case["std"]["bit"] <= case["std"]["now"] * (1 + 1e-9)
    assert content["noise"]["q"]["slider"] == pytest.approx(1e-5, rel=0.15)
    assert content["noise"]["sensor"]["slider"] == pytest.approx(0.01, rel=0.5)
    assert content["provenance"]["configuration"]["text"] == config.read_text()
    page = (tmp_path / "out" / "report.html").read_text()
    assert "http://" not in page.split("<script>")[0]
    assert page.count("<figure>") == 2


def test_given_noise_scales_the_bound(config: Path, tmp_path: Path) -> None:
    """Both noises ten times as large: so is every standard deviation."""
    stds = []
    for q, tau in ((1e-5, 0.01), (1e-4, 0.1)):
        given = ("--sigma-q", q, "--sigma-tau", f"slider={tau}")
        succeed("bound", config, *given, "--json", tmp_path / "numbers.json")
        content = json.loads((tmp_path / "numbers.json").read_text())
        assert content["noise"]["from"] == {"positions": "as given", "torques": "as given"}
        stds.append([x["std"]["now"] for x in content["parameters"]])
    assert stds[1] == pytest.approx([10 * x for x in stds[0]], rel=1e-6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--sigma-q", "tiny"), "--sigma-q tiny: give a number in SI units, or joint=number."),
        (("--sigma-q", "slidr=1e-5"), "sigma_q: there is no joint 'slidr'; did you mean 'slider'?"),
        (("--sigma-tau", "0"), "sigma_tau of slider is 0.0; give a positive number"),
        (("--sigma-tau", "1", "--sigma-tau", "slider=2"), "--sigma-tau is given 2 times"),
    ],
)
def test_wrong_options(config: Path, tmp_path: Path, options: tuple[str, ...], words: str) -> None:
    refuse("bound", config, *options, "--json", tmp_path / "numbers.json", says=words)
    assert not (tmp_path / "numbers.json").exists()
