"""Array annotations checked at every call, at a fraction of what jaxtyping's decorator costs.

That one binds the arguments of each call and checks them a second time with the returned value, to
word an error that hardly ever comes; and it builds both checks at import, also for functions that
are never called. This one builds one check at the first call. What is checked is the same: each
argument and the returned value by beartype, and axes of one name have one length within a call.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import Any

import jaxtyping

AXES_OF_A_CALL = jaxtyping.jaxtyped("context")  # holds nothing itself: entered anew by each call


def checked(*, typechecker: Callable) -> Callable[[Any], Any]:
    """In place of `jaxtyping.jaxtyped`, with which its import hook decorates all that it meets."""
    return functools.partial(_checked, typechecker)


def _checked(typechecker: Callable, thing: Any) -> Any:
    match thing:
        case classmethod() | staticmethod():
            return type(thing)(_checked(typechecker, thing.__func__))
        case property():
            parts = (thing.fget, thing.fset, thing.fdel)
            return property(*(part and _checked(typechecker, part) for part in parts))
        case type():
            made_here = vars(thing).get("__init__")
            if dataclasses.is_dataclass(thing) and made_here is not None:
                thing.__init__ = _checked(typechecker, made_here)
            return thing
        case _ if inspect.isfunction(thing):
            return _checked_function(typechecker, thing)
    return thing


def _checked_function(typechecker: Callable, function: Callable) -> Callable:
    check = None

    @functools.wraps(function)
    def within_axes(*arguments, **named):
        nonlocal check
        __tracebackhide__ = True
        if check is None:
            function.__annotations__ = _known(function)
            check = typechecker(function)
        with AXES_OF_A_CALL:
            return check(*arguments, **named)

    return within_axes


def _known(function: Callable) -> dict[str, Any]:
    """The annotations but those with a name that only type checkers import: mypy checks these."""
    known = {}
    for name, hint in function.__annotations__.items():
        try:
            known[name] = eval(hint, function.__globals__) if isinstance(hint, str) else hint
        except NameError:
            continue
    return known
