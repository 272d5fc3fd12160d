"""An identification from the plain values of ``result.json``, and the model that it is of."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from dynident.estimators import Consistency, DataRank, Estimate, Pieces, Residual
from dynident.identification import (
    Calibration,
    Identifiability,
    Identification,
    Recipe,
    SmootherChoice,
    Sources,
    StandardErrors,
    tilt_base,
)
from dynident.identification.terms import TermChoice, TermTrial
from dynident.models import Joint, MassMatrixCheck, Model
from dynident.models.simulation import Failure
from dynident.project.config import has_changed, is_xacro, load_model, parse_config
from dynident.project.parts import build
from dynident.project.result_format import (
    BasePart,
    ChoicePart,
    ConsistencyPart,
    FindingPart,
    PiecesPart,
    RecipePart,
    ResultFile,
    TaggedPart,
    TermsPart,
    ValidationPart,
    WhiteningPart,
)
from dynident.project.settings import AUTO, PLAIN_TERMS, RobotSettings, robot_settings
from dynident.regression import BaseParameters, ParallelFilter, UnexcitedParameters, Whitening
from dynident.runtime import ConfigError, Finding, InputError, ModelError, Note
from dynident.runtime.families import ESTIMATORS, SMOOTHERS, TERMS
from dynident.validation import FreeRun, LogValidation

Array = NDArray[np.float64]
Noun = TypeVar("Noun")


def identification_of(
    data: dict[str, Any], source: str, model: Model | None = None, *, allow_code: bool = False
) -> Identification:
    """Return the identification in the plain values of a file; ``model`` is needed where it was made from Python.
    Python files that the values name are run only where ``allow_code``.

    Raises InputError, led by ``source``, where the values do not fit, ModelError where the model is another than it
    was, and ConfigError where a part cannot be built.
    """
    try:
        file = ResultFile.model_validate(data)
    except ValidationError as error:
        raise InputError(first_error_text(error, source)) from None
    folder = _code_folder(file.provenance, source) if allow_code else None
    recipe = _build_recipe(file.recipe, folder, source)
    if model is None:
        # results from before terms could be chosen have no choice: the plain set is meant
        has_plain_terms = file.calibration.terms is None
        model = model_of(file.provenance, source, plain_terms=has_plain_terms, allow_code=allow_code)
    # chosen terms and the tilt make the model as it was fitted, whose parameters are then compared
    choice = _build_terms(file.calibration.terms, model.joints, folder, source)
    model = model if choice is None else model.with_terms(*choice.terms)
    if isinstance(recipe.base_tilt, tuple):
        model = tilt_base(model, *recipe.base_tilt)
    check_parameters(model, [row.name for row in file.parameters], source)
    if file.model.load is not None:
        model = replace(model, load=tuple(file.model.load))
    estimate, base, mass = _build_estimate(file, model, source), file.base_parameters, file.mass_matrix
    return Identification(
        model,
        recipe,
        estimate,
        _build_errors(file, source),
        Identifiability(
            _build_base(base.on_data, model.names, source),
            _build_base(base.structural, model.names, source),
            tuple(_build_noun(UnexcitedParameters, entry, source) for entry in base.unexcited),
        ),
        tuple(_build_validation(entry, source) for entry in file.validations),
        None if mass is None else MassMatrixCheck(mass.smallest, np.array(mass.q), mass.positive),
        Calibration(
            _build_choice(file.calibration.smoother, folder, source),
            file.calibration.time_offset,
            file.calibration.base_tilt,
            file.calibration.prior_strength,
            choice,
        ),
        file.provenance,
        (
            *(_build_noun(Note, entry, source) for entry in file.warnings),
            *(_build_finding(entry, source) for entry in file.findings),
        ),
    )


def _build_pieces(part: PiecesPart | None) -> Pieces | None:
    if part is None:
        return None
    arrays = (np.array(getattr(part, name)) for name in ("begins", "ends", "rows", "torque", "residual"))
    return Pieces(tuple(part.recording), *arrays)


def model_of(sources: Sources, source: str, *, plain_terms: bool = True, allow_code: bool = False) -> Model:
    """Return the model of a configuration, or of a robot file alone, which must be as it was.

    Where a robot file is gone, its text in the result is used. ``plain_terms`` tells that no terms were chosen:
    the plain set then stands for terms left to the logs, as in versions that knew no choice. Raises InputError
    where there is neither, ModelError where the model's file is gone or has changed.
    """
    configuration, robot = sources.configuration, sources.model
    is_gone = robot is not None and bool(robot.text) and not os.path.exists(robot.path)
    if robot is not None and not is_gone and has_changed(robot):
        raise ModelError(
            f"{robot.path}: has changed since {source} was identified with it, so that its parameters may mean "
            "something else. Put the old file back, or identify again."
        )
    # the stored text of a xacro file is already expanded: reading the file would run a program
    text = robot.text if robot is not None and (is_gone or is_xacro(Path(robot.path))) else None
    if configuration is not None:
        folder = Path(configuration.path).parent
        config = parse_config(configuration.text, folder, f"{source}, its configuration", allow_code=allow_code)
        return load_model(
            replace_auto_terms(config.model) if plain_terms else config.model, folder, text, allow_code=allow_code
        )
    if robot is not None:
        settings = robot_settings(robot.path) or robot.path
        return load_model(replace_auto_terms(settings) if plain_terms else settings, text=text, allow_code=allow_code)
    raise InputError(f"{source}: was made from Python, without a configuration; give its model: load(path, model).")


def replace_auto_terms(spec: str | RobotSettings) -> str | RobotSettings:
    """Return the settings of a model with the plain set in place of terms that are chosen."""
    if not isinstance(spec, RobotSettings):
        return spec
    terms = [(term,) if term != AUTO else PLAIN_TERMS for term in spec.terms]
    return spec.model_copy(update={"terms": tuple(chain.from_iterable(terms))})


def check_parameters(model: Model, names: Sequence[str], source: str) -> None:
    """Raise ModelError unless the parameters of a result are those of the model."""
    if tuple(names) != model.names:
        odd = next(iter(set(names) ^ set(model.names)), "")
        raise ModelError(f"{source}: its parameters are not those of the model ({odd!r}); identify again.")


def _build_estimate(file: ResultFile, model: Model, source: str) -> Estimate:
    part, value = file.estimate, np.array([row.value for row in file.parameters])
    if not np.isfinite(value).all():
        raise InputError(f"{source}: a parameter has no value; identify again.")
    p, residual = len(value), part.residual
    weights = None if residual.weights is None else np.array(residual.weights)
    provenances = tuple(row.provenance for row in file.parameters if row.provenance is not None)
    return Estimate(
        model.parameters,
        value,
        _read_matrix(part.covariance, (p, p), "estimate.covariance", source),
        DataRank(part.rank, part.condition),
        Residual(
            np.array(residual.sigma),
            residual.samples,
            weights,
            pieces=_build_pieces(residual.pieces),
            whitening=_build_whitening(residual.whitening, len(residual.sigma), source),
            correlated=residual.correlated,
        ),
        tuple(_build_noun(Note, note, source) for note in part.notes),
        provenances if len(provenances) == p else (),
        _build_consistency(part.consistency, p, source),
        None if part.interval is None else _read_matrix(part.interval, (p, 2), "estimate.interval", source),
        None if part.information is None else _read_matrix(part.information, (p, p), "estimate.information", source),
    )


def _build_whitening(part: WhiteningPart | None, joints: int, source: str) -> Whitening | None:
    if part is None:
        return None
    where = "estimate.residual.whitening"
    covariance = _read_matrix(part.covariance, (joints, joints), f"{where}.covariance", source)
    try:
        return Whitening(tuple(np.array(row) for row in part.coefficients), covariance)
    except ConfigError as error:
        raise InputError(f"{source}: {where}: {error}") from error


def _build_consistency(part: ConsistencyPart | None, p: int, source: str) -> Consistency | None:
    if part is None:
        return None
    free = part.unconstrained
    value = None if free is None else _read_matrix([free], (1, p), "estimate.consistency.unconstrained", source)[0]
    return Consistency(part.eigenvalues, part.costs, value)


def _build_errors(file: ResultFile, source: str) -> StandardErrors:
    rows, base, identifiability = file.parameters, file.base_parameters.on_data, file.base_parameters
    base_rows = [] if base is None else base.parameters
    # without base parameters, the covariance is that of the standard ones
    r, n = len(rows) if base is None else len(base_rows), len(file.model.joints)
    return StandardErrors(
        np.array([row.std for row in rows]),
        np.array([row.std_independent for row in rows]),
        None if base is None else _complete_column([row.std for row in base_rows]),
        None if base is None else _complete_column([row.std_independent for row in base_rows]),
        _optional_matrix(identifiability.covariance, (r, r), "base_parameters.covariance", source),
        _optional_matrix(identifiability.by_joint, (r, n), "base_parameters.by_joint", source),
        None
        if identifiability.shares is None
        else _read_matrix([identifiability.shares], (1, n), "base_parameters.shares", source)[0],
        _optional_matrix(identifiability.by_load, (r, n), "base_parameters.by_load", source),
    )


def _optional_matrix(rows: list[list[float]] | None, shape: tuple[int, int], where: str, source: str) -> Array | None:
    return None if rows is None else _read_matrix(rows, shape, where, source)


def _complete_column(values: list[float | None]) -> Array | None:
    present = [value for value in values if value is not None]
    return np.array(present, dtype=float) if len(present) == len(values) else None


def _build_recipe(part: RecipePart, folder: Path | None, source: str) -> Recipe:
    filter_part = part.filter
    return Recipe(
        build(SMOOTHERS, part.smoother.model_dump(), f"{source}: recipe.smoother", folder),
        build(ESTIMATORS, part.estimator.model_dump(), f"{source}: recipe.estimator", folder),
        None if filter_part is None else ParallelFilter(filter_part.decimate, filter_part.cutoff, filter_part.order),
        part.min_speed,
        part.time_offset,
        part.base_tilt,
        part.restart,
        part.outliers,
        part.rests,
    )


def _code_folder(sources: Sources, source: str) -> Path:
    """Return where the relative names of Python files start."""
    return Path(source if sources.configuration is None else sources.configuration.path).parent


def _build_choice(part: ChoicePart | None, folder: Path | None, source: str) -> SmootherChoice | None:
    if part is None:
        return None
    where = f"{source}: calibration.smoother"
    candidates = tuple(
        build(SMOOTHERS, candidate.smoother.model_dump(), where, folder) for candidate in part.candidates
    )
    if not 0 <= part.chosen < len(candidates):
        raise InputError(f"{where}.chosen is {part.chosen}, but there are {len(candidates)} candidates.")
    return SmootherChoice(candidates[part.chosen], candidates, tuple(candidate.error for candidate in part.candidates))


def _build_terms(
    part: TermsPart | None, joints: tuple[Joint, ...], folder: Path | None, source: str
) -> TermChoice | None:
    if part is None:
        return None
    where = f"{source}: calibration.terms"
    terms = tuple(build(TERMS, entry.model_dump(), where, folder, joints=joints) for entry in part.chosen)
    trials = tuple(
        TermTrial(**vars(entry) | {"settings": tuple(map(_hashable_setting, entry.settings.items()))})
        for entry in part.trials
    )
    return TermChoice(part.joints, terms, trials, part.before, part.after, part.min_speed, part.load)


def _hashable_setting(setting: tuple[str, Any]) -> tuple[str, Any]:
    name, value = setting
    return name, tuple(value) if isinstance(value, list) else value


def _build_base(part: BasePart | None, names: tuple[str, ...], source: str) -> BaseParameters | None:
    if part is None:
        return None
    index, rows = {name: k for k, name in enumerate(names)}, part.parameters
    combination = np.zeros((len(rows), len(names)))
    try:
        for k, row in enumerate(rows):
            for name, coefficient in row.combination.items():
                combination[k, index[name]] = coefficient
        leads = tuple(index[row.lead] for row in rows)
    except KeyError as error:
        raise InputError(f"{source}: base_parameters: the model has no parameter {error}.") from None
    scale = np.array(part.scale)
    return BaseParameters(names, len(rows), np.array(part.singular_values), leads, combination, scale)


def _build_validation(part: ValidationPart, source: str) -> LogValidation:
    run_part = part.free_run
    free_run = (
        None
        if run_part is None
        else FreeRun(
            part.name,
            run_part.joints,
            run_part.driver,
            run_part.restart,
            run_part.relative_error,
            run_part.motion_error,
            run_part.rms,
            run_part.torque_error,
            None if run_part.failure is None else _build_noun(Failure, run_part.failure, source),
        )
    )
    return LogValidation(part.name, part.role, part.errors, part.residuals, free_run, None, part.floors)


def _build_finding(part: FindingPart, source: str) -> Finding:
    message = _build_noun(Note, part.message, source)
    return Finding(message, part.joint, source=part.source, link=part.link, severity=part.severity)


def _build_noun(base: type[Noun], part: TaggedPart, source: str) -> Noun:
    """Return the dataclass of a kind: ``base``, or one of the classes derived from it."""
    # only known subclasses: a file must not make anything else be built
    classes = {cls.__name__: cls for cls in (base, *_subclasses(base))}
    if part.kind not in classes:
        raise InputError(f"{source}: {part.kind!r} is no kind of {base.__name__} that is known; identify again.")
    values = {key: value for key, value in part.model_dump().items() if key != "kind"}
    try:
        noun: Noun = TypeAdapter(classes[part.kind]).validate_python(values)
    except ValidationError as error:
        raise InputError(first_error_text(error, f"{source}: {part.kind}")) from None
    return noun


def _subclasses(base: type[Noun]) -> list[type[Noun]]:
    return [cls for direct in base.__subclasses__() for cls in (direct, *_subclasses(direct))]


def _read_matrix(rows: Sequence[Sequence[float]], shape: tuple[int, int], where: str, source: str) -> Array:
    if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
        raise InputError(f"{source}: {where} has not the shape {shape}; identify again.")
    return np.array(rows, dtype=float).reshape(shape)


def first_error_text(error: ValidationError, source: str) -> str:
    """Return the first thing that is wrong in a file, and where it is."""
    details = error.errors()[0]
    place = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in details["loc"]).lstrip(".")
    return f"{source}: {place or 'it'}: {details['msg'][:1].lower()}{details['msg'][1:]}; identify again."
