"""The identified model as files of other programs, each loaded again before it is written."""

from __future__ import annotations

from pathlib import Path

from dynident.errors import ConfigError, InputError, ModelError, choices
from dynident.export import Export, exports
from dynident.identification import Identification
from dynident.io.opener import refuse_inputs, watched
from dynident.io.results import as_path, probe_folder, write_text
from dynident.io.saved import source_files

__all__ = ["export_model"]


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
    chosen = _exported(found, format)
    with watched(*source_files(found.provenance)):
        refuse_inputs(*(folder / one.file for one in chosen))
        probe_folder(folder)
        ready = [(one.file, one.written.text) for one in chosen if one.written is not None and one.ready]
        return tuple(write_text(folder / file, text) for file, text in ready)


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
