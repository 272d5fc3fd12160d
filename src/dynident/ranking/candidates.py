"""Which smoothers and estimators are compared: their names, and what tells one from another."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Any

from dynident.errors import ConfigError, choices
from dynident.estimators import Estimator, IsLinear, PhysicallyConsistent
from dynident.io.families import ESTIMATORS, SMOOTHERS, Family, settings_type
from dynident.io.parts import built
from dynident.io.settings import Config
from dynident.models import Model
from dynident.smoothers import Smoother

__all__ = ["Candidate", "Combination", "estimators_of", "smoothers_of"]

CONSISTENT = "consistent"
JOIN = "+"  # between "consistent" and what it makes consistent
LONGEST = 40  # letters of a name


@dataclass(frozen=True, eq=False)
class Candidate:
    """A smoother or estimator that takes part, by a short ``name``: the ``parts``, of which there are several where a
    smoother is to be chosen, and ``own`` where it is that of the configuration. ``settings`` are its plain values."""

    name: str
    parts: tuple[Any, ...]
    settings: str
    own: bool = False

    @property
    def part(self) -> Any:
        """The part, or the first of those to choose from."""
        return self.parts[0]


@dataclass(frozen=True)
class Combination:
    """A smoother with an estimator, by their names; ``own`` where it is that of the configuration."""

    smoother: str
    estimator: str
    own: bool = False

    @property
    def name(self) -> str:
        """Both names."""
        return f"{self.smoother} / {self.estimator}"


def smoothers_of(config: Config, wanted: Sequence[str | Smoother] | None = None) -> tuple[Candidate, ...]:
    """Return the configured smoother, then those that are ``wanted``: parts, or kinds with their default settings.

    None: those that the section ``compare`` of the configuration lists, or else all. Raises ConfigError for a kind that
    is unknown or needs settings.
    """
    listed = None if config.compare is None else config.compare.smoothers
    given = wanted if wanted is not None else listed
    usual = Config.model_fields["smoother"].get_default(call_default_factory=True)
    every = _usual(SMOOTHERS, usual) if given is None else (_read(SMOOTHERS, one, usual) for one in given)
    return _distinct(SMOOTHERS, config.smoother, every, usual)


def estimators_of(
    config: Config, model: Model, wanted: Sequence[str | Estimator] | None = None
) -> tuple[Candidate, ...]:
    """Return the configured estimator, then those that are ``wanted``, as ``smoothers_of`` does.

    Of all there are each linear one as it is and, where the ``model`` has bodies, consistent with physics.
    """
    listed = None if config.compare is None else config.compare.estimators
    given = wanted if wanted is not None else listed
    if given is not None:
        return _distinct(ESTIMATORS, config.estimator, (_read(ESTIMATORS, one) for one in given))
    every: list[Any] = list(_usual(ESTIMATORS))
    if any(one.body for one in model.parameters):
        every += [_consistent(one) for one in tuple(every) if isinstance(one, IsLinear)]
    else:
        every = [one for one in every if not isinstance(one, PhysicallyConsistent)]
    return _distinct(ESTIMATORS, config.estimator, every)


def _usual(family: Family, usual: Any = None) -> Iterator[Any]:
    """Yield a part of each kind that needs no settings."""
    for kind in family.kinds():
        try:
            yield _of_kind(family, kind, usual)
        except ConfigError:  # needs settings, or is of a package that cannot be loaded
            continue


def _of_kind(family: Family, kind: str, usual: Any = None) -> Any:
    if usual is not None and kind == _plain(family, usual)[0]["kind"]:
        return usual
    try:
        return family.get(kind, f"{family.name}s")()
    except TypeError as error:
        raise ConfigError(
            f"{family.name}s: {kind!r} needs settings; give them in the section `compare` of the configuration."
        ) from error


def _read(family: Family, given: Any, usual: Any = None) -> Any:
    """Return a part, or its settings, that is given as such, by its kind, or as "consistent+KIND"."""
    if isinstance(given, type):  # a class of a file, named alone
        return given()
    if not isinstance(given, str):
        return given
    outer, join, inner = given.partition(JOIN)
    if family is not ESTIMATORS or not join or outer != CONSISTENT:
        return _of_kind(family, given.strip(), usual)
    fit: Any = _of_kind(family, inner)
    if not isinstance(fit, IsLinear):
        linear = [kind for kind in family.kinds() if hasattr(family.get(kind), "reduced")]
        raise ConfigError(f"estimators: {inner!r} is not linear in the parameters; {choices(inner, linear)}")
    return _consistent(fit)


def _consistent(fit: Any) -> PhysicallyConsistent:
    return PhysicallyConsistent(fit=fit)


def _distinct(family: Family, own: Any, others: Iterable[Any], usual: Any = None) -> tuple[Candidate, ...]:
    """Return candidates, the configured one first; none twice, and no two of one name."""
    found: dict[str, Candidate] = {}
    names: set[str] = set()
    for given in (own, *others):
        parts, plain = _parts(given), _plain(family, given)
        settings = json.dumps(plain, sort_keys=True, default=str)
        if settings in found:
            continue
        base = name = _name(family, given, usual)
        count = 2
        while name in names:
            name, count = f"{base} ({count})", count + 1
        names.add(name)
        found[settings] = Candidate(name, parts, settings, given is own)
    return tuple(found.values())


def _parts(given: Any) -> tuple[Any, ...]:
    made = built(given)
    return made if isinstance(made, tuple) else (made,)


def _plain(family: Family, given: Any) -> list[dict[str, Any]]:
    """Return kinds and settings as plain values; of a part that has none, its text."""
    found = []
    for part in _parts(given):
        try:
            found.append(family.describe(part))
        except ConfigError:
            found.append({"kind": family.kind_of(part), "settings": repr(part)})
    return found


def _name(family: Family, given: Any, usual: Any) -> str:
    """Return the kind, with what is set otherwise than by default."""
    part = _parts(given)[0]
    kind = family.kind_of(part).rpartition(":")[2]
    holder = settings_type(type(part))
    held = given if isinstance(given, holder) else holder.of(part)
    default = usual if isinstance(usual, holder) else _default(type(part), holder)
    names = [one.name for one in fields(held) if one.init]
    differs = {name: getattr(held, name) for name in names if getattr(held, name) != getattr(default, name, MISSING)}
    if (fit := differs.pop("fit", None)) is not None:
        kind = f"{kind}{JOIN}{_name(family, fit, None)}"
    words = ", ".join(f"{name} {_word(value)}" for name, value in differs.items())
    text = f"{kind} ({words})" if words else kind
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"


def _default(part: type, holder: Any) -> Any:
    """Return the default settings of a part, None where it has none."""
    try:
        return part() if holder is part else holder.of(part())
    except TypeError:
        return None


def _word(value: Any) -> str:
    if is_dataclass(value):
        return type(value).__name__
    return f"{value:g}" if isinstance(value, float) else str(value)
