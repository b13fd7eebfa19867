"""Make sections of files from dataclasses, with the same keys, bounds and descriptions."""

import math
from collections.abc import Mapping
from dataclasses import MISSING
from typing import Any, TypeVar

from pydantic import Field, GetPydanticSchema, create_model
from pydantic.fields import FieldInfo

from .settings import Settings, declared_fields

Base = TypeVar("Base", bound=Settings)


def section_of(
    dataclass: type,
    name: str,
    *,
    module: str,
    about: str,
    base: type[Base],
    more: Mapping[str, Any],
) -> type[Base]:
    """Return a section with the fields of a dataclass; fields without a default are required.

    A field whose default is infinite becomes an optional key, because files contain no infinity.

    Args:
        dataclass: a dataclass with `Field` in its annotations.
        name: name of the section.
        module: `__name__` of the module in which pickle finds the section by its name.
        about: description of the section in its schema.
        base: base class of the section.
        more: extra or replacement fields as (annotation, field); None leaves out a field of the
            dataclass.
    """
    own: dict[str, Any] = {}
    for key, hint, info, default in declared_fields(dataclass):
        if default == math.inf:
            own[key] = _may_miss(hint, info)
        else:
            own[key] = (hint, _field(... if default is MISSING else default, info))
    content = {key: field for key, field in (own | dict(more)).items() if field is not None}
    return create_model(name, __base__=base, __doc__=about, __module__=module, **content)


def changes_of(dataclass: type, name: str, *, module: str, about: str) -> type[Settings]:
    """Return a section of changes, in which each field of a dataclass may be left out."""
    own: dict[str, Any] = {
        key: _may_miss(hint, info) for key, hint, info, _ in declared_fields(dataclass)
    }
    return create_model(name, __base__=Settings, __doc__=about, __module__=module, **own)


def read_as(section: type[Any]) -> GetPydanticSchema:
    """Return an annotation that makes pydantic read a field as a section made at run time."""
    return GetPydanticSchema(lambda source, handler: handler(section))


def _may_miss(hint: Any, info: FieldInfo) -> tuple[Any, Any]:
    return hint | None, _field(None, info)


def _field(default: Any, info: FieldInfo) -> Any:
    return Field(default=default, description=info.description)
