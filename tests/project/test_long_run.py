"""A recording too long for the memory, from its configuration to a result: the same as in memory, and resumed."""

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from dynident.identification import Identification, InPieces, PieceFactors, PiecePlan, Span, plan_pieces
from dynident.identification.pieces import Reducer
from dynident.project.long_recordings import long_logs, pieces_name, reduce_pieces
from dynident.project.project import read_project
from dynident.project.saved import load
from dynident.report.identification import identification_page
from dynident.runtime import InputError, progress_to
from tests.cli.commands import run

TEXT = """
model: gallery:pendulum
time: { column: t, unit: s }
position: { pivot: { column: q, unit: rad, multi_turn: true } }
torque: { pivot: { column: f, unit: N m } }
train: [{ file: day/*.parquet, name: day }]
validation: [{ file: tuesday.parquet }]
smoother: { kind: spline, sigma: 1.0e-4 }
time_offset: 0
"""
GRAVITY = 9.80665
SAMPLES = 40_000


def table(samples: int, seed: int) -> pl.DataFrame:
    """A pendulum with J = 0.0825 and h = 0.25 in motion."""
    t, rng = np.arange(samples) * 0.005, np.random.default_rng(seed)
    q = np.sin(1.3 * t) + 0.5 * np.sin(0.37 * t)
    ddq = -(1.3**2) * np.sin(1.3 * t) - 0.5 * 0.37**2 * np.sin(0.37 * t)
    tau = 0.0825 * ddq + 0.25 * GRAVITY * np.sin(q)
    noise = rng.normal(size=(2, samples))
    return pl.DataFrame({"t": t, "q": q + 1e-4 * noise[0], "f": tau + 0.02 * noise[1]})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("long")
    (made / "day").mkdir()
    full = table(SAMPLES, 0)
    for k in range(4):
        full[k * 11_000 : (k + 1) * 11_000].write_parquet(made / "day" / f"part{k}.parquet")
    table(3000, 1).write_parquet(made / "tuesday.parquet")
    (made / "robot.yaml").write_text(TEXT)
    return made


@pytest.fixture(scope="module", autouse=True)
def small() -> Iterator[None]:
    """The training is more than the memory, what else is read is not."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DYNIDENT_MEMORY", "0.004")
        yield


@pytest.fixture(scope="module")
def ready(folder: Path) -> PiecePlan:
    """What is to be done with the pieces."""
    project = read_project(folder / "robot.yaml")
    return plan_pieces(project.model, long_logs(project.config, project.model.joints), project.recipe)


@pytest.fixture(scope="module")
def identification(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Identification:
    return read_project(folder / "robot.yaml").identify(folder=tmp_path_factory.mktemp("kept"))


def test_the_result_is_that_of_the_recording_in_memory(folder: Path, identification: Identification) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DYNIDENT_MEMORY", "1")
        result = read_project(folder / "robot.yaml").identify()
    assert result.estimate.residual.pieces is None
    std = result.errors.std
    assert (np.abs(identification.estimate.value - result.estimate.value) < 1e-3 * std).all()
    assert np.allclose(identification.errors.std, std, rtol=0.7)
    assert identification.estimate.residual.samples == pytest.approx(result.estimate.residual.samples, abs=30)
    (_, held), (_, expected) = identification.validations, result.validations
    assert held.errors.relative_error == pytest.approx(expected.errors.relative_error, rel=0.02)  # is smoothed as `day`
    assert [Path(log.path).name for log in identification.provenance.logs][:4] == [f"part{k}.parquet" for k in range(4)]


def test_what_is_left_in_the_pieces_is_saved_and_reported(identification: Identification, tmp_path: Path) -> None:
    pieces = identification.estimate.residual.pieces
    assert pieces.rows.shape == (4, 1)
    assert sum(isinstance(note, InPieces) for note in identification.notes) == 1
    again = load(identification.save(tmp_path / "result.json"))
    saved = again.estimate.residual.pieces
    for name in ("begins", "ends", "rows", "torque", "residual"):
        np.testing.assert_array_equal(getattr(saved, name), getattr(pieces, name))
    page = identification_page(identification)
    assert "The whole recording" in page
    assert "all 40,000 samples" in page


@dataclass
class Counted:
    """Reduces pieces until a number of them is done, then is stopped."""

    reducer: Reducer
    stop: int = 100
    done: list[Span] = field(default_factory=list)

    def __call__(self, span: Span) -> PieceFactors:
        if len(self.done) == self.stop:
            raise KeyboardInterrupt
        self.done.append(span)
        return self.reducer(span)

    @property
    def recordings(self) -> Any:
        return self.reducer.recordings


def test_what_was_done_is_not_done_again(ready: PiecePlan, tmp_path: Path) -> None:
    first, second = Counted(ready.reducer, 3), Counted(ready.reducer)
    with pytest.raises(KeyboardInterrupt):
        reduce_pieces(replace(ready, reducer=first), tmp_path / "pieces.parquet")  # type: ignore[arg-type]
    steps: list[Any] = []
    with progress_to(steps.append):
        identification = reduce_pieces(replace(ready, reducer=second), tmp_path / "pieces.parquet")  # type: ignore[arg-type]
    assert (len(first.done), len(second.done)) == (3, 1)
    assert [(step.completed, step.total) for step in steps] == [(4, 4)]
    assert [x.factors for x in identification] == [reduce_piece.factors for reduce_piece in reduce_pieces(ready, None)]


def test_a_piece_that_fails_is_named_and_the_rest_is_kept(ready: PiecePlan, tmp_path: Path) -> None:
    second = ready.spans[1]

    def fails(span: Span) -> PieceFactors:
        if span == second:
            raise InputError("part1.parquet: column 'f' is empty.")
        return ready.reducer(span)

    fails.recordings = ready.reducer.recordings  # type: ignore[attr-defined]
    kept = tmp_path / "pieces.parquet"
    words = r"day: 1 of 4 pieces .* \(rows 10001 to 20000: .*'f' is empty.*kept in .*pieces\.parquet"
    with pytest.raises(InputError, match=words):
        reduce_pieces(replace(ready, reducer=fails), kept)  # type: ignore[arg-type]
    again = Counted(ready.reducer)
    reduce_pieces(replace(ready, reducer=again), kept)  # type: ignore[arg-type]
    assert again.done == [second]


def test_the_name_of_the_table_follows_from_all_that_its_factors_depend_on(ready: PiecePlan, folder: Path) -> None:
    recordings = ready.reducer.recordings
    name = pieces_name(ready, recordings)  # type: ignore[arg-type]
    assert name == pieces_name(ready, recordings)  # type: ignore[arg-type]
    other = [
        replace(ready, spans=ready.spans[1:]),
        replace(ready, reducer=replace(ready.reducer, without_rests=not ready.reducer.without_rests)),
        replace(ready, reducer=replace(ready.reducer, recipe=replace(ready.reducer.recipe, min_speed=0.1))),
    ]
    names = {pieces_name(x, recordings) for x in other}  # type: ignore[arg-type]
    os.utime(folder / "day" / "part1.parquet", (1, 1))
    assert len({name, *names, pieces_name(ready, recordings)}) == 5  # type: ignore[arg-type]


def test_the_command_takes_the_long_way_by_itself(folder: Path, tmp_path: Path) -> None:
    done = run("identify", folder / "robot.yaml", "--out", tmp_path / "out", "--workers", "1", "-v")
    assert done.exit_code == 0, done.output
    assert "all 40,000 samples (200 s) are fitted, in 4 pieces" in done.output
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert len(result["estimate"]["residual"]["pieces"]["begins"]) == 4
    (kept,) = (tmp_path / "out").glob("pieces-*.parquet")
    assert len(pl.read_parquet(kept)) == 4
