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

from dynident.errors import ConfigError, DynidentError, choices
from dynident.io.families import Family, Settings, family_of, settings_hints, settings_type
from dynident.io.fields import Name, Section, as_number
from dynident.io.python_file import CODE, from_file, located
from dynident.io.wording import worded
from dynident.smoothers import BY_JOINT

__all__ = ["PartReader", "build", "built", "by_joint", "schemas", "section", "unusable", "with_settings"]


FILE = r"\.py:\w+$"  # a class of a file


@dataclass(frozen=True, eq=False)
class PartReader:
    """Marks a setting, as ``Annotated[Any, PartReader(family)]``, that holds the settings of one part of the family.

    With ``plain`` a kind may stand alone where the part needs no settings, or says itself in what sizes it is
    ``proposed``; it is then kept as it is, a class of a file as the class. So are ``words``, which stand for what is
    no part.
    """

    family: Family
    plain: bool = False
    nested: bool = False
    words: tuple[str, ...] = ()

    def read(self, value: object, info: ValidationInfo) -> Any:
        """Return the settings of a part, or for a family with given fields the part without them."""
        if isinstance(value, str) and value in self.words:
            return value
        if not self.plain or isinstance(value, Mapping):
            return _read(self.family, value, info)
        part = _classed(self.family, value, info)
        if not hasattr(part, "proposed"):
            _read(self.family, {"kind": value}, info)
        return value if value in self.family.kinds() else part

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_before_validator_function(self.read, handler(source))

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        if self.nested:  # a part in a part, which may hold the next
            return {"type": "object", "required": ["kind"]}
        kinds = [{"enum": [*self.words, *self.family.kinds()]}] if self.plain else []
        yours = {"type": "object", "properties": {"kind": {"type": "string", "pattern": FILE}}, "required": ["kind"]}
        return {"oneOf": [*kinds, *schemas(self.family).values(), yours]}


def built(settings: Any) -> Any:
    """Return the part that was read by a ``PartReader``, or the candidates to choose it from."""
    return settings.build() if isinstance(settings, Settings) else settings


def build(family: Family, settings: Mapping[str, Any], where: str, folder: Path | None = None, **given: Any) -> Any:
    """Return the part of a ``kind`` with its settings: the inverse of ``Family.describe``.

    A kind that names a file is refused unless a ``folder`` is given, where relative names start: it runs the file.
    ``given`` are the fields that are no settings. Raises ConfigError, led by ``where``.
    """
    try:
        read = TypeAdapter(Annotated[Any, PartReader(family)]).validate_python(settings, context={"code": folder})
    except ValidationError as error:
        raise ConfigError(worded(error, settings, where)) from None
    return read(**given) if family.given else built(read)


def by_joint(settings: Any) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the settings that are mappings by the names of joints, with their names."""
    for name, hint in settings_hints(type(settings)).items():
        if BY_JOINT in getattr(hint, "__metadata__", ()) and isinstance(value := getattr(settings, name), Mapping):
            yield name, value


def schemas(family: Family) -> dict[str, Any]:
    """Return the JSON schema of the settings of every kind; that of an installed one that cannot be loaded is open."""
    found = {}
    for kind in family.kinds():
        try:
            schema = section(family, family.get(kind)).model_json_schema()
        except ConfigError as error:
            if kind in family.table:
                raise
            schema = {"type": "object", "properties": {}, "required": ["kind"], "description": str(error)}
        schema["properties"]["kind"] = {"const": kind}
        found[kind] = schema
    return found


def unusable(family: Family) -> Iterator[str]:
    """Yield why parts of other packages, which are installed, cannot be used."""
    for kind in family.kinds()[len(family.table) :]:
        try:
            section(family, family.get(kind))
        except ConfigError as error:
            yield str(error)


@cache
def section(family: Family, part: type) -> type[Section]:
    """Return the settings of a part as a section of the configuration: ``kind``, and the fields of its dataclass.

    Raises ConfigError for a field of a type that no setting can have.
    """
    holder = settings_type(part)
    hints = settings_hints(holder)
    keys: dict[str, Any] = {"kind": (str, ...)}
    for one in fields(holder):
        if one.init and one.name not in family.given:
            if one.name.startswith("_") or one.name == "kind" or hasattr(Section, one.name):
                raise ConfigError(f"{part.__name__}.{one.name}: no setting can have this name; rename the field.")
            needed = one.default is MISSING and one.default_factory is MISSING
            factory = None if one.default_factory is MISSING else one.default_factory
            default = Field(default_factory=factory) if factory else Field(... if needed else one.default)
            keys[one.name] = (_setting(hints[one.name], f"{part.__name__}.{one.name}"), default)
    made: type[Section] = create_model(f"{part.__name__}Settings", __base__=Section, __doc__=part.__doc__, **keys)
    return made


def _classed(family: Family, kind: object, info: ValidationInfo) -> Any:
    try:
        return _class(family, kind, (info.context or {}).get("code"))
    except ConfigError as error:
        raise _words(str(error).removeprefix("kind: ")) from error


def _read(family: Family, value: object, info: ValidationInfo) -> Any:
    """Return the settings of a part, or for a family with given fields the part without them."""
    folder = (info.context or {}).get("code")
    if not isinstance(value, Mapping):
        raise PydanticCustomError("mapping_type", "a mapping")
    if "kind" not in value:
        raise _words(f"needs a `kind`: {', '.join(family.kinds())}")
    kind = value["kind"]
    try:
        return with_settings(family, _class(family, kind, folder), value, folder)
    except ConfigError as error:
        raise _words(str(error).removeprefix("kind: ")) from error


def with_settings(family: Family, part: Any, settings: Mapping[str, Any], folder: str | Path | None = None) -> Any:
    """Return the settings of a part's class, read from plain values; for a family with given fields ``part`` with them.

    Raises the errors of pydantic, and ConfigError for a field of a type that no setting can have.
    """
    read = section(family, part).model_validate(settings, context={"code": folder})
    values = {name: getattr(read, name) for name in type(read).model_fields if name != "kind"}
    return partial(part, **values) if family.given else _made(settings_type(part), values)


def _made(holder: Any, given: Mapping[str, Any]) -> Any:
    """Return the settings, once it is known that a part can be built with them."""
    try:
        settings = holder(**given)
        built(settings)
    except (DynidentError, ValueError) as error:
        raise ValueError(str(error)) from error
    except Exception as error:  # of a class of the user's
        raise ValueError(f"{type(error).__name__}: {error}") from error
    return settings


def _class(family: Family, kind: object, folder: str | Path | None) -> Any:
    if not isinstance(kind, str):
        raise ConfigError(f"{kind!r} is not a choice; {choices(str(kind), family.kinds())}")
    place, colon, name = kind.rpartition(":")
    if not (colon and place.endswith(".py")):
        return family.get(kind)
    if folder is None:
        raise ConfigError(f"{kind!r} {CODE}")
    path = located(folder, place, family.name, ConfigError)
    part = from_file(path, name, "class", family.name, ConfigError)
    family.check(part, f"{path}: {name}")
    return part


def _words(text: str) -> PydanticCustomError:
    return PydanticCustomError("words", "{words}", {"words": text})


def _setting(hint: Any, where: str) -> Any:
    """Return the annotation that reads a value of the type of a part's field as YAML gives it."""
    if (family := family_of(hint)) is not None:
        return Annotated[Any, PartReader(family, nested=True), AfterValidator(built)]
    if (read := GENERIC.get(get_origin(hint))) is not None:
        return read(get_args(hint), where)
    if get_origin(hint) is None and hint in SCALARS:
        return SCALARS[hint]
    if _is_enum(hint):
        return hint
    raise ConfigError(f"{where} has the type {hint}; a setting is a number, a text, or a list or mapping of them.")


def _annotated(inside: tuple[Any, ...], where: str) -> Any:
    base, *marks = inside
    kept = [mark for mark in marks if not isinstance(mark, str)]
    return Annotated[(_setting(base, where), *kept)] if kept else _setting(base, where)


def _tuple(inside: tuple[Any, ...], where: str) -> Any:
    return tuple[tuple(one if one is Ellipsis else _setting(one, where) for one in inside)]  # type: ignore[misc]


def _union(inside: tuple[Any, ...], where: str) -> Any:
    return _either([(one, _setting(one, where)) for one in inside])


def _mapping(inside: tuple[Any, ...], where: str) -> Any:
    return Mapping[Name, _setting(inside[1], where)]  # type: ignore[misc]


GENERIC: Mapping[Any, Callable[[tuple[Any, ...], str], Any]] = {
    Annotated: _annotated,
    Union: _union,
    UnionType: _union,
    Literal: lambda inside, _: Literal[inside],
    tuple: _tuple,
    list: lambda inside, where: list[_setting(inside[0], where)],  # type: ignore[misc]
    Sequence: lambda inside, where: _tuple((inside[0], ...), where),
    Mapping: _mapping,
    dict: _mapping,
}


def _is_text(hint: Any) -> bool:
    return get_origin(hint) is Literal or hint is str or _is_enum(hint)


def _is_enum(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, Enum)


def _number(value: object) -> float:
    """Read a number, which may be infinite."""
    if not math.isnan(number := as_number(value)):
        return number
    raise ValueError("a number is expected")


def _whole(value: object) -> int:
    number = _number(value)
    if math.isinf(number) or number != int(number):
        raise ValueError("a whole number is expected")
    return int(number)


SCALARS: Mapping[Any, Any] = {
    float: Annotated[float, Field(allow_inf_nan=True), BeforeValidator(_number)],
    int: Annotated[int, BeforeValidator(_whole)],
    bool: StrictBool,
    str: Name,
    NoneType: NoneType,
}


def _either(options: list[tuple[Any, Any]]) -> Any:
    """Return the union of types as one that looks at the shape of a value only, so that errors have its place."""
    annotations = [annotation for _, annotation in options]

    @cache
    def adapter(k: int) -> TypeAdapter[Any]:
        return TypeAdapter(annotations[k])

    def read(value: object, _: Callable[[Any], Any], info: ValidationInfo) -> Any:
        fitting = [k for k, (hint, _) in enumerate(options) if _fits(hint, value)]
        main = next(k for k, (hint, _) in enumerate(options) if hint is not NoneType)
        return adapter((fitting or [main])[0]).validate_python(value, context=info.context)

    return Annotated[Union[tuple(annotations)], WrapValidator(read)]  # noqa: UP007


def _fits(hint: Any, value: object) -> bool:
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
