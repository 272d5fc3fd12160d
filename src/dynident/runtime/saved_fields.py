"""How the fields of a noun stand in a saved result: marks of their types, which pydantic asks when a result is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from typing import TYPE_CHECKING, Any, get_args

from dynident.runtime.families import part_family, settings_hints

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, TypeAdapter, ValidationInfo
    from pydantic_core import CoreSchema


class Axes:
    """Marks an array, as ``Annotated[Array, Axes("p", "n")]``: a list of numbers in a file, of lists for two axes.

    The sizes are compared with those that the validation context has in ``sizes`` by these names.
    """

    def __init__(self, *names: str | int) -> None:
        self.names = names

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        import numpy as np
        from pydantic_core import core_schema

        (dtype,) = get_args(get_args(source)[1])
        schema: CoreSchema = core_schema.int_schema() if issubclass(dtype, np.integer) else core_schema.float_schema()
        for _ in self.names:
            schema = core_schema.list_schema(schema)

        def read(rows: list[Any], info: ValidationInfo) -> NDArray[Any]:
            """Return the array of the rows; ValueError where it has another shape."""
            sizes = (info.context or {}).get("sizes", {})
            shape = tuple(sizes.get(name, name) for name in self.names)
            try:
                array = np.array(rows, dtype)
                if not array.size:  # rows without entries do not tell how many they are
                    array = array.reshape([size if isinstance(size, int) else 0 for size in shape])
            except (ValueError, OverflowError) as error:
                raise ValueError(f"has not the shape ({', '.join(map(str, shape))})") from error
            if any(isinstance(size, int) and size != count for size, count in zip(shape, array.shape, strict=True)):
                raise ValueError(f"has not the shape ({', '.join(map(str, shape))})")
            return array

        return core_schema.with_info_after_validator_function(read, schema)


class OmittedField:
    """Marks a field, as ``Annotated[Log, OMITTED]``, that a file leaves out, or has at another place.

    It is read as its default, or as None, for whoever reads the file to replace.
    """

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema

        return core_schema.with_default_schema(core_schema.no_info_plain_validator_function(_refuse), default=None)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        from pydantic_core import PydanticOmit

        raise PydanticOmit


OMITTED = OmittedField()


def _refuse(_: object) -> None:
    raise ValueError("is not read from a file")


class TaggedUnion:
    """Base of a family of dataclasses that a file tells apart by their ``kind``, the name of the class."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema

        if TaggedUnion not in cls.__bases__:
            return handler(source)
        return core_schema.no_info_plain_validator_function(cls._read_kind)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return handler(schema) if TaggedUnion not in cls.__bases__ else dict(TAGGED_SCHEMA)

    @classmethod
    def _read_kind(cls, value: object) -> Any:
        if not isinstance(value, Mapping):
            raise ValueError("a mapping with a `kind` is expected")
        # only classes of the family: a file must not make anything else be built
        classes: dict[str, Any] = {subclass.__name__: subclass for subclass in _subclasses(cls)}
        kind = value.get("kind")
        if not isinstance(kind, str) or kind not in classes:
            raise ValueError(f"{kind!r} is no kind of {cls.__name__} that is known")
        return _adapter(classes[kind]).validate_python(dict(value))


TAGGED_SCHEMA = {"type": "object", "properties": {"kind": {"type": "string"}}, "required": ["kind"]}


def _subclasses(cls: type) -> list[type[Any]]:
    direct: list[type[Any]] = cls.__subclasses__()
    return [subclass for child in direct for subclass in (child, *_subclasses(child))]


@cache
def _adapter(cls: Any) -> TypeAdapter[Any]:
    from pydantic import TypeAdapter

    return TypeAdapter(cls)


class Part:
    """Base of the parts of a family: a file has their ``kind`` and settings, which ``build`` of the validation context
    takes with the family."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema

        def read(value: object, info: ValidationInfo) -> Any:
            """Return the part; raises the errors of ``build``."""
            return (info.context or {})["build"](part_family(cls), value)

        return core_schema.with_info_plain_validator_function(read)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return dict(TAGGED_SCHEMA)


@cache
def saved_fields(cls: type) -> tuple[str, ...]:
    """Return the names of the fields of a dataclass that a file has."""
    hints = settings_hints(cls)
    return tuple(field.name for field in fields(cls) if OMITTED not in getattr(hints[field.name], "__metadata__", ()))
