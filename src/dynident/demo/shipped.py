"""The files of the demo arm: made from its description, shipped with the package, copied to a folder to play with."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from io import BytesIO
from pathlib import Path

from dynident.errors import InputError
from dynident.io.results import as_path, probe_folder, write_bytes

__all__ = ["demo_files", "made_files"]


def demo_files(folder: str | Path) -> Path:
    """Write the demo arm's files to a folder and return it: arm.urdf, meshes, monday.parquet, tuesday.parquet, and
    controller.yaml, the drives' gains as a configuration names them.

    A file that is there as it should be is left. Raises InputError, before anything is written, where another of the
    same name is there, or where nothing can be written.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     sorted(path.name for path in demo_files(folder).iterdir())
    ['arm.urdf', 'controller.yaml', 'meshes', 'monday.parquet', 'tuesday.parquet']
    """
    folder = as_path(folder)
    wanted = {folder / name: file.read_bytes() for name, file in _shipped()}
    absent = {path: data for path, data in wanted.items() if not os.path.lexists(path)}
    for path in wanted.keys() - absent.keys():
        if not _holds(path, wanted[path]):
            raise InputError(f"{path}: exists already, and is not the demo arm's; choose another folder.")
    for place in dict.fromkeys(path.parent for path in absent):
        probe_folder(place)
    for path, data in absent.items():
        write_bytes(path, data)
    return folder


def made_files() -> Mapping[str, bytes]:
    """Return the content of all files by name, made anew: the recordings are simulated, which takes 10 s."""
    import numpy as np

    from dynident.demo.arm import BASE, LINKS, controller, urdf
    from dynident.demo.recording import DAYS, SEED, recorded

    made = {"arm.urdf": urdf().encode(), "controller.yaml": controller().encode()}
    made |= {f"meshes/{link.name}.stl": link.shape.stl() for link in (BASE, *LINKS)}
    for k, day in enumerate(DAYS):
        buffer = BytesIO()
        table = recorded(np.random.default_rng([SEED, k]), day)
        table.write_parquet(buffer, compression="zstd", compression_level=19, statistics=False)
        made[f"{day.name}.parquet"] = buffer.getvalue()
    return made


def _holds(path: Path, data: bytes) -> bool:
    try:
        return path.is_file() and path.stat().st_size == len(data) and path.read_bytes() == data
    except OSError:  # not ours to read
        return False


def _shipped() -> Iterator[tuple[str, Traversable]]:
    """Yield the shipped files with their names in a folder."""
    place = files("dynident.demo") / "files"
    for one in sorted(place.iterdir(), key=lambda file: file.name):
        if one.is_dir():
            yield from ((f"{one.name}/{file.name}", file) for file in one.iterdir())
        else:
            yield one.name, one
