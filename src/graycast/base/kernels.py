"""Functions that Numba compiles, with the result kept on disk."""

import inspect
from collections.abc import Callable
from typing import Any

import numba


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator that compiles a function at its first call; `options` are those of `numba.njit`.

    The check of array annotations in tests wraps every function, and Numba cannot compile the
    wrapper: the function itself is compiled.
    """
    return lambda function: numba.njit(cache=True, **options)(inspect.unwrap(function))
