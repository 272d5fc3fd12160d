"""What comparing needs of a saved result: read without its model, so that no file of the robot need be there."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from dynident.errors import ConfigError, InputError, Use
from dynident.identification import ComparedLog, ComparedResult, ExportRecord, Sources
from dynident.io.config import parse_config
from dynident.io.named_log import recording_of
from dynident.io.opener import content, real
from dynident.io.result_format import FORMAT, VERSION, BasePart, ParameterPart, ResultFile
from dynident.io.result_read import wrong_values
from dynident.io.saved import result_values

__all__ = ["compared_names", "read_compared"]

Array = NDArray[np.float64]
LARGEST = 1e100  # of parameters: squares of larger ones are infinite, and nothing differs from them


def compared_names(paths: tuple[Path, ...]) -> tuple[str, ...]:
    """Return short names of results that are distinct: of the folder or file, with more of the path where need be."""
    parts = [one.parent.parts if one.name == "result.json" else one.with_suffix("").parts for one in map(real, paths)]
    for depth in range(1, max(map(len, parts), default=1) + 1):
        names = tuple("/".join(one[-depth:]) for one in parts)
        if len(set(names)) == len(names):
            return names
    return tuple(map(str, paths))


def read_compared(path: Path, name: str) -> ComparedResult:
    """Read a result for a comparison, called by this name in it. No Python file that it names is run.

    Raises InputError where the file is no result, is older than version 1, or its values do not fit.
    """
    data = result_values(path)
    if data.get("format") != FORMAT or data.get("version") != VERSION:
        raise InputError(f"{path}: is no result of this version of `dynident identify`; identify again.")
    try:
        file = ResultFile.model_validate(data)
    except ValidationError as error:
        raise InputError(wrong_values(error, str(path))) from None
    names = tuple(row.name for row in file.parameters)
    base = file.base_parameters.on_data
    combination, scale = (np.eye(len(names)), np.ones(len(names))) if base is None else _base(base, names, path)
    rows = file.parameters if base is None else base.parameters
    covariance, together = _covariance(file.base_parameters.covariance, [_std(row) for row in rows], path)
    if not all(abs(row.value) < LARGEST for row in file.parameters) or (np.diag(covariance) < 0).any():
        raise InputError(f"{path}: holds a parameter of {LARGEST:g} or more, or a variance below 0; identify again.")
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
        together,
        tuple(_logs(file)),
        _use(report),
        tuple(_exports(report, path)),
    )


def _std(row: Any) -> float:
    """Return the standard error to believe of a parameter."""
    if row.std_hac is not None and (np.isfinite(row.std_hac) or not isinstance(row, ParameterPart)):
        return float(row.std_hac)
    return float("inf") if row.std is None else float(row.std)


def _base(base: BasePart, names: tuple[str, ...], path: Path) -> tuple[Array, Array]:
    """Return the combinations (r, p) of base parameters, and the scales (p)."""
    index = {name: k for k, name in enumerate(names)}
    combination = np.zeros((len(base.parameters), len(names)))
    for k, row in enumerate(base.parameters):
        for name, coefficient in row.combination.items():
            if name not in index:
                raise InputError(f"{path}: base_parameters: there is no parameter {name!r}; identify again.")
            combination[k, index[name]] = coefficient
    if len(base.scale) != len(names):
        raise InputError(f"{path}: base_parameters.scale has {len(base.scale)} numbers; identify again.")
    return combination, np.array(base.scale)


def _covariance(rows: list[list[float]] | None, stds: list[float], path: Path) -> tuple[Array, bool]:
    """Return the covariance of the base parameters, and whether it is more than its diagonal."""
    count = len(stds)
    if rows is None:
        return np.where(np.eye(count, dtype=bool), np.square(stds), 0.0), False
    if len(rows) != count or any(len(row) != count for row in rows):
        raise InputError(f"{path}: base_parameters.covariance is not {count} by {count}; identify again.")
    return np.array(rows).reshape(count, count), True


def _logs(file: ResultFile) -> list[ComparedLog]:
    known = _recordings(file.provenance, [(one.name, one.role) for one in file.validations])
    return [
        ComparedLog(one.name, one.role, one.errors, known.get((one.name, one.role), "")) for one in file.validations
    ]


def _recordings(sources: Sources, logs: list[tuple[str, str]]) -> dict[tuple[str, str], str]:
    """Return what identifies the recordings of logs: the hashes of the files and the parts that are used."""
    given, hashes = sources.configuration, {one.path: one.sha256 for one in sources.logs}
    if given is None:
        return {}
    try:
        config = parse_config(given.text, Path(given.path).parent, given.path, allow_code=False)
    except ConfigError:  # it names a Python file, or is of another version
        return {}
    found = {}
    for name, role in logs:
        spec = recording_of(name, config.train if role == "train" else config.validation)
        files = [] if spec is None else [hashes.get(str(real(file)), "") for file in spec.file.values()]
        if spec is not None and all(files):
            words = f"{files} {spec.window} {spec.exclude}"
            found[name, role] = sha256(words.encode()).hexdigest()
    return found


def _use(report: dict[str, Any]) -> Use | None:
    """Return what a result was judged to be good for."""
    given = report.get("verdict")
    word = given.get("word") if isinstance(given, dict) else None
    return Use(word) if word in list(Use) else None


def _exports(report: dict[str, Any], path: Path) -> list[ExportRecord]:
    """Return the files of the model that were written with a result; not those that were refused."""
    given = report.get("exports")
    rows = [one for one in given if isinstance(one, dict)] if isinstance(given, list) else []
    found = []
    for one in rows:
        name, digest, agreement = (one.get(key) for key in ("file", "sha256", "agreement"))
        if isinstance(name, str) and isinstance(digest, str) and Path(name).name == name:
            known = float(agreement) if isinstance(agreement, int | float) else None
            there = _there(path.with_name(name), digest)
            found.append(ExportRecord(name, str(one.get("format")), digest, one.get("proven") is True, known, there))
    return found


def _there(file: Path, digest: str) -> bool:
    try:
        return sha256(content(file)).hexdigest() == digest
    except InputError:
        return False
