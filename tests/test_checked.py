"""The checks of array annotations refuse what jaxtyping's own decorator refuses, and no more."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from beartype import beartype
from checked import checked
from jaxtyping import Float, TypeCheckError
from jaxtyping._decorator import jaxtyped as jaxtypings_own

Row, Rows = Float[np.ndarray, " n"], Float[np.ndarray, "m n"]


def made(decorator):
    """A function, a dataclass and a class, decorated as the import hook decorates a module."""
    check = decorator(typechecker=beartype)

    @check
    def stack(a: Row, b: Row, *, add: float = 0.0) -> Rows:
        return np.stack([a, b]) + add if add >= 0 else a

    @check
    def each(a: Rows) -> Iterator[Row]:
        yield from a

    @check
    @dataclass(frozen=True, slots=True)
    class Pair:
        left: Row
        right: Row

        @property
        @check
        def both(self) -> Row:
            return self.left + self.right if self.left[0] else None

        @classmethod
        @check
        def twice(cls, left: Row) -> "Pair":
            return cls(left, left[:1])

    return stack, each, Pair


CALLS = {  # whether a call is refused, and the call
    "well": (False, lambda stack, each, Pair: stack(np.zeros(3), np.ones(3), add=1.0)),
    "well, other lengths": (False, lambda stack, each, Pair: stack(np.zeros(2), b=np.ones(2))),
    "well, inside": (False, lambda stack, each, Pair: stack(*each(stack(np.ones(5), np.ones(5))))),
    "one axis of two lengths": (True, lambda stack, each, Pair: stack(np.zeros(3), np.ones(2))),
    "whole numbers": (True, lambda stack, each, Pair: stack(np.zeros(3), np.ones(3, dtype=int))),
    "an axis too many": (True, lambda stack, each, Pair: stack(np.zeros((3, 1)), np.ones(3))),
    "no array": (True, lambda stack, each, Pair: stack([0.0], np.ones(1))),
    "no number": (True, lambda stack, each, Pair: stack(np.zeros(3), np.ones(3), add="1")),
    "a row returned for rows": (
        True,
        lambda stack, each, Pair: stack(np.zeros(3), np.ones(3), add=-1.0),
    ),
    "a well-made pair": (False, lambda stack, each, Pair: Pair(np.ones(3), np.ones(3)).both),
    "a pair of two lengths": (True, lambda stack, each, Pair: Pair(np.ones(3), np.ones(2))),
    "a property of no array": (True, lambda stack, each, Pair: Pair(np.zeros(1), np.ones(1)).both),
    "made by its class": (False, lambda stack, each, Pair: Pair.twice(np.ones(1))),
    "made by its class of two lengths": (True, lambda stack, each, Pair: Pair.twice(np.ones(2))),
    "given to a generator": (True, lambda stack, each, Pair: list(each(np.ones(3)))),
}


@pytest.mark.parametrize("decorator", [checked, jaxtypings_own])
@pytest.mark.parametrize("refused, call", CALLS.values(), ids=CALLS)
def test_a_call_is_refused_as_by_jaxtyping_itself(refused, call, decorator):
    if not refused:
        call(*made(decorator))
        return
    with pytest.raises(Exception) as told:
        call(*made(decorator))
    assert isinstance(told.value, TypeCheckError) or "beartype" in type(told.value).__module__


def test_what_the_tests_import_is_checked_at_every_call():
    from graycast.frames import transform_points

    with pytest.raises(Exception, match="violates type hint"):
        transform_points(np.eye(4), np.zeros((5, 2)))
