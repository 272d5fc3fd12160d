"""The parts that can be exchanged: one table for each family, which packages and files of the user may add to.

A part is a frozen dataclass: its fields are its settings. A new one is a file, and a line in a table below; a package
adds one by an entry point, a configuration by ``kind: path/to/file.py:Class``.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from functools import cache
from importlib import import_module
from numbers import Real
from typing import Annotated, Any, Literal, Protocol, Self, get_args, get_origin, get_type_hints, runtime_checkable

from dynident.runtime.errors import ConfigError, Noun, choices

ACTIONS: Mapping[str, str] = {
    "summary": "dynident.report.terminal:summary",
    "summary_html": "dynident.report.terminal:summary_html",
    "plot": "dynident.report.terminal:Plot",
    "check_lines": "dynident.report.terminal:check_lines",
    "check_html": "dynident.report.terminal:check_html",
    "save": "dynident.project.saved:save",
    "verdict": "dynident.identification.verdict_rules:verdict_of",
}
"""What upper rooms do for nouns of lower ones, which show and save themselves by these names."""

SECTIONS: Mapping[str, str] = {
    "excitation": "dynident.apps.excitation.config:ExcitationSettings",
    "compare": "dynident.apps.ranking.config:CompareSettings",
}
"""The sections of a configuration that belong to applications, with the classes of their settings."""


@runtime_checkable
class Settings(Protocol):
    """Settings of another shape than the fields of their part: a frozen dataclass.

    A part names it in its class variable ``PlainSettings``.
    """

    @classmethod
    def of(cls, part: Any, /) -> Self:
        """Return the settings that build ``part``."""

    def build(self) -> Any:
        """Return the part, or the candidates (a tuple) to choose it from."""


class PartFamily(Noun):
    """Interchangeable parts: ``table`` maps each kind to its ``module:name``, imported when it is first asked for.

    ``members`` are the attributes that a part must have; ``caller_fields`` those of its fields that are no
    settings, but given by the caller. Entry points of the group ``group`` add kinds. Where ``functions``, its
    parts are functions. ``protocol``, as ``module:name``, is the type of a setting that holds such a part; ``base``,
    likewise, the class that all parts derive from.
    """

    name: str
    table: Mapping[str, str]
    members: tuple[str, ...] = ("__call__",)
    caller_fields: tuple[str, ...] = ()
    functions: bool = False
    protocol: str = ""
    base: str = ""

    @property
    def group(self) -> str:
        """The group of entry points that adds to this family."""
        return f"dynident.{self.name.replace('log ', '')}s"

    def kinds(self) -> tuple[str, ...]:
        """Return all kinds, those of other packages last; nothing is imported."""
        return (*self.table, *(kind for kind in _entry_points(self.group) if kind not in self.table))

    def get(self, kind: str, where: str = "kind") -> Any:
        """Return the part of that kind, usually a class; ConfigError, led by ``where``, if there is none."""
        if kind in self.table:
            return _import_object(self.table[kind])
        entries = _entry_points(self.group)
        if kind not in entries:
            raise ConfigError(f"{where}: {kind!r} is not a choice; {choices(kind, self.kinds())}")
        try:
            part = entries[kind].load()
        except (Exception, SystemExit) as error:  # what other packages raise at import is theirs
            message = f"{self.name} {kind!r} of the entry point {entries[kind].value!r} cannot be loaded"
            raise ConfigError(f"{where}: {message}: {type(error).__name__}: {error}") from error
        self.check(part, f"{where}: {kind}")
        return part

    def check(self, part: Any, where: str) -> None:
        """Raise ConfigError, led by ``where``, unless ``part`` is a frozen dataclass with what this family needs."""
        if self.functions:
            if not callable(part):
                raise ConfigError(f"{where} is no function.")
            return
        if not (isinstance(part, type) and is_dataclass(part) and part.__dataclass_params__.frozen):  # type: ignore[attr-defined]
            raise ConfigError(f"{where} is no frozen dataclass; write @dataclass(frozen=True) before its class.")
        # fields without a default are no attributes of the class
        attributes = {field.name for field in fields(part)}.union(*map(vars, part.__mro__[:-1]))
        attributes -= getattr(part, "__abstractmethods__", frozenset())
        if missing := [name for name in self.members if name not in attributes]:
            raise ConfigError(f"{where} is no {self.name}: it lacks {', '.join(missing)}.")
        if self.base and self.base not in map(_import_path, part.__mro__):
            raise ConfigError(f"{where} is no {self.name}: derive it from {self.base.replace(':', '.')}.")

    def kind_of(self, part: object) -> str:
        """Return the kind of a part; of a class that no table has, its file and name."""
        cls = type(part)
        place = _import_path(cls)
        for kind, table_place in self.table.items():
            if table_place == place:
                return kind
        for kind, entry in _entry_points(self.group).items():
            if entry.value.replace(" ", "") == place:
                return kind
        file = getattr(sys.modules.get(cls.__module__), "__file__", None)
        return f"{file}:{cls.__qualname__}" if file else place

    def describe(self, part: object) -> dict[str, Any]:
        """Return kind and settings of a part as plain values for JSON: what ``dynident.project.parts.build`` takes.

        Infinite numbers become the texts "inf" and "-inf". Raises ConfigError for a value that has no plain form.
        """
        # a part may keep its settings in another class than itself
        holder = settings_type(type(part))
        settings: Any = part if holder is type(part) else holder.of(part)
        hints = settings_hints(holder)
        names = [field.name for field in fields(settings) if field.init and field.name not in self.caller_fields]
        where = f"{type(part).__name__}."
        return {"kind": self.kind_of(part)} | {
            name: _plain_setting(getattr(settings, name), hints[name], where + name) for name in names
        }


def family_of(hint: Any) -> PartFamily | None:
    """Return the family of parts that a setting of this type holds; None for plain values."""
    place = _import_path(hint)
    return next((family for family in (SMOOTHERS, ESTIMATORS) if place in (family.protocol, family.base)), None)


def part_family(cls: type) -> PartFamily:
    """Return the family of a class of parts, or of the base of them."""
    bases = set(map(_import_path, cls.__mro__))
    return next(family for family in (SMOOTHERS, TERMS, ESTIMATORS) if family.base in bases)


def settings_type(part: type) -> Any:
    """Return the dataclass that holds the settings of a part's class: most often the class itself."""
    return getattr(part, "Settings", part)


def settings_hints(holder: type) -> dict[str, Any]:
    """Return the types of a dataclass's fields by name; ConfigError where a name in them is not known when it runs."""
    try:
        return get_type_hints(holder, include_extras=True)
    except NameError as error:
        words = "import it in the file itself, not under TYPE_CHECKING"
        raise ConfigError(f"{holder.__name__}: the type of a field is not known: {error}; {words}.") from error


def _import_path(cls: Any) -> str:
    return f"{getattr(cls, '__module__', '')}:{getattr(cls, '__qualname__', '')}"


def _import_object(place: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def _entry_points(group: str) -> dict[str, Any]:
    return _entry_points_on_path(group, tuple(sys.path))


@cache  # to look through all packages takes 10 ms, and is asked for with each part
def _entry_points_on_path(group: str, path: tuple[str, ...]) -> dict[str, Any]:  # noqa: ARG001 - is searched
    from importlib.metadata import entry_points

    return {entry.name: entry for entry in entry_points(group=group)}


def _plain_setting(value: Any, hint: Any, where: str) -> Any:
    """Return a setting as JSON has it; pairs become a mapping where the hint allows one."""
    if get_origin(hint) is Annotated:
        hint = get_args(hint)[0]
    # a setting may hold a part, also as one choice of a union
    family = next(filter(None, map(family_of, (hint, *get_args(hint)))), None)
    if family is not None and value is not None:
        return family.describe(value)
    if _is_mapping_like(value, hint):
        return {str(key): _plain_setting(item, None, where) for key, item in dict(value).items()}
    if hasattr(value, "tolist"):  # arrays and scalars of NumPy
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain_setting(item, None, where) for item in value]
    return _plain_scalar(value, where)


def _is_mapping_like(value: Any, hint: Any) -> bool:
    """Whether a value is a mapping, or a tuple of the pairs of one."""
    allowed = any(get_origin(entry) is Mapping for entry in (hint, *get_args(hint)))
    pairs = isinstance(value, tuple) and all(isinstance(entry, tuple) and len(entry) == 2 for entry in value)
    return isinstance(value, Mapping) or (allowed and pairs)


def _plain_scalar(value: Any, where: str) -> Any:
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, float) and math.isinf(value):
        return str(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ConfigError(f"{where} is a {type(value).__name__}; settings are numbers, texts, lists or mappings of them.")


SMOOTHERS = PartFamily(
    "smoother",
    {
        "spline": "dynident.motion.smoothers.spline:Spline",
        "difference": "dynident.motion.smoothers.difference:Difference",
        "butterworth": "dynident.motion.smoothers.difference:Butterworth",
        "kalman": "dynident.motion.smoothers.kalman:KalmanSmoother",
        "savitzky_golay": "dynident.motion.smoothers.savitzky_golay:SavitzkyGolay",
        "fourier": "dynident.motion.smoothers.fourier:FourierSeries",
        "time_shifted": "dynident.motion.smoothers.smoother:TimeShifted",
    },
    base="dynident.motion.smoothers.smoother:Smoother",
)
TERMS = PartFamily(
    "term",
    {
        "rotor": "dynident.models.motor:RotorInertia",
        "viscous": "dynident.models.friction.joint_term:Viscous",
        "coulomb": "dynident.models.friction.dry_friction:Coulomb",
        "wide_coulomb": "dynident.models.friction.dry_friction:WideCoulomb",
        "asymmetric_coulomb": "dynident.models.friction.dry_friction:AsymmetricCoulomb",
        "asymmetric_viscous": "dynident.models.friction.dry_friction:AsymmetricViscous",
        "stribeck": "dynident.models.friction.dry_friction:Stribeck",
        "power": "dynident.models.friction.dry_friction:Power",
        "ripple": "dynident.models.friction.joint_torques:Ripple",
        "spring": "dynident.models.friction.joint_torques:Spring",
        "counterbalance": "dynident.models.friction.joint_torques:Counterbalance",
        "load_coulomb": "dynident.models.friction.dahl_and_load:LoadCoulomb",
        "load_viscous": "dynident.models.friction.dahl_and_load:LoadViscous",
        "dahl": "dynident.models.friction.dahl_and_load:Dahl",
        "load_dahl": "dynident.models.friction.dahl_and_load:LoadDahl",
        "load_ripple": "dynident.models.friction.dahl_and_load:LoadRipple",
        "drift": "dynident.models.friction.joint_torques:Drift",
        "offset": "dynident.models.friction.joint_torques:Offset",
        "coupled_friction": "dynident.models.motor:CoupledFriction",
    },
    members=("joints", "parameters", "regressor", "partials"),
    caller_fields=("joints",),
    base="dynident.models.term:Term",
)
ESTIMATORS = PartFamily(
    "estimator",
    {
        "least_squares": "dynident.estimators.least_squares:LeastSquares",
        "weighted_least_squares": "dynident.estimators.generalised_least_squares:WeightedLeastSquares",
        "generalised_least_squares": "dynident.estimators.generalised_least_squares:GeneralisedLeastSquares",
        "consistent": "dynident.estimators.physically_consistent:PhysicallyConsistent",
        "instrumental_variables": "dynident.estimators.instrumental_variables:InstrumentalVariables",
        "didim": "dynident.estimators.output_error:Didim",
        "output_error": "dynident.estimators.output_error:OutputError",
        "maximum_likelihood": "dynident.estimators.maximum_likelihood.estimator:MaximumLikelihood",
        "augmented_kalman": "dynident.estimators.augmented_kalman:AugmentedKalman",
        "ridge": "dynident.estimators.ridge:Ridge",
        "robust": "dynident.estimators.robust_least_squares:RobustLeastSquares",
        "total_least_squares": "dynident.estimators.total_least_squares:TotalLeastSquares",
    },
    protocol="dynident.estimators.estimator:Estimator",
    base="dynident.estimators.estimator:Estimator",
)
READERS = PartFamily(
    "log reader",
    {
        **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".log"), "dynident.files.text:read_text"),
        ".parquet": "dynident.files.parquet:read_parquet",
        **dict.fromkeys((".npy", ".npz"), "dynident.files.arrays:read_numpy"),
        ".mat": "dynident.files.matlab:read_mat",
        **dict.fromkeys((".h5", ".hdf5"), "dynident.files.matlab:read_hdf5"),
        **dict.fromkeys((".bag", ".db3", ".mcap"), "dynident.files.ros:read_bag"),
        "lerobot": "dynident.files.lerobot:read_episode",
    },
    functions=True,
)
EXPORTERS = PartFamily(
    "exporter",
    {
        "urdf": "dynident.project.export.formats:Urdf",
        "mjcf": "dynident.project.export.formats:Mjcf",
        "numpy": "dynident.project.export.formats:Numpy",
        "yaml": "dynident.project.export.formats:Yaml",
        "drake": "dynident.project.export.simulators:Drake",
        "drake_directives": "dynident.project.export.simulators:DrakeDirectives",
        "isaac": "dynident.project.export.simulators:IsaacLab",
        "pinocchio": "dynident.project.export.simulators:PinocchioFile",
    },
    members=("format", "readers", "file", "write", "torque"),
)


def action(name: str) -> Any:
    """Return the function or class that is registered for a noun, imported when it is asked for."""
    return _import_object(ACTIONS[name])


def section_class(name: str) -> Any:
    """Return the class of the settings of an application's section of a configuration."""
    return _import_object(SECTIONS[name])


def check_settings(part: Any) -> None:
    """Check the fields of a dataclass: numbers by the limits of ``annotated_types``, texts by their choices.

    So are those in tuples and mappings. A field may hold what has no limits besides: parts, None. Raises ConfigError,
    which names the field.
    """
    cls: type = type(part)
    for name, rule in _rules(cls).items():
        rule.check(name, getattr(part, name))


@dataclass(frozen=True)
class _Rule:
    """What a field may hold: one of ``texts`` (or of numbers), or a number within limits (a ``whole`` one), or None.

    ``items`` is the rule of the entries of a tuple, of which there are ``count`` unless it is None, or of a mapping,
    whose entries are ``keyed``.
    """

    texts: tuple[str | int, ...]
    whole: bool
    limits: tuple[tuple[str, float], ...]
    optional: bool
    items: _Rule | None = None
    count: int | None = None
    keyed: bool = False

    def check(self, name: str, value: Any) -> None:
        """Raise ConfigError for a value that the rule forbids."""
        if self.items is not None and isinstance(value, Mapping | list | tuple):
            if self.count not in (None, len(value)):
                raise ConfigError(f"{name} = {value}; give {self.count} entries.")
            try:  # parts keep mappings as pairs of name and value
                entries = dict(value).items() if self.keyed else enumerate(value, 1)
            except (TypeError, ValueError) as error:
                raise ConfigError(f"{name} = {value}; give one value, or a mapping of them by name.") from error
            for key, entry in entries:
                self.items.check(f"{name} of {key!r}" if self.keyed else f"entry {key} of {name}", entry)
        # choices may be texts beside numbers, or whole numbers alone
        is_choice = isinstance(value, str) or (isinstance(next(iter(self.texts), ""), int) and value is not None)
        if is_choice and self.texts and value not in self.texts:
            raise ConfigError(f"{name} = {value!r}; {choices(str(value), map(str, self.texts))}")
        if not self.limits or isinstance(value, bool) or not isinstance(value, Real):
            return
        number = float(value)
        is_within = {
            "at least": number.__ge__, "above": number.__gt__, "at most": number.__le__, "below": number.__lt__,
        }  # fmt: skip
        is_allowed = math.isfinite(number) and all(is_within[side](limit) for side, limit in self.limits)
        if not is_allowed or (self.whole and number % 1):
            kind = "a whole number" if self.whole else "a number"
            sides = " and ".join(f"{side} {limit:g}" for side, limit in self.limits)
            others = "".join(f", or {other}" for other in (*map(repr, self.texts), *["null"] * self.optional))
            raise ConfigError(f"{name} = {value}; give {kind} {sides}{others}.")


@cache
def _rules(holder: type) -> dict[str, _Rule]:
    """Return the rules of a dataclass's fields, by name; none where a type is not known when it runs."""
    try:
        hints = settings_hints(holder)
    except ConfigError:
        return {}
    rules = {name: _rule(hint) for name, hint in hints.items() if name in holder.__dataclass_fields__}  # type: ignore[attr-defined]
    return {name: rule for name, rule in rules.items() if rule.texts or rule.limits or rule.items}


def _rule(hint: Any) -> _Rule:
    # marks without limits, such as that of a setting by joint, are outside of all others
    if get_origin(hint) is Annotated and get_args(get_args(hint)[0]):
        hint = get_args(hint)[0]
    members = (hint,) if get_origin(hint) in (Annotated, Literal, tuple) else get_args(hint)
    nested = next((member for member in members if get_origin(member) in (Mapping, tuple)), None)
    entries = get_args(nested)
    is_fixed = get_origin(nested) is tuple and ... not in entries
    items = _rule(next(entry for entry in reversed(entries) if entry is not ...)) if entries else None
    texts = [text for member in members if get_origin(member) is Literal for text in get_args(member)]
    number, *limits = next((get_args(member) for member in members if get_origin(member) is Annotated), (None,))
    sides = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}
    pairs = ((side, getattr(limit, key)) for limit in limits for key, side in sides.items() if hasattr(limit, key))
    limit_pairs, optional = tuple(pairs), type(None) in members
    count = len(entries) if is_fixed else None
    return _Rule(tuple(texts), number is int, limit_pairs, optional, items, count, get_origin(nested) is Mapping)
