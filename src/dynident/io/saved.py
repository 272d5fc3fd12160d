"""Results to files, and read again: ``result.json``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from dynident.errors import InputError, ModelError
from dynident.identification import Identification, Sources
from dynident.io.config import parse_config
from dynident.io.fields import is_deep
from dynident.io.folder import settle
from dynident.io.logs import Reading, read_logs
from dynident.io.named_log import log_spec
from dynident.io.opener import content, keep, real, refuse_inputs, watched
from dynident.io.result_format import FORMAT, VERSION
from dynident.io.result_read import identification_of
from dynident.io.result_version_0 import is_version_0, upgraded
from dynident.io.result_write import result_data
from dynident.io.results import as_path, write_json
from dynident.models import Model

__all__ = ["load", "model_files", "read_log_like", "result_values", "save", "source_files"]

WEIGHT = 30  # memory of the content of JSON, per byte of its text


def save(found: Identification, path: str | Path, report: Mapping[str, Any] | None = None) -> Path:
    """Write a result as JSON and return the path; ``report`` is what a report adds in words.

    The file never is half written. Raises InputError where it cannot be written, ConfigError where a part has settings
    without a plain form, or where a file that was read would be replaced.
    """
    path = as_path(path)
    with watched(*source_files(found.provenance)):
        refuse_inputs(path)
        return write_json(path, result_data(found, report))


def load(path: str | Path, model: Model | None = None, *, allow_code: bool = False) -> Identification:
    """Read a result that was saved: all that ``save`` writes, to the last digit; signals of the logs are None.

    The model is built again from the configuration in the result and the model's file, which must not have changed. A
    result made from Python needs the ``model`` as it was given to ``identify``. What a result of an older version lacks
    is said by a warning ``OldResult``.

    A result that names a Python file, as the model or as a part, is refused unless ``allow_code``: reading it would run
    the file. Raises InputError where the file is no result or of a newer version, ModelError
    where the model is another than it was, ConfigError where its configuration cannot be read any more.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from dynident.models.gallery import pendulum
    >>> arm = pendulum()
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], np.arange(1001) * 0.01)
    >>> log = dy.record(motion, 1e-4, 0.01, np.random.default_rng(0)).log
    >>> found = dy.identify(arm, log)
    >>> with TemporaryDirectory() as folder:
    ...     _ = found.save(Path(folder, "result.json"))
    ...     again = dy.load(Path(folder, "result.json"), model=arm)
    >>> bool((again.estimate.value == found.estimate.value).all())
    True
    """
    if not isinstance(model, Model | None):
        raise ModelError(f"load: the model is a {type(model).__name__}; give the Model that was identified.")
    data, source = result_values(as_path(path)), str(path)
    if is_version_0(data):
        data = upgraded(data, source, allow_code=allow_code)
    if data.get("format") != FORMAT:
        raise InputError(f"{path}: is no result of `dynident identify`: it needs `format`: {FORMAT!r}.")
    if data.get("version") != VERSION:
        raise InputError(
            f"{path}: has version {data.get('version')!r}, and this dynident reads up to {VERSION}; take a newer one."
        )
    found = identification_of(data, source, model, allow_code=allow_code)
    for file in source_files(found.provenance):
        keep(file)
    return found


def read_log_like(found: Identification, text: str, *, allow_code: bool = False) -> Reading:
    """Read the recording named on a command line, as ``log_spec`` says, with the channels of a result's configuration.

    Its torques may be missing; ``allow_code`` as in ``load``. Raises the errors of ``log_spec`` and ``read_logs``, and
    InputError for a result without configuration.
    """
    given = found.provenance.configuration
    if given is None:
        raise InputError("the result was made from Python, without a configuration: predict a Log from Python, too.")
    config = parse_config(given.text, Path(given.path).parent, given.path, allow_code=allow_code)
    return read_logs(log_spec(text, config), config, found.model.joints, torque=False)


def model_files(path: Path, sources: Sources) -> tuple[str, ...]:
    """Return the files of the model that were written with the result at ``path``, and are there as they were, but for
    those in ``sources``."""
    read = source_files(sources)
    try:
        listed = json.loads(content(path, weight=WEIGHT, remember=False))["report"]["exports"]
        known = {path.with_name(one["file"]): one["sha256"] for one in listed}
        there = [file for file in known if file.is_file() and str(real(file)) not in read]
        return tuple(file.name for file in there if _hash(file) == known[file])
    except (InputError, ValueError, RecursionError, KeyError, TypeError):
        return ()  # no result, or of another version


def _hash(file: Path) -> str:
    return sha256(content(file, remember=False)).hexdigest()


def source_files(sources: Sources) -> list[str]:
    """Return the files that a result was made from: the configuration, the model's file and the recordings."""
    return [one.path for one in (sources.configuration, sources.model, *sources.logs) if one is not None]


def result_values(path: Path) -> dict[str, Any]:
    """Return the plain values of a saved result; InputError where the file is none."""
    settle(path.parent)
    text = content(path, InputError, (".json",), WEIGHT)
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not a result.json of `dynident identify` ({error}).") from error
    if not isinstance(data, dict) or is_deep(data):
        raise InputError(f"{path}: is not a result.json of `dynident identify`.")
    return data
