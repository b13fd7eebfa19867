"""The help page of a section of a file: its keys, instead of the methods of its base class."""

import inspect
from collections.abc import Iterator
from dataclasses import MISSING, is_dataclass
from functools import wraps
from typing import TYPE_CHECKING, Any, get_args

from pydantic import BaseModel

from .public_value import field_line

if TYPE_CHECKING:  # Type checkers get the keywords of a model from pydantic's own metaclass.
    from pydantic._internal._model_construction import ModelMetaclass

    SectionType = ModelMetaclass
else:

    class SectionType(type(BaseModel)):
        """The class of sections, which gives them a help page and lists only their own names."""

        def __init__(cls, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            if cls.model_fields:
                _give_help(cls)

        def __dir__(cls) -> list[str]:
            mro = cls.__mro__
            own = [vars(kind) for kind in mro[: mro.index(BaseModel)]]
            names = {name for each in own for name in each if name[0] != "_"}
            return [*sorted(names - {"model_config"}), "__init__"]


def _give_help(section: Any) -> None:
    """Give a section's `__init__` a docstring with all keys, their units, defaults and meaning."""
    base: Any = section.__init__

    @wraps(base)
    def __init__(self: Any, **settings: Any) -> None:
        base(self, **settings)

    __init__.__doc__ = "\n".join(_lines(section))
    section.__init__ = __init__
    section.__signature__ = _signature(section)


def _default(info: Any, missing: Any) -> Any:
    return missing if info.is_required() else info.get_default(call_default_factory=True)


def _lines(section: Any) -> Iterator[str]:
    """Yield a line for each key of a pydantic model, as for the fields of a public value.

    If a key has no description but contains a section, the summary of that section is used.
    """
    for name, info in section.model_fields.items():
        hint, default = info.annotation, _default(info, MISSING)
        if isinstance(default, BaseModel) and not get_args(hint):
            hint = type(default)  # A section made at run time is in no annotation.
        about = (_first_sentence(kind) for kind in _sections_in(hint))
        yield field_line(name, hint, default, info.description or next(about, ""))


def _signature(section: Any) -> inspect.Signature:
    """Return the keywords of a pydantic model and their defaults, without types."""
    return inspect.Signature(
        [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=_default(info, inspect.Parameter.empty),
            )
            for name, info in section.model_fields.items()
        ]
    )


def _sections_in(hint: Any) -> Iterator[Any]:
    """Yield the pydantic models and dataclasses that an annotation names."""
    if hasattr(hint, "model_fields") or is_dataclass(hint):
        yield hint
    for inner in get_args(hint):
        yield from _sections_in(inner)


def _first_sentence(kind: Any) -> str:
    return " ".join((kind.__doc__ or "").split("\n\n")[0].split())
