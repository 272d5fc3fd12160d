"""Settings of parts from YAML or JSON: the sections of a configuration, derived from the parts' own dataclasses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from enum import Enum
from functools import cache, partial
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    StrictBool,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    WrapValidator,
    create_model,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from dynident.motion.smoothers import BY_JOINT
from dynident.project.fields import Name, Section
from dynident.project.python_file import CODE, error_text, load_from_file, resolve_file
from dynident.runtime import ConfigError, DynidentError, as_number, choices
from dynident.runtime.families import PartFamily, Settings, family_of, section_class, settings_hints, settings_type

FILE_CLASS_PATTERN = r"\.py:\w+$"  # a class of a file


@dataclass(frozen=True, eq=False)
class PartReader:
    """Marks a setting, as ``Annotated[Any, PartReader(family)]``, that holds the settings of one part of the family.

    With ``plain`` a kind may stand alone where the part needs no settings, or says itself in what sizes it is
    ``proposed``; it is then kept as it is, a class of a file as the class. So are ``words``, which stand for what is
    no part.
    """

    family: PartFamily
    plain: bool = False
    nested: bool = False
    words: tuple[str, ...] = ()

    def read(self, value: object, info: ValidationInfo) -> Any:
        """Return the settings of a part, or for a family with ``caller_fields`` the part still without these."""
        if isinstance(value, str) and value in self.words:
            return value
        if not self.plain or isinstance(value, Mapping):
            return _read_settings(self.family, value, info)
        part = _read_class(self.family, value, info)
        # read once without settings, so that a kind that needs some is refused
        if not hasattr(part, "proposed"):
            _read_settings(self.family, {"kind": value}, info)
        return value if value in self.family.kinds() else part

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_before_validator_function(self.read, handler(source))

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        if self.nested:  # a part in a part, which may hold the next
            return {"type": "object", "required": ["kind"]}
        kinds = [{"enum": [*self.words, *self.family.kinds()]}] if self.plain else []
        kind = {"type": "string", "pattern": FILE_CLASS_PATTERN}
        file_part = {"type": "object", "properties": {"kind": kind}, "required": ["kind"]}
        return {"oneOf": [*kinds, *schemas(self.family).values(), file_part]}


@dataclass(frozen=True)
class AppSection:
    """Marks a setting, as ``Annotated[Any, AppSection(name)]``, that holds the section of an application.

    The class of its settings is imported where a configuration has the section, or where its schema is asked for.
    """

    name: str

    def read(self, value: object, info: ValidationInfo) -> Any:
        """Return the settings of the section, None where there is none."""
        return None if value is None else section_class(self.name).model_validate(value, context=info.context)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_before_validator_function(self.read, handler(source))

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return handler(TypeAdapter(section_class(self.name) | None).core_schema)


def build_part(settings: Any) -> Any:
    """Return the part that was read by a ``PartReader``, or the candidates to choose it from."""
    return settings.build() if isinstance(settings, Settings) else settings


def build(
    family: PartFamily, settings: Mapping[str, Any], where: str, folder: Path | None = None, **caller_fields: Any
) -> Any:
    """Return the part of a ``kind`` with its settings: the inverse of ``PartFamily.describe``.

    A kind that names a file is refused unless a ``folder`` is given, where relative names start: it runs the
    file. ``caller_fields`` are the fields that are no settings. Raises ConfigError, led by ``where``.
    """
    try:
        read = TypeAdapter(Annotated[Any, PartReader(family)]).validate_python(settings, context={"code": folder})
    except ValidationError as error:
        raise ConfigError(error_text(error, settings, where)) from None
    return read(**caller_fields) if family.caller_fields else build_part(read)


def by_joint(settings: Any) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the settings that are mappings by the names of joints, with their names."""
    for name, hint in settings_hints(type(settings)).items():
        if BY_JOINT in getattr(hint, "__metadata__", ()) and isinstance(value := getattr(settings, name), Mapping):
            yield name, value


def schemas(family: PartFamily) -> dict[str, Any]:
    """Return the JSON schema of the settings of every kind; that of an installed one that cannot be loaded is open."""
    schemas_by_kind = {}
    for kind in family.kinds():
        try:
            schema = section(family, family.get(kind)).model_json_schema()
        except ConfigError as error:
            if kind in family.table:
                raise
            schema = {"type": "object", "properties": {}, "required": ["kind"], "description": str(error)}
        schema["properties"]["kind"] = {"const": kind}
        schemas_by_kind[kind] = schema
    return schemas_by_kind


def unusable(family: PartFamily) -> Iterator[str]:
    """Yield why parts of other packages, which are installed, cannot be used."""
    for kind in family.kinds()[len(family.table) :]:
        try:
            section(family, family.get(kind))
        except ConfigError as error:
            yield str(error)


@cache
def section(family: PartFamily, part: type) -> type[Section]:
    """Return the settings of a part as a section of the configuration: ``kind``, and the fields of its dataclass.

    Raises ConfigError for a field of a type that no setting can have.
    """
    holder = settings_type(part)
    hints = settings_hints(holder)
    keys: dict[str, Any] = {"kind": (str, ...)}
    for field in fields(holder):
        if field.init and field.name not in family.caller_fields:
            # names that pydantic, or the section itself, use cannot be keys
            if field.name.startswith("_") or field.name == "kind" or hasattr(Section, field.name):
                raise ConfigError(f"{part.__name__}.{field.name}: no setting can have this name; rename the field.")
            needed = field.default is MISSING and field.default_factory is MISSING
            factory = None if field.default_factory is MISSING else field.default_factory
            default = Field(default_factory=factory) if factory else Field(... if needed else field.default)
            keys[field.name] = (_setting_type(hints[field.name], f"{part.__name__}.{field.name}"), default)
    made: type[Section] = create_model(f"{part.__name__}Settings", __base__=Section, __doc__=part.__doc__, **keys)
    return made


def _read_class(family: PartFamily, kind: object, info: ValidationInfo) -> Any:
    try:
        return _find_class(family, kind, (info.context or {}).get("code"))
    except ConfigError as error:
        raise _words_error(str(error).removeprefix("kind: ")) from error


def _read_settings(family: PartFamily, value: object, info: ValidationInfo) -> Any:
    """Return the settings of a part, or for a family with ``caller_fields`` the part still without these."""
    folder = (info.context or {}).get("code")
    if not isinstance(value, Mapping):
        raise PydanticCustomError("mapping_type", "a mapping")
    if "kind" not in value:
        raise _words_error(f"needs a `kind`: {', '.join(family.kinds())}")
    kind = value["kind"]
    try:
        return with_settings(family, _find_class(family, kind, folder), value, folder)
    except ConfigError as error:
        raise _words_error(str(error).removeprefix("kind: ")) from error


def with_settings(family: PartFamily, part: Any, settings: Mapping[str, Any], folder: str | Path | None = None) -> Any:
    """Return the settings of a part's class, read from plain values.

    For a family with ``caller_fields`` return ``part`` with its settings bound. Raises the errors of pydantic,
    and ConfigError for a field of a type that no setting can have.
    """
    read = section(family, part).model_validate(settings, context={"code": folder})
    values = {name: getattr(read, name) for name in type(read).model_fields if name != "kind"}
    return partial(part, **values) if family.caller_fields else _build_settings(settings_type(part), values)


def _build_settings(holder: Any, values: Mapping[str, Any]) -> Any:
    """Return the settings, once a part could be built with them."""
    # settings that are each right may still not fit together, which only building the part shows
    try:
        settings = holder(**values)
        build_part(settings)
    except (DynidentError, ValueError) as error:
        raise ValueError(str(error)) from error
    except Exception as error:  # of a class of the user's
        raise ValueError(f"{type(error).__name__}: {error}") from error
    return settings


def _find_class(family: PartFamily, kind: object, folder: str | Path | None) -> Any:
    if not isinstance(kind, str):
        raise ConfigError(f"{kind!r} is not a choice; {choices(str(kind), family.kinds())}")
    place, colon, name = kind.rpartition(":")
    if not (colon and place.endswith(".py")):
        return family.get(kind)
    if folder is None:
        raise ConfigError(f"{kind!r} {CODE}")
    path = resolve_file(folder, place, family.name, ConfigError)
    part = load_from_file(path, name, "class", family.name, ConfigError)
    family.check(part, f"{path}: {name}")
    return part


def _words_error(text: str) -> PydanticCustomError:
    return PydanticCustomError("words", "{words}", {"words": text})


def _setting_type(hint: Any, where: str) -> Any:
    """Return the annotation that reads a value of the type of a part's field as YAML gives it."""
    if (family := family_of(hint)) is not None:
        return Annotated[Any, PartReader(family, nested=True), AfterValidator(build_part)]
    if (read := GENERIC.get(get_origin(hint))) is not None:
        return read(get_args(hint), where)
    if get_origin(hint) is None and hint in SCALARS:
        return SCALARS[hint]
    if _is_enum(hint):
        return hint
    raise ConfigError(f"{where} has the type {hint}; a setting is a number, a text, or a list or mapping of them.")


def _annotated_type(inside: tuple[Any, ...], where: str) -> Any:
    base, *marks = inside
    validators = [mark for mark in marks if not isinstance(mark, str)]
    return Annotated[(_setting_type(base, where), *validators)] if validators else _setting_type(base, where)


def _tuple_type(inside: tuple[Any, ...], where: str) -> Any:
    return tuple[tuple(hint if hint is Ellipsis else _setting_type(hint, where) for hint in inside)]  # type: ignore[misc]


def _union_type(inside: tuple[Any, ...], where: str) -> Any:
    return _union_by_shape([(hint, _setting_type(hint, where)) for hint in inside])


def _mapping_type(inside: tuple[Any, ...], where: str) -> Any:
    return Mapping[Name, _setting_type(inside[1], where)]  # type: ignore[misc]


GENERIC: Mapping[Any, Callable[[tuple[Any, ...], str], Any]] = {
    Annotated: _annotated_type,
    Union: _union_type,
    UnionType: _union_type,
    Literal: lambda inside, _: Literal[inside],
    tuple: _tuple_type,
    list: lambda inside, where: list[_setting_type(inside[0], where)],  # type: ignore[misc]
    Sequence: lambda inside, where: _tuple_type((inside[0], ...), where),
    Mapping: _mapping_type,
    dict: _mapping_type,
}


def _is_text(hint: Any) -> bool:
    return get_origin(hint) is Literal or hint is str or _is_enum(hint)


def _is_enum(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, Enum)


def _read_float(value: object) -> float:
    """Read a number, which may be infinite."""
    if not math.isnan(number := as_number(value)):
        return number
    raise ValueError("a number is expected")


def _read_whole_number(value: object) -> int:
    number = _read_float(value)
    if math.isinf(number) or number != int(number):
        raise ValueError("a whole number is expected")
    return int(number)


SCALARS: Mapping[Any, Any] = {
    float: Annotated[float, Field(allow_inf_nan=True), BeforeValidator(_read_float)],
    int: Annotated[int, BeforeValidator(_read_whole_number)],
    bool: StrictBool,
    str: Name,
    NoneType: NoneType,
}


def _union_by_shape(options: list[tuple[Any, Any]]) -> Any:
    """Return the union of types as one that looks at the shape of a value only, so that errors have its place."""
    annotations = [annotation for _, annotation in options]

    @cache
    def adapter(k: int) -> TypeAdapter[Any]:
        return TypeAdapter(annotations[k])

    def read(value: object, _: Callable[[Any], Any], info: ValidationInfo) -> Any:
        # pydantic would report the errors of every member of the union: only the one of the right shape is tried
        fitting = [k for k, (hint, _) in enumerate(options) if _has_shape(hint, value)]
        main = next(k for k, (hint, _) in enumerate(options) if hint is not NoneType)
        return adapter((fitting or [main])[0]).validate_python(value, context=info.context)

    return Annotated[Union[tuple(annotations)], WrapValidator(read)]  # noqa: UP007


def _has_shape(hint: Any, value: object) -> bool:
    """Whether a value has the shape of a type."""
    while get_origin(hint) is Annotated:
        hint = get_args(hint)[0]
    if value is None or isinstance(value, bool):
        return hint is (NoneType if value is None else bool)
    if isinstance(value, Mapping):
        return get_origin(hint) in (Mapping, dict) or family_of(hint) is not None
    if isinstance(value, list | tuple):
        return get_origin(hint) in (tuple, list, Sequence)
    return (hint in (int, float) and not math.isnan(as_number(value))) or (isinstance(value, str) and _is_text(hint))
