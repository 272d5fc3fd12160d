"""The identified model as files of other programs, each loaded again before it is written."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from dynident.errors import ConfigError, InputError, ModelError, choices
from dynident.export import Export, exports, relocated
from dynident.identification import Identification, Sources
from dynident.io.folder import result_folder
from dynident.io.opener import real, refuse_inputs, watched
from dynident.io.results import as_path
from dynident.io.saved import source_files

__all__ = ["export_model", "moved_to"]


def export_model(found: Identification, folder: str | Path, format: str | None = None) -> tuple[Path, ...]:  # noqa: A002
    """Write the identified model for other programs to a folder, and return the files.

    ``format`` is urdf, mjcf, yaml, numpy, or one that another package adds; None writes all that the model can be
    written as. Each is loaded again and compared before it is written. Raises ConfigError for an unknown format or
    where the robot's own file would be replaced, ModelError where the model cannot be written so.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
    >>> from tempfile import TemporaryDirectory
    >>> arm = pendulum()
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], np.arange(1001) * 0.01)
    >>> found = dy.identify(arm, dy.record(motion, 1e-4, 0.01, np.random.default_rng(0)).log)
    >>> with TemporaryDirectory() as folder:
    ...     [file.name for file in dy.export_model(found, folder)]
    ['parameters.yaml', 'model.py']
    """
    if not isinstance(found, Identification):
        raise InputError(f"export_model: a {type(found).__name__} is given; give the Identification.")
    folder = as_path(folder)
    chosen = moved_to(folder, _exported(found, format), found.provenance)
    with watched(*source_files(found.provenance)):
        refuse_inputs(*(folder / one.file for one in chosen))
        with result_folder(folder) as held:
            return held.replace({one.file: one.written.text for one in chosen if one.written is not None and one.ready})


def moved_to(folder: Path, made: Iterable[Export], sources: Sources) -> tuple[Export, ...]:
    """Return exports for a folder: in a URDF the names of meshes, relative to its own folder, lead there from this."""
    start = None if sources.model is None else real(Path(sources.model.path).parent)
    if start is None or start == real(folder):
        return tuple(made)
    try:
        way = Path(os.path.relpath(start, real(folder))).as_posix()
    except ValueError:  # another drive
        way = start.as_posix()
    return tuple(_moved(one, way) for one in made)


def _moved(one: Export, way: str) -> Export:
    if one.format != "urdf" or one.written is None:
        return one
    return replace(one, written=replace(one.written, text=relocated(one.written.text, way)))


def _exported(found: Identification, name: str | None) -> list[Export]:
    """Return the export of this format, or all where it is None; ModelError where none can be written."""
    made = exports(found)
    known = [one.format for one in made]
    if name is not None and name not in known:
        raise ConfigError(f"export_model: there is no format {name!r} of this model; {choices(name, known)}")
    chosen = [one for one in made if name in (None, one.format)]
    refused = [one for one in chosen if not one.ready]
    if refused and (name is not None or len(refused) == len(chosen)):
        raise ModelError(f"{refused[0].file}: {refused[0].refusal}")
    return chosen
