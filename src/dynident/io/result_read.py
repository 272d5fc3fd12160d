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

from dynident.checks import Topic
from dynident.errors import ConfigError, Finding, InputError, ModelError, Note
from dynident.estimators import Consistency, Determined, Estimate, Pieces, Residual
from dynident.identification import (
    Calibration,
    Choice,
    Identifiability,
    Identification,
    Recipe,
    Sources,
    StandardErrors,
    TermChoice,
    Trial,
    mounted,
)
from dynident.io.config import load_model, parse_config
from dynident.io.families import ESTIMATORS, SMOOTHERS, TERMS
from dynident.io.parts import build
from dynident.io.result_format import (
    BasePart,
    ChoicePart,
    ConsistencyPart,
    FindingPart,
    Kind,
    PiecesPart,
    RecipePart,
    ResultFile,
    TermsPart,
    ValidationPart,
    WhiteningPart,
)
from dynident.io.robot import changed, is_xacro
from dynident.io.settings import AUTO, PLAIN, RobotSettings, robot_settings
from dynident.models import Joint, MassMatrixCheck, Model
from dynident.regression import BaseParameters, ParallelFilter, UnexcitedParameters, Whitening
from dynident.simulation import Failure
from dynident.validation import FreeRun, LogValidation

__all__ = ["check_parameters", "identification_of", "model_of", "named_terms", "wrong_values"]

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
        raise InputError(wrong_values(error, source)) from None
    folder = _folder(file.provenance, source) if allow_code else None
    recipe = _recipe(file.recipe, folder, source)
    if model is None:
        named = file.calibration.terms is None
        model = model_of(file.provenance, source, named=named, allow_code=allow_code)
    choice = _terms(file.calibration.terms, model.joints, folder, source)
    model = model if choice is None else model.with_terms(*choice.terms)
    if isinstance(recipe.base_tilt, tuple):
        model = mounted(model, *recipe.base_tilt)
    check_parameters(model, [row.name for row in file.parameters], source)
    if file.model.load is not None:
        model = replace(model, load=tuple(file.model.load))
    estimate, base, mass = _estimate(file, model, source), file.base_parameters, file.mass_matrix
    return Identification(
        model,
        recipe,
        estimate,
        _errors(file, source),
        Identifiability(
            _base(base.on_data, model.names, source),
            _base(base.structural, model.names, source),
            tuple(_noun(UnexcitedParameters, one, source) for one in base.unexcited),
        ),
        tuple(_validation(one, source) for one in file.validations),
        None if mass is None else MassMatrixCheck(mass.smallest, np.array(mass.q), mass.positive),
        Calibration(
            _choice(file.calibration.smoother, folder, source),
            file.calibration.time_offset,
            file.calibration.base_tilt,
            file.calibration.prior_strength,
            choice,
        ),
        file.provenance,
        (*(_noun(Note, one, source) for one in file.warnings), *(_finding(one, source) for one in file.findings)),
    )


def _pieces(given: PiecesPart | None) -> Pieces | None:
    if given is None:
        return None
    arrays = (np.array(getattr(given, name)) for name in ("begins", "ends", "rows", "torque", "residual"))
    return Pieces(tuple(given.recording), *arrays)


def model_of(sources: Sources, source: str, *, named: bool = True, allow_code: bool = False) -> Model:
    """Return the model of a configuration, or of a robot file alone, which must be as it was.

    Where a robot file is gone, its text in the result will do. ``named`` tells that no terms were chosen: what leaves
    them out had the plain set, in versions that knew no choice. Raises InputError where there is neither, ModelError
    where the model's file is gone or has changed.
    """
    given, robot = sources.configuration, sources.model
    gone = robot is not None and bool(robot.text) and not os.path.exists(robot.path)
    if robot is not None and not gone and changed(robot):
        raise ModelError(
            f"{robot.path}: has changed since {source} was identified with it, so that its parameters may mean "
            "something else. Put the old file back, or identify again."
        )
    text = robot.text if robot is not None and (gone or is_xacro(Path(robot.path))) else None
    if given is not None:
        folder = Path(given.path).parent
        config = parse_config(given.text, folder, f"{source}, its configuration", allow_code=allow_code)
        return load_model(named_terms(config.model) if named else config.model, folder, text, allow_code=allow_code)
    if robot is not None:
        settings = robot_settings(robot.path) or robot.path
        return load_model(named_terms(settings) if named else settings, text=text, allow_code=allow_code)
    raise InputError(f"{source}: was made from Python, without a configuration; give its model: load(path, model).")


def named_terms(spec: str | RobotSettings) -> str | RobotSettings:
    """Return the settings of a model with the plain set in place of terms that are chosen."""
    if not isinstance(spec, RobotSettings):
        return spec
    terms = [(one,) if one != AUTO else PLAIN for one in spec.terms]
    return spec.model_copy(update={"terms": tuple(chain.from_iterable(terms))})


def check_parameters(model: Model, names: Sequence[str], source: str) -> None:
    """Raise ModelError unless the parameters of a result are those of the model."""
    if tuple(names) != model.names:
        odd = next(iter(set(names) ^ set(model.names)), "")
        raise ModelError(f"{source}: its parameters are not those of the model ({odd!r}); identify again.")


def _estimate(file: ResultFile, model: Model, source: str) -> Estimate:
    given, value = file.estimate, np.array([row.value for row in file.parameters])
    if not np.isfinite(value).all():
        raise InputError(f"{source}: a parameter has no value; identify again.")
    p, residual = len(value), given.residual
    weights = None if residual.weights is None else np.array(residual.weights)
    known = tuple(row.provenance for row in file.parameters if row.provenance is not None)
    return Estimate(
        model.parameters,
        value,
        _matrix(given.covariance, (p, p), "estimate.covariance", source),
        Determined(given.rank, given.condition),
        Residual(
            np.array(residual.sigma),
            residual.samples,
            weights,
            pieces=_pieces(residual.pieces),
            whitening=_whitening(residual.whitening, len(residual.sigma), source),
            correlated=residual.correlated,
        ),
        tuple(_noun(Note, one, source) for one in given.notes),
        known if len(known) == p else (),
        _consistency(given.consistency, p, source),
        None if given.interval is None else _matrix(given.interval, (p, 2), "estimate.interval", source),
        None if given.information is None else _matrix(given.information, (p, p), "estimate.information", source),
    )


def _whitening(given: WhiteningPart | None, joints: int, source: str) -> Whitening | None:
    if given is None:
        return None
    where = "estimate.residual.whitening"
    covariance = _matrix(given.covariance, (joints, joints), f"{where}.covariance", source)
    try:
        return Whitening(tuple(np.array(one) for one in given.coefficients), covariance)
    except ConfigError as error:
        raise InputError(f"{source}: {where}: {error}") from error


def _consistency(given: ConsistencyPart | None, p: int, source: str) -> Consistency | None:
    if given is None:
        return None
    free = given.unconstrained
    value = None if free is None else _matrix([free], (1, p), "estimate.consistency.unconstrained", source)[0]
    return Consistency(given.eigenvalues, given.costs, value)


def _errors(file: ResultFile, source: str) -> StandardErrors:
    rows, base, joint = file.parameters, file.base_parameters.on_data, file.base_parameters
    own = [] if base is None else base.parameters
    r, n = len(rows) if base is None else len(own), len(file.model.joints)
    return StandardErrors(
        np.array([row.std for row in rows]),
        _column([row.std_hac for row in rows]),
        None if base is None else _column([row.std for row in own]),
        None if base is None else _column([row.std_hac for row in own]),
        _known(joint.covariance, (r, r), "base_parameters.covariance", source),
        _known(joint.by_joint, (r, n), "base_parameters.by_joint", source),
        None if joint.shares is None else _matrix([joint.shares], (1, n), "base_parameters.shares", source)[0],
        _known(joint.by_load, (r, n), "base_parameters.by_load", source),
    )


def _known(rows: list[list[float]] | None, shape: tuple[int, int], where: str, source: str) -> Array | None:
    return None if rows is None else _matrix(rows, shape, where, source)


def _column(values: list[float | None]) -> Array | None:
    known = [value for value in values if value is not None]
    return np.array(known, dtype=float) if len(known) == len(values) else None


def _recipe(given: RecipePart, folder: Path | None, source: str) -> Recipe:
    one = given.filter
    return Recipe(
        build(SMOOTHERS, given.smoother.model_dump(), f"{source}: recipe.smoother", folder),
        build(ESTIMATORS, given.estimator.model_dump(), f"{source}: recipe.estimator", folder),
        None if one is None else ParallelFilter(one.decimate, one.cutoff, one.order),
        given.min_speed,
        given.time_offset,
        given.base_tilt,
        given.restart,
        given.outliers,
        given.rests,
    )


def _folder(sources: Sources, source: str) -> Path:
    """Return where the relative names of Python files start."""
    return Path(source if sources.configuration is None else sources.configuration.path).parent


def _choice(given: ChoicePart | None, folder: Path | None, source: str) -> Choice | None:
    if given is None:
        return None
    where = f"{source}: calibration.smoother"
    candidates = tuple(build(SMOOTHERS, one.smoother.model_dump(), where, folder) for one in given.candidates)
    if not 0 <= given.chosen < len(candidates):
        raise InputError(f"{where}.chosen is {given.chosen}, but there are {len(candidates)} candidates.")
    return Choice(candidates[given.chosen], candidates, tuple(one.error for one in given.candidates))


def _terms(given: TermsPart | None, joints: tuple[Joint, ...], folder: Path | None, source: str) -> TermChoice | None:
    if given is None:
        return None
    where = f"{source}: calibration.terms"
    terms = tuple(build(TERMS, one.model_dump(), where, folder, joints=joints) for one in given.chosen)
    trials = tuple(Trial(**vars(one) | {"settings": tuple(map(_pair, one.settings.items()))}) for one in given.trials)
    return TermChoice(given.joints, terms, trials, given.before, given.after, given.min_speed, given.load)


def _pair(setting: tuple[str, Any]) -> tuple[str, Any]:
    name, value = setting
    return name, tuple(value) if isinstance(value, list) else value


def _base(given: BasePart | None, names: tuple[str, ...], source: str) -> BaseParameters | None:
    if given is None:
        return None
    index, rows = {name: k for k, name in enumerate(names)}, given.parameters
    combination = np.zeros((len(rows), len(names)))
    try:
        for k, row in enumerate(rows):
            for name, coefficient in row.combination.items():
                combination[k, index[name]] = coefficient
        leads = tuple(index[row.lead] for row in rows)
    except KeyError as error:
        raise InputError(f"{source}: base_parameters: the model has no parameter {error}.") from None
    scale = np.array(given.scale)
    return BaseParameters(names, len(rows), np.array(given.singular_values), leads, combination, scale)


def _validation(given: ValidationPart, source: str) -> LogValidation:
    run = given.free_run
    made = (
        None
        if run is None
        else FreeRun(
            given.name,
            run.joints,
            run.driver,
            run.restart,
            run.relative_error,
            run.motion_error,
            run.rms,
            run.torque_error,
            None if run.failure is None else _noun(Failure, run.failure, source),
        )
    )
    return LogValidation(given.name, given.role, given.errors, given.residuals, made, None, given.floors)


def _finding(given: FindingPart, source: str) -> Finding:
    message = given.message if isinstance(given.message, str) else _noun(Note, given.message, source)
    topic = Topic(given.topic) if given.topic in list(Topic) else None  # of a later version
    return Finding(given.severity, given.joint, message, topic, given.source, given.link)


def _noun(base: type[Noun], given: Kind, source: str) -> Noun:
    """Return the noun of a kind among ``base`` and the classes made of it."""
    known = {one.__name__: one for one in (base, *_below(base))}
    if given.kind not in known:
        raise InputError(f"{source}: {given.kind!r} is no kind of {base.__name__} that is known; identify again.")
    values = {key: value for key, value in given.model_dump().items() if key != "kind"}
    try:
        made: Noun = TypeAdapter(known[given.kind]).validate_python(values)
    except ValidationError as error:
        raise InputError(wrong_values(error, f"{source}: {given.kind}")) from None
    return made


def _below(base: type[Noun]) -> list[type[Noun]]:
    return [one for below in base.__subclasses__() for one in (below, *_below(below))]


def _matrix(rows: Sequence[Sequence[float]], shape: tuple[int, int], where: str, source: str) -> Array:
    if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
        raise InputError(f"{source}: {where} has not the shape {shape}; identify again.")
    return np.array(rows, dtype=float).reshape(shape)


def wrong_values(error: ValidationError, source: str) -> str:
    """Return the first thing that is wrong in a file, and where it is."""
    first = error.errors()[0]
    place = "".join(f"[{one}]" if isinstance(one, int) else f".{one}" for one in first["loc"]).lstrip(".")
    return f"{source}: {place or 'it'}: {first['msg'][:1].lower()}{first['msg'][1:]}; identify again."
