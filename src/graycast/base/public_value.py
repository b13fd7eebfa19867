"""Give public values a one-line text and a readable help page, and refuse unknown keywords.

Arrays, pictures and nested settings would fill the screen. So an array is shown by its type and
shape, a field with its default value is left out, and "..." replaces text that is too long.
"""

import inspect
import types
from collections.abc import Collection, Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import cache, wraps
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from .argument_check import refuse_unknown

MOST_CHARACTERS = 200  # largest length of a value's text
_MOST_OF_TEXT, _MOST_ITEMS = 60, 4
_UNITS = {
    "m": "m", "mm": "mm", "px": "px", "s": "s", "rad": "rad", "deg": "degrees", "e": "electrons",
    "dn": "DN", "n": "N", "mm2": "mm^2", "m3": "m^3", "e_s": "electrons/s", "m_s": "m/s",
    "kg_m3": "kg/m^3", "dn_per_e": "DN/electron", "w_sr": "W/sr", "n_m": "N/m",
}  # fmt: skip

Value = TypeVar("Value")


def public_value(kind: type[Value]) -> type[Value]:
    """Give a public dataclass a text of one line and a help page, and refuse unknown keywords.

    A dataclass that is declared with `repr=False` keeps its own text.
    """
    build: Any = kind.__init__
    signature = inspect.signature(build)

    @wraps(build)
    def __init__(self: Value, *args: Any, **kwargs: Any) -> None:
        try:
            build(self, *args, **kwargs)
        except TypeError:
            refuse_unknown(kind.__name__, kwargs, signature)
            raise

    __init__.__doc__ = "\n".join(_field_lines(kind))
    plain = [one.replace(annotation=inspect.Parameter.empty) for one in _parameters(signature)]
    __init__.__signature__ = inspect.Signature(plain)  # type: ignore[attr-defined]
    changed: Any = kind
    changed.__init__ = __init__
    if changed.__dataclass_params__.repr:
        changed.__repr__ = one_line
    return kind


def _parameters(signature: inspect.Signature) -> Collection[inspect.Parameter]:
    return signature.parameters.values()


def one_line(value: object) -> str:
    """Return a one-line text of at most `MOST_CHARACTERS`, with as many nested levels as fit."""
    for depth in (3, 2, 1):
        text = _value_text(value, depth)
        if len(text) <= MOST_CHARACTERS:
            return text
    name, parts = type(value).__name__, [f"{key}=..." for key, _ in _own_fields(value)]
    while len(text) > MOST_CHARACTERS:
        parts = [*parts[: -2 if parts[-1] == "..." else -1], "..."]
        text = f"{name}({', '.join(parts)})"
    return text


def _text(value: Any, depth: int) -> str:
    if is_dataclass(value) or hasattr(type(value), "model_fields"):
        if not isinstance(value, type):
            params = getattr(type(value), "__dataclass_params__", None)
            if params is not None and not params.repr:
                return repr(value)
            return _value_text(value, depth)
    if hasattr(value, "dtype") and getattr(value, "shape", None):
        return f"{value.dtype}[{', '.join(map(str, value.shape))}]"
    if hasattr(value, "item") and getattr(value, "shape", None) == ():
        return repr(value.item())
    if isinstance(value, Enum):
        return f"{type(value).__name__}.{value.name}"
    if isinstance(value, type | types.FunctionType):
        return value.__name__
    if isinstance(value, Mapping):
        return f"{{{len(value)} keys}}" if value else "{}"
    if isinstance(value, tuple | list):
        if len(value) > _MOST_ITEMS:
            return f"({_text(value[0], depth - 1)}, ... {len(value)} items)"
        comma = "," if len(value) == 1 else ""
        return f"({', '.join(_text(item, depth) for item in value)}{comma})"
    text = " ".join(repr(value).split())
    return text if len(text) <= _MOST_OF_TEXT else text[: _MOST_OF_TEXT - 3] + "..."


def _value_text(value: Any, depth: int) -> str:
    name, own = type(value).__name__, list(_own_fields(value))
    if own and depth <= 0:
        return f"{name}(...)"
    return f"{name}({', '.join(f'{key}={_text(item, depth - 1)}' for key, item in own)})"


def _own_fields(value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the fields whose values are not their defaults."""
    kind: Any = type(value)  # `Any`, because mypy doubts that a type is hashable
    for key, default in _defaults(kind).items():
        item = getattr(value, key)
        if not _same(item, default):
            yield key, item


@cache  # pydantic makes a deep copy of a default for each call of `get_default`.
def _defaults(kind: Any) -> Mapping[str, Any]:
    sections = getattr(kind, "model_fields", None)
    if sections is None:
        return {field.name: _default(field) for field in fields(kind) if field.repr}
    return {key: info.get_default(call_default_factory=True) for key, info in sections.items()}


def _default(field: Any) -> Any:
    return field.default if field.default_factory is MISSING else field.default_factory()


def _same(item: Any, default: Any) -> bool:
    if item is default:
        return True
    try:
        return type(item) is type(default) and bool(item == default)
    except ValueError:  # A comparison of arrays has no single truth value.
        return False


# --- help --------------------------------------------------------------------------------------


def _field_lines(kind: Any) -> Iterator[str]:
    """Yield a line for each field: name, unit, type, default and meaning."""
    for field in fields(kind):
        if field.init:
            about = [getattr(item, "description", None) for item in get_args(field.type)[1:]]
            yield field_line(field.name, field.type, field.default, next(filter(None, about), ""))


def field_line(name: str, hint: Any, default: Any, meaning: str) -> str:
    """Return a field's line on a help page; MISSING means no default."""
    unit = f" [{unit_of(name)}]" if unit_of(name) else ""
    has = "" if default is MISSING else f" = {_text(default, 1)}"
    return f"{name}{unit} ({type_text(hint)}{has})" + (f": {meaning}" if meaning else "")


def unit_of(name: str) -> str:
    """Return the unit at the end of a field's name; empty if there is none."""
    words = name.split("_")
    ends = ("_".join(words[k:]) for k in range(1, len(words)))
    return next((_UNITS[end] for end in ends if end in _UNITS), "")


def type_text(hint: Any) -> str:
    """Return an annotation in words; an array is described by its kind of numbers and its axes."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return type_text(inner[0])
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(map(type_text, inner)))
    if origin is Literal:
        return " or ".join(map(repr, inner))
    if origin is not None:
        name = getattr(origin, "__name__", str(origin))
        return f"{name} of {', '.join('...' if i is ... else type_text(i) for i in inner)}"
    if hasattr(hint, "dim_str") and hasattr(hint, "array_type"):
        dtypes = "any kind" if isinstance(hint.dtypes, type) else _numbers(hint)
        return f"array of {dtypes} [{', '.join(hint.dim_str.split())}]"
    if hint is None or hint is type(None):
        return "None"
    return hint if isinstance(hint, str) else getattr(hint, "__name__", str(hint))


def _numbers(hint: Any) -> str:
    name = hint.__name__.partition("[")[0]  # jaxtyping: Float32[ndarray, 'h w']
    return {"Float": "floats", "Int": "integers", "Bool": "bools"}.get(name, name.lower())
