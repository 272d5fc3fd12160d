"""Read from a saved result what a comparison needs, without the model, so that no robot file has to exist."""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from dynident.apps.compare_results.comparison import ComparedLog, ComparedResult, ExportRecord
from dynident.files.folder import is_unchanged
from dynident.files.lerobot import episode_files
from dynident.files.opener import real_path
from dynident.files.tables import is_episode
from dynident.identification import Sources
from dynident.project.config import parse_config
from dynident.project.logs import recording_of
from dynident.project.result_format import ResultTables, read_result
from dynident.project.saved import result_values
from dynident.runtime import ConfigError, InputError, Use, as_number

MAX_PARAMETER = 1e100  # of parameters: squares of larger ones are infinite, and nothing differs from them


def compared_names(paths: tuple[Path, ...]) -> tuple[str, ...]:
    """Return distinct short names of results: the folder or file name, with as much of the path as is needed."""
    names = [path.parent if path.name == "result.json" else path.with_suffix("") for path in map(real_path, paths)]
    parts = [name.parts for name in names]
    # the shortest ends of the paths that tell all results apart
    for depth in range(1, max(map(len, parts), default=1) + 1):
        short = tuple("/".join(path[-depth:]) for path in parts)
        if len(set(short)) == len(short):
            return short
    return tuple(map(str, paths))


def read_compared(path: Path, name: str) -> ComparedResult:
    """Read a result for a comparison, called by this name in it. No Python file that it names is run.

    Raises InputError where the file is no result, is older than version 1, or its values do not fit.
    """
    file = read_result(ResultTables, result_values(path), str(path))
    names = tuple(row.name for row in file.parameters)
    base = file.base_parameters.on_data
    combination, scale = np.eye(len(names)), np.ones(len(names))
    if base is not None:
        combination, scale = base.build(names, str(path)).combination, base.scale
    rows = file.parameters if base is None else base.parameters
    std = [float("inf") if row.std is None else row.std for row in rows]
    # without a stored covariance, base parameters count as uncorrelated
    full_covariance = file.errors.base_covariance
    covariance = np.diag(np.square(std)) if full_covariance is None else full_covariance
    if not all(abs(row.value) < MAX_PARAMETER for row in file.parameters) or (np.diag(covariance) < 0).any():
        raise InputError(
            f"{path}: holds a parameter of {MAX_PARAMETER:g} or more, or a variance below 0; identify again."
        )
    report = file.report or {}
    return ComparedResult(
        name,
        tuple(joint.name for joint in file.model.joints),
        names,
        np.array([row.value for row in file.parameters]),
        tuple(row.name for row in rows),
        tuple(row.unit for row in rows),
        combination,
        scale,
        covariance,
        full_covariance is not None,
        tuple(_compared_logs(file)),
        _use_of_report(report),
        tuple(_export_records(report, path)),
    )


def _compared_logs(file: ResultTables) -> list[ComparedLog]:
    logs: list[tuple[str, str]] = [(validation.name, validation.role) for validation in file.validations]
    recordings = _recording_digests(file.provenance, logs)
    errors = (validation.errors for validation in file.validations)
    return [ComparedLog(*log, error, recordings.get(log, "")) for log, error in zip(logs, errors, strict=True)]


def _recording_digests(sources: Sources, logs: list[tuple[str, str]]) -> dict[tuple[str, str], str]:
    """Return digests that identify the recordings of logs: the hashes of their files and the parts that are used."""
    configuration = sources.configuration
    hashes = {source_file.path: source_file.sha256 for source_file in sources.logs}
    if configuration is None:
        return {}
    try:
        config = parse_config(configuration.text, Path(configuration.path).parent, configuration.path, allow_code=False)
    except ConfigError:  # it names a Python file, or is of another version
        return {}
    digests = {}
    for name, role in logs:
        spec = recording_of(name, config.train if role == "train" else config.validation)
        # a recording without the hash of each file is not identified
        files = [] if spec is None else [_digest_of_file(file, hashes) for file in spec.file.values()]
        if spec is not None and all(files):
            identity = f"{files} {spec.window} {spec.exclude}"
            digests[name, role] = sha256(identity.encode()).hexdigest()
    return digests


def _digest_of_file(path: Path, hashes: Mapping[str, str]) -> str:
    """Return the hash of a file, which is stored by its real path, or those of an episode's with its number."""
    try:
        files = episode_files(path) if is_episode(path) else (path,)
    except InputError:  # a data set that is no longer there
        return ""
    digests = [hashes.get(str(real_path(file)), "") for file in files]
    return " ".join([*digests, path.name] if is_episode(path) else digests) if all(digests) else ""


def _use_of_report(report: dict[str, Any]) -> Use | None:
    """Return what a result was judged to be good for."""
    verdict = report.get("verdict")
    word = verdict.get("word") if isinstance(verdict, dict) else None
    return Use(word) if word in list(Use) else None


def _export_records(report: dict[str, Any], path: Path) -> list[ExportRecord]:
    """Return the files of the model that were written with a result; not those that were refused."""
    exports = report.get("exports")
    rows = [entry for entry in exports if isinstance(entry, dict)] if isinstance(exports, list) else []
    records = []
    for entry in rows:
        name, digest, agreement = (entry.get(key) for key in ("file", "sha256", "agreement"))
        # a damaged report may name any path: only files beside the result count
        if isinstance(name, str) and isinstance(digest, str) and Path(name).name == name:
            agreement = as_number(agreement)
            shown_agreement = None if np.isnan(agreement) else agreement
            proven = entry.get("proven") is True
            unchanged = is_unchanged(path.with_name(name), digest)
            records.append(ExportRecord(name, str(entry.get("format")), digest, proven, shown_agreement, unchanged))
    return records
