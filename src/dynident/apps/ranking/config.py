"""The smoothers and estimators that are compared, and names that tell them apart."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields, is_dataclass
from itertools import chain, count
from typing import Annotated, Any

from dynident.estimators import Estimator, LinearEstimator, PhysicallyConsistent
from dynident.models import Model
from dynident.motion.smoothers import Smoother
from dynident.project.fields import SHORT_LIST, Name, Number, Section
from dynident.project.parts import PartReader, build_part
from dynident.project.settings import Config
from dynident.runtime import ConfigError, choices
from dynident.runtime.families import ESTIMATORS, SMOOTHERS, PartFamily, settings_type

CONSISTENT = "consistent"
NAME_JOINER = "+"  # between "consistent" and what it makes consistent
MAX_NAME_LENGTH = 40  # letters of a name


class CompareSettings(Section):
    """Parts to compare, each a kind or the settings of one; None: all that apply, with their default settings.

    ``truth`` are the true values of parameters by name, or the file that has them.
    """

    smoothers: Annotated[tuple[Annotated[Any, PartReader(SMOOTHERS, plain=True)], ...], SHORT_LIST] | None = None
    estimators: Annotated[tuple[Annotated[Any, PartReader(ESTIMATORS, plain=True)], ...], SHORT_LIST] | None = None
    truth: Mapping[Name, Number] | Name | None = None


@dataclass(frozen=True, eq=False)
class Candidate:
    """A smoother or estimator that takes part, by a short ``name``.

    There are several ``parts`` where a smoother is to be chosen; ``is_configured`` where it is that of the
    configuration. ``settings`` are its values as text.
    """

    name: str
    parts: tuple[Any, ...]
    settings: str
    is_configured: bool = False

    @property
    def part(self) -> Any:
        """The part, or the first of those to choose from."""
        return self.parts[0]


@dataclass(frozen=True)
class Combination:
    """A smoother with an estimator, by their names; ``is_configured`` where it is that of the configuration."""

    smoother: str
    estimator: str
    is_configured: bool = False

    @property
    def name(self) -> str:
        """Both names."""
        return f"{self.smoother} / {self.estimator}"

    @property
    def shown_names(self) -> tuple[str, str]:
        """The names as shown: a line may be broken at a plus sign."""
        return self.smoother, self.estimator.replace("+", " + ")

    def __str__(self) -> str:
        return " with ".join(self.shown_names)


def smoother_candidates(config: Config, requested: Sequence[str | Smoother] | None = None) -> tuple[Candidate, ...]:
    """Return the configured smoother, then the ``requested`` ones: parts, or kinds with their default settings.

    For None these are the ones in the section ``compare`` of the configuration, or else all. Raises ConfigError
    for a kind that is unknown or needs settings.
    """
    listed = None if config.compare is None else config.compare.smoothers
    selection = requested if requested is not None else listed
    default_smoother = Config.model_fields["smoother"].get_default(call_default_factory=True)
    if selection is None:
        specs = _default_parts(SMOOTHERS, default_smoother)
    else:
        specs = (_resolve_part(SMOOTHERS, spec, default_smoother) for spec in selection)
    return _distinct_candidates(SMOOTHERS, config.smoother, specs, default_smoother)


def estimator_candidates(
    config: Config, model: Model, requested: Sequence[str | Estimator] | None = None
) -> tuple[Candidate, ...]:
    """Return the configured estimator, then those that are ``requested``, as ``smoother_candidates`` does.

    By default these are all estimators; where the ``model`` has bodies, each linear one also consistent with physics.
    """
    listed = None if config.compare is None else config.compare.estimators
    selection = requested if requested is not None else listed
    specs: list[Any] = list(_default_parts(ESTIMATORS))
    if selection is not None:
        specs = [_resolve_part(ESTIMATORS, spec) for spec in selection]
    elif any(parameter.body for parameter in model.parameters):
        linear = [estimator for estimator in specs if isinstance(estimator, LinearEstimator)]
        specs += [PhysicallyConsistent(fit=estimator) for estimator in linear]
    else:
        specs = [estimator for estimator in specs if not isinstance(estimator, PhysicallyConsistent)]
    return _distinct_candidates(ESTIMATORS, config.estimator, specs)


def _default_parts(family: PartFamily, default_part: Any = None) -> Iterator[Any]:
    """Yield a part of each kind that needs no settings."""
    for kind in family.kinds():
        try:
            yield _build_kind(family, kind, default_part)
        except ConfigError:  # needs settings, or is of a package that cannot be loaded
            continue


def _build_kind(family: PartFamily, kind: str, default_part: Any = None) -> Any:
    if default_part is not None and kind == _describe_parts(family, default_part)[0]["kind"]:
        return default_part
    try:
        return family.get(kind, f"{family.name}s")()
    except TypeError as error:
        raise ConfigError(
            f"{family.name}s: {kind!r} needs settings; give them in the section `compare` of the configuration."
        ) from error


def _resolve_part(family: PartFamily, spec: Any, default_part: Any = None) -> Any:
    """Return a part, or its settings, as given, by its kind, or by "consistent+KIND"."""
    if isinstance(spec, type):  # a class of a file, named alone
        return spec()
    if not isinstance(spec, str):
        return spec
    outer, join, inner = spec.partition(NAME_JOINER)
    if family is not ESTIMATORS or not join or outer != CONSISTENT:
        return _build_kind(family, spec.strip(), default_part)
    fit: Any = _build_kind(family, inner)
    if not isinstance(fit, LinearEstimator):
        linear = [kind for kind in family.kinds() if issubclass(family.get(kind), LinearEstimator)]
        raise ConfigError(f"estimators: {inner!r} is not linear in the parameters; {choices(inner, linear)}")
    return PhysicallyConsistent(fit=fit)


def _distinct_candidates(
    family: PartFamily, configured: Any, specs: Iterable[Any], default_part: Any = None
) -> tuple[Candidate, ...]:
    """Return the candidates, the configured one first, without duplicates and with distinct names."""
    candidates: dict[str, Candidate] = {}
    names: set[str] = set()
    for spec in (configured, *specs):
        parts, plain = _build_parts(spec), _describe_parts(family, spec)
        # equal settings are the same candidate, however they were given
        settings = json.dumps(plain, sort_keys=True, default=str)
        if settings in candidates:
            continue
        base = _candidate_name(family, spec, default_part)
        # a number tells different settings with the same short name apart
        name = next(name for name in chain([base], (f"{base} ({k})" for k in count(2))) if name not in names)
        names.add(name)
        candidates[settings] = Candidate(name, parts, settings, spec is configured)
    return tuple(candidates.values())


def _build_parts(spec: Any) -> tuple[Any, ...]:
    parts = build_part(spec)
    return parts if isinstance(parts, tuple) else (parts,)


def _describe_parts(family: PartFamily, spec: Any) -> list[dict[str, Any]]:
    """Return kinds and settings as plain values, or the ``repr`` of a part that has none."""
    descriptions = []
    for part in _build_parts(spec):
        try:
            descriptions.append(family.describe(part))
        except ConfigError:
            descriptions.append({"kind": family.kind_of(part), "settings": repr(part)})
    return descriptions


def _candidate_name(family: PartFamily, spec: Any, default_part: Any) -> str:
    """Return the kind, with the settings that differ from the default."""
    part = _build_parts(spec)[0]
    kind = family.kind_of(part).rpartition(":")[2]
    settings_class = settings_type(type(part))
    settings = spec if isinstance(spec, settings_class) else settings_class.of(part)
    default = default_part if isinstance(default_part, settings_class) else None
    if default is None:
        with suppress(TypeError):  # without settings it cannot be made
            default = type(part)() if settings_class is type(part) else settings_class.of(type(part)())
    values = {setting.name: getattr(settings, setting.name) for setting in fields(settings) if setting.init}
    changed = {name: value for name, value in values.items() if value != getattr(default, name, MISSING)}
    if (fit := changed.pop("fit", None)) is not None:
        kind = f"{kind}{NAME_JOINER}{_candidate_name(family, fit, None)}"
    words = ", ".join(f"{name} {_format_setting(value)}" for name, value in changed.items())
    text = f"{kind} ({words})" if words else kind
    return text if len(text) <= MAX_NAME_LENGTH else f"{text[: MAX_NAME_LENGTH - 1]}…"


def _format_setting(value: Any) -> str:
    if is_dataclass(value):
        return type(value).__name__
    return f"{value:g}" if isinstance(value, float) else str(value)
