"""Small LeRobot data sets, as its versions 2.1 and 3.0 write them."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

Array = NDArray[np.float64]
PATHS = {
    "v2.1": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
    "v3.0": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
}


def write_data_set(
    folder: Path,
    episodes: Sequence[Mapping[str, Array]],
    names: Mapping[str, Any],
    version: str = "v3.0",
    fps: float = 100.0,
    **info: Any,
) -> Path:
    """Write episodes: by feature the values (N, n), single precision; ``names`` are those of the elements."""
    frames = [_frame(values, number, fps) for number, values in enumerate(episodes)]
    features = {
        column: {"dtype": "float32", "shape": [values.shape[1]], "names": names.get(column)}
        for column, values in episodes[0].items()
    }
    features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    features["observation.images.top"] = {"dtype": "video", "shape": [480, 640, 3], "names": ["h", "w", "c"]}
    content = {"codebase_version": version, "total_episodes": len(episodes), "fps": fps, "chunks_size": 1000}
    content |= {"data_path": PATHS[version], "features": features} | info
    (folder / "meta").mkdir(parents=True, exist_ok=True)
    (folder / "meta" / "info.json").write_text(json.dumps(content))
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True, exist_ok=True)
    if version == "v2.1":
        for number, frame in enumerate(frames):
            frame.write_parquet(data / f"episode_{number:06d}.parquet")
        return folder
    pl.concat(frames).write_parquet(data / "file-000.parquet")
    table = folder / "meta" / "episodes" / "chunk-000"
    table.mkdir(parents=True, exist_ok=True)
    numbers = list(range(len(episodes)))
    places = {"episode_index": numbers, "data/chunk_index": [0] * len(numbers), "data/file_index": [0] * len(numbers)}
    pl.DataFrame(places | {"tasks": [["move"]] * len(numbers)}).write_parquet(table / "file-000.parquet")
    return folder


def _frame(values: Mapping[str, Array], number: int, fps: float) -> pl.DataFrame:
    count = len(next(iter(values.values())))
    columns = {name: pl.Series(x.tolist(), dtype=pl.Array(pl.Float32, x.shape[1])) for name, x in values.items()}
    frame = pl.Series(range(count))
    columns["timestamp"] = pl.Series(np.arange(count) / fps, dtype=pl.Float32)
    indices = {"frame_index": frame, "episode_index": 0 * frame + number, "index": frame, "task_index": 0 * frame}
    return pl.DataFrame(columns | indices)
