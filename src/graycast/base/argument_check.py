"""Check the arguments of public functions; an error names the argument of the wrong type.

Without a check, a string instead of a cell causes an error only deep inside, and the message does
not name the caller's argument. Public functions check their arguments against their annotations. An
array may be anything that NumPy converts to one; tests check its axes and its dtype.
"""

import difflib
import inspect
import sys
import types
import typing
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from functools import cache, wraps
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin

from .errors import ArgumentError
from .progress import StatusLine, is_watched

P = ParamSpec("P")
R = TypeVar("R")

MOST_CHARACTERS = 60  # Error messages shorten longer values.

_NOT_NEGATIVE = ("seed", "scene_id", "count", "scenes", "bins")
_WORDS = {
    bool: "True or False", int: "a whole number", float: "a number", str: "a string",
    Path: "a pathlib.Path", type(None): "None",
}  # fmt: skip
_MAKERS = {  # An error says how a script gets a value of these types.
    "Cell": "graycast.load_cell returns one",
    "Config": "graycast.Config(**settings) makes one of a dictionary",
    "Detector": "graycast.load_detector returns one",
    "Optics": "the camera of a rig is one",
    "PickCell": "graycast.resolve_pick_cell returns one",
    "PickConfig": "graycast.load_pick_config returns one",
    "PictureSelection": "graycast.pictures_of returns one",
    "PoseModel": "graycast.pose_model returns one",
    "Reflections": "graycast.open_scan(path).observations() returns one",
    "Renderer": "graycast.open_renderer returns one",
    "Rig": "graycast.preset(name).rig is one",
    "Scanner": "graycast.preset and graycast.load_scanner return one",
    "Source": "graycast.open_source returns one",
    "Workers": "graycast.Workers(count=2) is one",
}


@cache
def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Return a wrapper of a public function that refuses arguments that do not fit its annotations.

    The wrapper raises an ArgumentError that names the argument, its value and the remedy, even for
    negative seeds and counts and for unknown arguments. For the same function, the result is always
    the same object, which pickle finds in the package. If a function has an argument `progress`
    that the caller does not give, its progress is shown in one line of a terminal or notebook.
    """
    plain = inspect.unwrap(function)
    signature = inspect.signature(plain)
    check = _checker(plain.__name__, plain, signature)
    tells = "progress" in signature.parameters

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        check(args, kwargs)
        if not tells or "progress" in kwargs or not is_watched(sys.stderr):
            return function(*args, **kwargs)
        return _with_line(function, args, kwargs, StatusLine(sys.stderr))

    call.__module__ = __name__.partition(".")[0]
    return call


def _with_line(function: Any, args: Any, kwargs: Any, line: StatusLine) -> Any:
    """Call a function and show its progress in a line, which is cleared before each yield."""

    def each(values: Generator[Any, Any, Any]) -> Iterator[Any]:
        with closing(values):
            try:
                for value in values:
                    line.clear()
                    yield value
            finally:
                line.clear()

    try:
        result = function(*args, **kwargs, progress=line)
    finally:
        line.clear()
    return each(result) if isinstance(result, Generator) else result


def _checker(
    name: str, source: Any, signature: inspect.Signature
) -> Callable[[tuple[Any, ...], Mapping[str, Any]], None]:
    @cache
    def hints() -> dict[str, Any]:  # Evaluated late, because an annotation may name a later class.
        return typing.get_type_hints(source)

    def check(args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> None:
        try:
            values = signature.bind(*args, **kwargs).arguments
        except TypeError:
            refuse_unknown(name, kwargs, signature)
            return  # An argument is missing or given twice: the call itself raises a TypeError.
        for argument, value in values.items():
            hint = hints()[argument]
            if not fits(value, hint):
                raise ArgumentError(
                    f"{name}: {argument} is {value_text(value)}: give {words(hint)}"
                )
            if argument in _NOT_NEGATIVE and value is not None and value < 0:
                raise ArgumentError(f"{name}: {argument} is {value}: give a whole number from 0 on")

    return check


def refuse_unknown(name: str, keywords: Collection[str], signature: inspect.Signature) -> None:
    """Refuse keywords that a function or a class does not have, and name a similar known keyword.

    Raises:
        ArgumentError: one of the keywords is unknown.
    """
    known = [key for key in signature.parameters if key != "self"]
    for key in keywords:
        if key not in known:
            raise ArgumentError(f"{name}: unknown argument {key}: {nearest(key, known)}")


def nearest(word: str, known: Collection[str]) -> str:
    """Return a question that suggests a similar known word, or else a list of all known words."""
    near = difflib.get_close_matches(word, known, n=1)
    return f"did you mean {near[0]}?" if near else f"the keys are {', '.join(known)}"


def fits(value: Any, hint: Any) -> bool:
    """Return whether a value has the kind that an annotation names; true if it names no kind."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return any(fits(value, one) for one in inner)
    if origin is Literal:
        return any(isinstance(value, type(one)) for one in inner)  # The callee checks the values.
    if origin is tuple:
        if not isinstance(value, tuple | list):
            return False
        if inner[-1:] == (Ellipsis,):
            return all(fits(one, inner[0]) for one in value)
        return len(value) == len(inner) and all(map(fits, value, inner))
    if origin is type:
        return isinstance(value, type) and issubclass(value, inner[0])
    if isinstance(origin, type) and issubclass(origin, Callable):  # type: ignore[arg-type]
        return callable(value)
    if isinstance(origin, type) and issubclass(origin, Sequence | Iterable):
        right = isinstance(value, origin) and not isinstance(value, str | bytes)
        if isinstance(value, tuple | list) and len(inner) == 1:
            return right and all(fits(one, inner[0]) for one in value)
        return right
    if _is_array(hint):
        return isinstance(value, tuple | list) or hasattr(value, "__array__")
    if not isinstance(hint, type):
        return True
    if hint is bool:
        return isinstance(value, bool) or getattr(getattr(value, "dtype", None), "kind", "") == "b"
    if hint in (int, float):
        return isinstance(value, Integral if hint is int else Real) and not isinstance(value, bool)
    if getattr(hint, "_is_protocol", False) and not getattr(hint, "_is_runtime_protocol", False):
        return True
    return isinstance(value, hint)


def _is_array(hint: Any) -> bool:
    """Return whether an annotation is an array type with named axes."""
    return isinstance(hint, type) and hasattr(hint, "array_type")


def words(hint: Any) -> str:
    """Return a description in words of the values that an annotation allows."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return " or ".join(words(one) for one in inner)
    if origin is Literal:
        return "one of " + ", ".join(map(repr, inner))
    if origin is tuple:
        several = inner[-1:] == (Ellipsis,)
        return (
            f"a tuple, each {words(inner[0])}"
            if several
            else f"{len(inner)} values, each " + (" or ".join(dict.fromkeys(map(words, inner))))
        )
    if origin is type:
        return f"a subclass of {inner[0].__name__}"
    if isinstance(origin, type) and issubclass(origin, Callable):  # type: ignore[arg-type]
        return "a function"
    if isinstance(origin, type) and issubclass(origin, Sequence | Iterable) and len(inner) == 1:
        return f"a list, each {words(inner[0])}"
    if _is_array(hint):
        return "an array"
    name = getattr(origin or hint, "__name__", str(hint))
    maker = f" ({_MAKERS[name]})" if name in _MAKERS else ""
    return _WORDS.get(hint) or f"a {name}{maker}"


def value_text(value: Any) -> str:
    """Return a text with a value and its type; a long value is shortened."""
    text = " ".join(repr(value).split())
    if len(text) > MOST_CHARACTERS:
        text = text[: MOST_CHARACTERS - 3] + "..."
    return text if value is None else f"{text} (type {type(value).__name__})"
