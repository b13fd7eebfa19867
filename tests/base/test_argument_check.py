"""A wrong argument of a public function is named in the error."""

import inspect
import pickle
import re
import typing
from collections.abc import Sequence
from dataclasses import dataclass, is_dataclass
from fractions import Fraction
from pathlib import Path
from types import FunctionType, UnionType
from typing import Literal, Union, get_args, get_origin
from unittest.mock import Mock

import numpy as np
import pytest

import graycast as gc
from graycast.base import argument_check
from graycast.base.argument_check import checked
from graycast.base.settings import check_fields

NOTHING = object()  # No annotation accepts this value.

# Classes that only the library makes: their arrays are checked in the functions that use them.
RESULTS = {
    "Capture", "Cell", "CodeMap", "DepthMap", "Detections", "Example", "FrameTruth", "GroundTruth",
    "Layout", "MaterialFit", "MaterialScan", "Radiance", "Rendering", "SceneResult", "ScannerFrame",
    "SettingRange", "Shot",
}  # fmt: skip


@pytest.fixture
def unchecked(request):
    """Skip a test if all annotations are checked, because that check comes first."""
    if request.config.getoption("jaxtyping_packages", None):
        pytest.skip("the check of all annotations answers before that of the door")


def right(hint):
    """Return a valid value for an annotation."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return right(inner[0])
    if origin is Literal:
        return inner[0]
    if origin is tuple:
        return tuple(right(one) for one in inner if one is not Ellipsis)
    if origin is not None:
        return (lambda: None) if "Callable" in str(origin) else []
    if hasattr(hint, "array_type"):
        return np.zeros(2)
    plain = {int: 2, float: 0.5, bool: True, str: "text", Path: Path("file"), type(None): None}
    return plain[hint] if hint in plain else Mock(spec=hint)


def doors():
    for name in gc.__all__[1:]:
        if name in ("train", "detect", "load_detector", "pictures_of", "TrainSpec"):
            pytest.importorskip("torch")
        value = getattr(gc, name)
        if isinstance(value, FunctionType):
            yield value, inspect.unwrap(value)
        elif isinstance(value, type) and is_dataclass(value) and name not in RESULTS:
            yield value, value


def test_the_error_for_an_argument_of_a_wrong_type_shows_its_value(unchecked):
    count = 0
    for door, source in doors():
        hints = typing.get_type_hints(source)
        parameters = inspect.signature(door).parameters
        required = [key for key, one in parameters.items() if one.default is one.empty]
        good = {key: right(hints[key]) for key in required}
        for key in parameters:
            words = (
                f"(^|: ){key} is <object object at 0x[0-9a-f]+>( \\(type object\\): give |: it )"
            )
            with pytest.raises(ValueError, match=words):
                door(**{**good, key: NOTHING})
            count += 1
    assert count > 200


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: gc.scenes("demo.yaml", 1), "scenes: cell is 'demo.yaml' (type str): give a Cell "
         "(graycast.load_cell returns one)"),
        (lambda: gc.scenes(Mock(spec=gc.Cell), 1, workers=2), "scenes: workers is 2 (type int): "
         "give a Workers (graycast.Workers(count=2) is one)"),
        (lambda: gc.load_cell({"rig": "paper"}), "load_cell: source is {'rig': 'paper'} (type "
         "dict): give a Config (graycast.Config(**settings) makes one of a dictionary) or a "
         "pathlib.Path or a string"),
        (lambda: gc.scenes(Mock(spec=gc.Cell), 1, seed=-1), "scenes: seed is -1: give a whole "
         "number from 0 on"),
        (lambda: gc.scenes(Mock(spec=gc.Cell), -1), "scenes: count is -1: give"),
        (lambda: gc.Workers(count=2.0), "count is 2.0 (type float): give a whole number"),
        (lambda: gc.Workers(count=True), "count is True (type bool): give a whole"),
        (lambda: gc.preset(3), "preset: name is 3 (type int): give a string"),
        (lambda: gc.preset(["x" * 100]), "preset: name is ['" + "x" * 55 + "... (type list)"),
    ],
)  # fmt: skip
def test_the_error_for_a_wrong_argument_names_a_remedy(unchecked, call, words):
    with pytest.raises(ValueError) as error:
        call()
    assert words in str(error.value)


@pytest.mark.parametrize("engine", ["local", "ray"])
@pytest.mark.parametrize("count", [-3, 0, 1])
def test_the_number_of_workers_is_at_least_one_except_on_a_cluster(engine, count):
    """-3 workers waited for ever, and 0 caused a division by zero."""
    if count < (engine == "local"):
        with pytest.raises(ValueError, match=f"count is {count}: give "):
            gc.Workers(engine=engine, count=count)
    else:
        assert gc.Workers(engine=engine, count=count).count == count


def test_numbers_from_other_libraries_and_lists_for_tuples_are_accepted():
    @dataclass(frozen=True)
    class Values:
        pair: tuple[float, float]
        names: Sequence[str]
        flag: bool | None
        count: int

        def __post_init__(self):
            check_fields(self)

    assert Values([Fraction(1, 2), np.float32(2.5)], ["a"], np.True_, np.int64(3)).count == 3
    wrong = ((1, 2, 3), ["a"], None, 1), ((1, 2), "a", None, 1), ((1, 2), ["a", 1], None, 1)
    for values in (*wrong, ((1, 2), [], 1, 1), ((1, 2), [], None, 1.0)):
        with pytest.raises(ValueError, match=r"^(pair|names|flag|count) is .* \(type .*: give "):
            Values(*values)


def test_the_error_for_an_unknown_argument_names_the_nearest_known_argument(unchecked):
    with pytest.raises(TypeError, match=r"scenes\(\) missing"):
        gc.scenes()
    with pytest.raises(gc.GraycastError, match=r"^scenes: unknown argument sed: did you mean seed"):
        gc.scenes(None, 1, sed=1)


def test_unpickling_a_public_function_gives_the_same_object():
    assert gc.take is gc.take and pickle.loads(pickle.dumps(gc.take)) is gc.take
    assert inspect.signature(gc.take) == inspect.signature(inspect.unwrap(gc.take))
    assert checked(inspect.unwrap(gc.take)).__doc__ == gc.take.__doc__


def test_remedies_in_errors_name_only_public_functions():
    for text in argument_check._MAKERS.values():
        assert set(re.findall(r"graycast\.(\w+)", text)) <= set(dir(gc))  # does not load PyTorch
