"""Readers for argument values (numbers, sizes and lengths), which refuse any other text."""

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

Value = TypeVar("Value")


def reader(
    read: Callable[[str], Value], allowed: Callable[[Value], bool], what: str
) -> Callable[[str], Value]:
    """Return a function that converts a text and refuses it if it is not `what`."""

    def checked(text: str) -> Value:
        try:
            value = read(text)
            fits = allowed(value)
        except ValueError:
            fits = False
        if not fits:
            raise argparse.ArgumentTypeError(f"{text!r} is not {what}")
        return value

    return checked


def numbers(text: str, separator: str = ",") -> tuple[float, ...]:
    return tuple(map(float, text.lower().split(separator)))


def _digits(text: str) -> int:
    if not text.isdecimal():
        raise ValueError(text)
    return int(text)


def _above_zero(value: float) -> bool:
    return 0 < value < math.inf


whole = reader(_digits, lambda n: n >= 0, "a whole number of at least 0")
positive = reader(_digits, lambda n: n >= 1, "a whole number of at least 1")
above_zero = reader(float, _above_zero, "a number greater than 0")
share = reader(float, lambda x: 0 <= x <= 1, "a number from 0 to 1")
size = reader(
    lambda text: tuple(map(_digits, text.lower().split("x"))),
    lambda sides: len(sides) == 2,
    "a size such as 1280x720",
)


def metres(
    read: Callable[[str], Any], most_m: float, *, separator: str = ","
) -> Callable[[str], Any]:
    """Return a reader for lengths that refuses a length that was probably given in millimetres.

    Args:
        read: reader for one length, or for several lengths with the separator between them.
        most_m: largest plausible length.
    """

    def checked(text: str) -> Any:
        value = read(text)
        lengths_m = value if isinstance(value, tuple) else (value,)
        if max(map(abs, lengths_m)) > most_m:
            shorter = separator.join(f"{1e-3 * length_m:g}" for length_m in lengths_m)
            raise argparse.ArgumentTypeError(
                f"{text!r} is longer than {most_m:g} m: give metres; if these are millimetres, "
                f"give {shorter}"
            )
        return value

    return checked


length_m = metres(above_zero, 100.0)
sides_m = metres(
    reader(
        lambda text: numbers(text, "x"),
        lambda sides: len(sides) == 2 and all(map(_above_zero, sides)),
        "two lengths in metres such as 0.6x0.4",
    ),
    100.0,
    separator="x",
)
png_path = reader(
    Path, lambda path: path.suffix.lower() == ".png", "the name of a PNG file: end it with .png"
)
motion_m = metres(
    reader(
        numbers,
        lambda motion: len(motion) == 3 and all(map(math.isfinite, motion)),
        "three lengths in metres such as 0.001,0,0.0002",
    ),
    0.1,
)
distortion = reader(
    numbers, lambda k: len(k) == 5, "five numbers k1,k2,p1,p2,k3, separated by commas"
)


def export_format(name: str) -> str:
    """Return the name of an export format; refuse another name and suggest a valid one."""
    from ..dataset.export.options import FORMATS, no_format

    if name not in FORMATS:
        raise argparse.ArgumentTypeError(no_format(name))
    return name
