"""No command replaces a file that it reads, or that its configuration names, under whatever name."""

import os
import shutil
from collections.abc import Callable
from itertools import product
from pathlib import Path

import pytest

import dynident as dy
from dynident.files.opener import refuse_inputs, watch_inputs
from dynident.project.config import read_config
from dynident.runtime import ConfigError
from tests.cli.commands import configure, run, write_log

ROBOT = """<robot name="rail"><link name="wall"/><link name="cart"><inertial><mass value="5"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slider" type="prismatic"><parent link="wall"/><child link="cart"/><axis xyz="1 0 0"/>
<limit lower="-9" upper="9" effort="9" velocity="9"/></joint></robot>"""
PART = """from dataclasses import dataclass
from dynident.motion.smoothers import Difference, Smoother
@dataclass(frozen=True)
class Mine(Smoother):
    def __call__(self, log):
        return Difference()(log)
"""
MODEL = {"file": "rail.urdf", "terms": ["viscous", "coulomb", "offset"]}
CONFIGURED = ["identify.yaml", "rail.urdf", "log.csv", "val.csv", "part.py"]
FLEET = ["fleet.yaml", "identify.yaml", "rail.urdf", "part.py", "logs/rail/2026-01-01.csv"]
# what a command writes, as its last words, and the files that it reads; {} is the file, or its folder, to write
COMMANDS = {
    "init": ("init rail.urdf log.csv val.csv --force -o {}", "x.yaml", ["rail.urdf", "log.csv", "val.csv"]),
    "check": ("check identify.yaml --json {}", "x.json", CONFIGURED),
    "bound": ("bound identify.yaml --json {}", "x.json", CONFIGURED),
    "predict": ("predict out/result.json val.csv --allow-code --out {}", "x.csv", [*CONFIGURED, "out/result.json"]),
    "export": ("export out/result.json --allow-code --format yaml --out {}", "x", [*CONFIGURED, "out/result.json"]),
    **{
        f"identify {name}": ("identify identify.yaml --out {folder}", name, CONFIGURED)
        for name in ("result.json", "report.html", "parameters.yaml", "model.py", "rail.identified.urdf")
    },
    **{
        f"bound {name}": ("bound identify.yaml --out {folder}", name, CONFIGURED)
        for name in ("bound.json", "report.html")
    },
    **{
        f"excite {name}": ("excite identify.yaml --workers 1 -o {folder}", name, CONFIGURED)
        for name in ("identify.yaml", "motion.csv", "excite.json")
    },
    **{
        f"fleet {name}": ("fleet fleet.yaml --workers 1 --out {folder}", name, FLEET)
        for name in ("fleet.parquet", "report.html", "recipe.yaml", "fleet.json")
    },
    **{
        f"smooth {name}": ("smooth log.csv --time time --out {folder}", name, ["log.csv"])
        for name in ("smoothed.csv", "report.html")
    },
}
LINKS: dict[str, Callable[[Path, Path], object]] = {
    "symbolic": lambda file, name: name.symlink_to(file.resolve()),
    "hard": lambda file, name: os.link(file, name),
    "chain": lambda file, name: (os.link(file, name.with_name("between")), name.symlink_to("between")),
}


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a configuration, all that it names, and the result."""
    folder = tmp_path_factory.mktemp("kept")
    write_log(folder)
    write_log(folder, "val.csv")
    (folder / "rail.urdf").write_text(ROBOT)
    (folder / "part.py").write_text(PART)
    (folder / "logs" / "rail").mkdir(parents=True)
    shutil.copy(folder / "log.csv", folder / "logs" / "rail" / "2026-01-01.csv")
    (folder / "fleet.yaml").write_text("recipe: identify.yaml\nlogs: logs/{robot}/{date}.csv\n")
    logs = {"train": [{"file": "log.csv"}], "validation": [{"file": "val.csv"}]}
    estimator = {"kind": "least_squares"}
    done = run(
        "identify",
        configure(folder, model=MODEL, smoother={"kind": "part.py:Mine"}, estimator=estimator, **logs),
        "--out",
        folder / "out",
    )
    assert done.exit_code == 0, done.output
    return folder


@pytest.fixture
def place(identified: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(identified, tmp_path / "here")
    text = (identified / "out" / "result.json").read_text()
    (tmp_path / "here" / "out" / "result.json").write_text(text.replace(str(identified), str(tmp_path / "here")))
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "here"


def files(folder: Path) -> dict[str, bytes]:
    return {str(x.relative_to(folder)): x.read_bytes() for x in sorted(folder.rglob("*")) if x.is_file()}


@pytest.mark.parametrize(
    ("command", "link"),
    [*((command, "chain") for command in COMMANDS), *product(("check", "identify result.json"), ("symbolic", "hard"))],
)
def test_no_command_replaces_an_input_under_another_name(place: Path, command: str, link: str) -> None:
    words, name, inputs = COMMANDS[command]
    for test_input in inputs:
        new = place / "new"
        new.mkdir()
        LINKS[link](place / test_input, new / name)
        before = files(place)
        done = run(*words.format(new / name, folder=new).split())
        assert done.exit_code == 1, (test_input, done.output)
        assert "would be replaced" in done.output, (test_input, done.output)
        assert f"new/{name}" in done.output, done.output
        assert test_input.rpartition("/")[2] in done.output, done.output
        assert files(place) == before
        shutil.rmtree(new)


@pytest.mark.parametrize("spelt", ["{}", "./{}", "nowhere/../{}", "out/../{}"])
@pytest.mark.parametrize("command", [name for name, (words, *_) in COMMANDS.items() if "{}" in words])
def test_no_command_replaces_an_input_however_it_is_spelt(place: Path, command: str, spelt: str) -> None:
    words, _, inputs = COMMANDS[command]
    for test_input in inputs:
        before = files(place)
        done = run(*words.format(spelt.format(test_input)).split())
        assert done.exit_code == 1, (test_input, done.output)
        assert files(place) == before
        assert not (place / "nowhere").exists()


@pytest.mark.parametrize("name", ["result.json", "report.html"])
def test_a_configuration_with_the_name_of_a_result_is_kept(place: Path, name: str) -> None:
    (place / "identify.yaml").rename(place / name)
    before = files(place)
    done = run("identify", name, "--out", ".")
    assert done.exit_code == 1
    assert "would be replaced" in done.output
    assert files(place) == before


def test_what_was_not_read_is_replaced(place: Path) -> None:
    for words in (
        "predict out/result.json val.csv --out old.csv",
        "export out/result.json --format yaml --out old.csv",
    ):
        (place / "old.csv").write_text("old")
        done = run(*words.split(), "--out", "old.csv", "--allow-code")
        assert done.exit_code == 0, done.output
        assert (place / "old.csv").read_text() != "old"


def test_a_result_is_not_saved_over_what_it_was_made_from(place: Path) -> None:
    result = dy.load("out/result.json", allow_code=True)
    before = files(place)
    os.link("log.csv", "link.json")
    for name in ("identify.yaml", "rail.urdf", "out/../log.csv", "link.json"):
        with pytest.raises(ConfigError, match="would be replaced"):
            result.save(name)
    os.unlink("link.json")
    assert files(place) == before
    result.save("out/result.json")


def test_what_a_configuration_names_is_an_input_before_it_is_opened(place: Path) -> None:
    with watch_inputs():
        read_config("identify.yaml")
        for name in ("log.csv", "val.csv", "rail.urdf"):
            with pytest.raises(ConfigError, match="would be replaced"):
                refuse_inputs(place / name)
        refuse_inputs(place / "other.csv")
