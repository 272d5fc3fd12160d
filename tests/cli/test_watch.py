"""``dynident watch``: what it prints, of a file and of standard input, and what it refuses."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from dynident.cli import main
from tests.cli.commands import refuse, run, succeed
from tests.project.watched import SETTINGS, result, rows


@pytest.fixture(scope="module")
def slider(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return result(tmp_path_factory.mktemp("slider"))


def test_a_file_is_watched_to_its_end(slider: Path, tmp_path: Path) -> None:
    stream = tmp_path / "stream.csv"
    stream.write_text("".join(f"{row}\n" for row in rows()))
    done = succeed("watch", slider, stream, "--once", "--out", tmp_path / "out", *SETTINGS)
    said = done.stdout.splitlines()
    assert said[0].startswith(
        "Watching: a baseline of 25 s of motion without a change first, then changes with at most one"
    )
    assert "the baseline since 0.0 s is complete" in said[1]
    assert "most likely friction of slider" in said[2]
    assert "friction of slider changed" in said[3]
    assert "+1." in said[3]
    assert said[-2].startswith("The stream has ended at 60.0 s: 1 change was found since 2")
    assert said[-1] == f"Changes: {tmp_path / 'out' / 'changes.jsonl'}"
    again = succeed("watch", slider, stream, "--once", "--out", tmp_path / "out", "--quiet", *SETTINGS)
    assert again.stdout.splitlines() == [said[-1]]


def test_a_recording_is_watched_as_the_text_of_its_rows(slider: Path, tmp_path: Path) -> None:
    names, *lines = rows()
    values = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    values[:, 0] += 1_790_000_000.0  # since 1970
    columns = dict(zip(names.split(","), values.T, strict=True))
    frame = pl.DataFrame(columns)
    frame.write_csv(tmp_path / "log.csv")
    frame.write_parquet(tmp_path / "log.parquet")
    said = {
        kind: succeed("watch", slider, tmp_path / f"log.{kind}", "--once", "--out", tmp_path / kind, *SETTINGS).stdout
        for kind in ("csv", "parquet")
    }
    texts = [said[kind].replace(f"/{kind}/", "/") for kind in said]
    assert texts[0] == texts[1]
    assert "2026-09-21 " in texts[0].splitlines()[1]
    assert "1 change was found" in texts[0]
    again = succeed("watch", slider, tmp_path / "log.parquet", "--out", tmp_path / "parquet", *SETTINGS)
    assert "is watched to its end" in again.stdout
    assert "goes on from its saved state" in again.stdout
    names_of = [json.loads(line)["event"] for line in (tmp_path / "parquet" / "changes.jsonl").read_text().splitlines()]
    assert names_of == ["BaselineKnown", "Alarm", "Changed", "Resumed"]


def test_a_watch_without_a_sample_says_that_it_has_none(slider: Path, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(f"{rows()[0]}\n")
    command = "watch", slider, tmp_path / "log.csv", "--once", "--out", tmp_path / "out", *SETTINGS
    assert "goes on from" not in run(*command).output
    assert "at the start: the watch goes on from its saved state, which has no sample yet." in run(*command).output


def test_standard_input_is_watched_as_json_lines(slider: Path) -> None:
    names, *lines = rows()
    objects = [json.dumps(dict(zip(names.split(","), map(float, row.split(",")), strict=True))) for row in lines]
    objects[3000] = "no object"
    words = ["watch", str(slider), "-", "--json", *map(str, SETTINGS)]
    done = CliRunner().invoke(main, words, input="\n".join(objects))
    assert done.exit_code == 0, done.output
    events = {x["event"]: x for x in map(json.loads, done.stdout.splitlines())}
    assert list(events) == ["BaselineKnown", "Alarm", "Changed", "BadLines"]
    assert events["BadLines"]["line"] == 3001
    assert events["BadLines"]["text"] == "no object"
    assert events["Changed"]["kind"] == "friction"
    assert events["Changed"]["joint"] == "slider"


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(0, "has ended without a sample"), (12, "within the baseline: it has 11 of 25 blocks of motion")],
)
def test_of_a_short_stream_it_is_said_that_it_is(slider: Path, tmp_path: Path, seconds: float, said: str) -> None:
    stream = tmp_path / "stream.csv"
    stream.write_text("".join(f"{row}\n" for row in rows(seconds)))
    done = succeed("watch", slider, stream, "--once", *SETTINGS)
    assert said in done.stdout


def test_what_cannot_be_watched_is_said(slider: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.csv"
    other.write_text("time,q,tau\n0,1,2\n")
    for words, said in (
        ((other,), "other.csv: no column 'force'"),
        ((tmp_path / "none.csv",), "there is no such file"),
        (
            (other, "--baseline", 10),
            "watch: baseline is 10; give a number from 100 to 1e+06, or a shorter block",
        ),
        ((other, "--false-alarms", 0), "watch: false_alarms is 0"),
        ((other, "--tolerance", -1), "watch: tolerance is -1"),
    ):
        refuse("watch", slider, *words, "--once", says=said)
