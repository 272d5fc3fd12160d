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
from importlib import import_module
from typing import Annotated, Any, Protocol, Self, get_args, get_origin, get_type_hints, runtime_checkable

from dynident.errors import ConfigError, choices

__all__ = [
    "ESTIMATORS",
    "EXPORTERS",
    "READERS",
    "SMOOTHERS",
    "TERMS",
    "Family",
    "Settings",
    "family_of",
    "settings_hints",
    "settings_type",
]


@runtime_checkable
class Settings(Protocol):
    """Settings of another shape than the fields of their part: a frozen dataclass.

    A part names it in its class variable ``Settings``.
    """

    @classmethod
    def of(cls, part: Any, /) -> Self:
        """Return the settings that build ``part``."""

    def build(self) -> Any:
        """Return the part, or the candidates (a tuple) to choose it from."""


@dataclass(frozen=True, eq=False)
class Family:
    """Interchangeable parts: ``table`` maps each kind to its "module:name", imported where it is asked for.

    ``members`` are the attributes that a part must have, ``given`` those of its fields that are no settings, as the
    caller knows them. Entry points of the group ``group`` add kinds. Where ``functions``, its parts are functions.
    ``protocol``, as "module:name", is the type of a setting that holds such a part.
    """

    name: str
    table: Mapping[str, str]
    members: tuple[str, ...] = ("__call__",)
    given: tuple[str, ...] = ()
    functions: bool = False
    protocol: str = ""

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
            return _imported(self.table[kind])
        found = _entry_points(self.group)
        if kind not in found:
            raise ConfigError(f"{where}: {kind!r} is not a choice; {choices(kind, self.kinds())}")
        try:
            part = found[kind].load()
        except (Exception, SystemExit) as error:  # what other packages raise at import is theirs
            words = f"{self.name} {kind!r} of the entry point {found[kind].value!r} cannot be loaded"
            raise ConfigError(f"{where}: {words}: {type(error).__name__}: {error}") from error
        self.check(part, f"{where}: {kind}")
        return part

    def check(self, part: Any, where: str) -> None:
        """Raise ConfigError, led by ``where``, unless ``part`` is a frozen dataclass with what this family needs."""
        if self.functions:
            if not callable(part):
                raise ConfigError(f"{where} is no function.")
            return
        if not _is_frozen(part):
            raise ConfigError(f"{where} is no frozen dataclass; write @dataclass(frozen=True) before its class.")
        known = {name for base in part.__mro__[:-1] for name in vars(base)} | {field.name for field in fields(part)}
        if missing := [name for name in self.members if name not in known]:
            raise ConfigError(f"{where} is no {self.name}: it lacks {', '.join(missing)}.")

    def kind_of(self, part: object) -> str:
        """Return the kind of a part; of a class that no table has, its file and name."""
        cls = type(part)
        place = _place(cls)
        for kind, known in self.table.items():
            if known == place:
                return kind
        for kind, entry in _entry_points(self.group).items():
            if entry.value.replace(" ", "") == place:
                return kind
        file = getattr(sys.modules.get(cls.__module__), "__file__", None)
        return f"{file}:{cls.__qualname__}" if file else place

    def describe(self, part: object) -> dict[str, Any]:
        """Return kind and settings of a part as plain values for JSON: what ``dynident.io.parts.build`` takes.

        Infinite numbers become the texts "inf" and "-inf". Raises ConfigError for a value that has no plain form.
        """
        holder = settings_type(type(part))
        held: Any = part if holder is type(part) else holder.of(part)
        hints = settings_hints(holder)
        names = [field.name for field in fields(held) if field.init and field.name not in self.given]
        where = f"{type(part).__name__}."
        return {"kind": self.kind_of(part)} | {
            name: _plain(getattr(held, name), hints[name], where + name) for name in names
        }


def family_of(hint: Any) -> Family | None:
    """Return the family of parts that a setting of this type holds; None for plain values."""
    return next((one for one in (SMOOTHERS, ESTIMATORS) if _place(hint) == one.protocol), None)


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


def _is_frozen(part: Any) -> bool:
    return isinstance(part, type) and is_dataclass(part) and bool(part.__dataclass_params__.frozen)  # type: ignore[attr-defined]


def _place(cls: Any) -> str:
    return f"{getattr(cls, '__module__', '')}:{getattr(cls, '__qualname__', '')}"


def _imported(place: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def _entry_points(group: str) -> dict[str, Any]:
    from importlib.metadata import entry_points

    return {entry.name: entry for entry in entry_points(group=group)}


def _plain(value: Any, hint: Any, where: str) -> Any:
    """Return a setting as JSON has it; pairs become a mapping where the hint allows one."""
    if get_origin(hint) is Annotated:
        hint = get_args(hint)[0]
    family = next(filter(None, map(family_of, (hint, *get_args(hint)))), None)
    if family is not None and value is not None:
        return family.describe(value)
    if _is_mapping(value, hint):
        return {str(key): _plain(item, None, where) for key, item in dict(value).items()}
    if hasattr(value, "tolist"):  # arrays and scalars of NumPy
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item, None, where) for item in value]
    return _scalar(value, where)


def _is_mapping(value: Any, hint: Any) -> bool:
    """Whether a value is a mapping, or a tuple of the pairs of one."""
    allowed = any(get_origin(one) is Mapping for one in (hint, *get_args(hint)))
    pairs = isinstance(value, tuple) and all(isinstance(one, tuple) and len(one) == 2 for one in value)
    return isinstance(value, Mapping) or (allowed and pairs)


def _scalar(value: Any, where: str) -> Any:
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, float) and math.isinf(value):
        return str(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ConfigError(
        f"{where} is a {type(value).__name__}; settings are numbers, texts, and lists or mappings of them."
    )


SMOOTHERS = Family(
    "smoother",
    {
        "spline": "dynident.smoothers.spline:Spline",
        "difference": "dynident.smoothers.difference:Difference",
        "butterworth": "dynident.smoothers.butterworth:Butterworth",
        "kalman": "dynident.smoothers.kalman:KalmanSmoother",
        "savitzky_golay": "dynident.smoothers.savitzky_golay:SavitzkyGolay",
        "fourier": "dynident.smoothers.fourier:FourierSeries",
        "time_shifted": "dynident.smoothers.time_offset:TimeShifted",
    },
    protocol="dynident.smoothers.smoother:Smoother",
)
TERMS = Family(
    "term",
    {
        "rotor": "dynident.models.motor:RotorInertia",
        "viscous": "dynident.models.friction.viscous:Viscous",
        "coulomb": "dynident.models.friction.coulomb:Coulomb",
        "wide_coulomb": "dynident.models.friction.coulomb:WideCoulomb",
        "asymmetric_coulomb": "dynident.models.friction.asymmetric:AsymmetricCoulomb",
        "asymmetric_viscous": "dynident.models.friction.asymmetric:AsymmetricViscous",
        "stribeck": "dynident.models.friction.stribeck:Stribeck",
        "power": "dynident.models.friction.power:Power",
        "ripple": "dynident.models.friction.ripple:Ripple",
        "spring": "dynident.models.friction.spring:Spring",
        "counterbalance": "dynident.models.friction.counterbalance:Counterbalance",
        "load_coulomb": "dynident.models.friction.load:LoadCoulomb",
        "load_viscous": "dynident.models.friction.load:LoadViscous",
        "dahl": "dynident.models.friction.dahl:Dahl",
        "load_dahl": "dynident.models.friction.load:LoadDahl",
        "load_ripple": "dynident.models.friction.load:LoadRipple",
        "drift": "dynident.models.friction.drift:Drift",
        "offset": "dynident.models.friction.offset:Offset",
        "coupled_friction": "dynident.models.coupled_friction:CoupledFriction",
    },
    members=("joints", "parameters", "regressor", "partials"),
    given=("joints",),
)
ESTIMATORS = Family(
    "estimator",
    {
        "least_squares": "dynident.estimators.least_squares:LeastSquares",
        "weighted_least_squares": "dynident.estimators.weighted_least_squares:WeightedLeastSquares",
        "generalised_least_squares": "dynident.estimators.generalised_least_squares:GeneralisedLeastSquares",
        "consistent": "dynident.estimators.physically_consistent.fit:PhysicallyConsistent",
        "instrumental_variables": "dynident.estimators.instrumental_variables.fit:InstrumentalVariables",
        "didim": "dynident.estimators.output_error.didim:Didim",
        "output_error": "dynident.estimators.output_error.output_error:OutputError",
        "maximum_likelihood": "dynident.estimators.maximum_likelihood.fit:MaximumLikelihood",
        "augmented_kalman": "dynident.estimators.augmented_kalman.fit:AugmentedKalman",
        "ridge": "dynident.estimators.ridge:Ridge",
        "robust": "dynident.estimators.robust:RobustLeastSquares",
        "total_least_squares": "dynident.estimators.total_least_squares:TotalLeastSquares",
    },
    protocol="dynident.estimators.estimator:Estimator",
)
READERS = Family(
    "log reader",
    {
        **dict.fromkeys((".csv", ".txt", ".tsv", ".dat"), "dynident.io.tables:read_text"),
        ".parquet": "dynident.io.tables:read_parquet",
        ".npz": "dynident.io.tables:read_npz",
        ".mat": "dynident.io.tables:read_mat",
        **dict.fromkeys((".h5", ".hdf5"), "dynident.io.tables:read_hdf5"),
        **dict.fromkeys((".bag", ".db3", ".mcap"), "dynident.io.tables:read_bag"),
    },
    functions=True,
)
EXPORTERS = Family(
    "exporter",
    {
        "urdf": "dynident.export.formats:Urdf",
        "mjcf": "dynident.export.formats:Mjcf",
        "numpy": "dynident.export.formats:Numpy",
        "yaml": "dynident.export.formats:Yaml",
    },
    members=("format", "readers", "file", "write", "torque"),
)
