"""How large the project may be: what a person can hold in the head stays so because it is a test.

Each number in a table is what the project has today. It may be made smaller at any time, and a
commit that makes it larger says why.
"""

import ast
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from parsed import nodes_of

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "graycast"

# Scanner depth for datasets of others took 2,750 lines: readers of four layouts and their models
# 1,080, staging 330, the run and its folder 480, checks and records 270, the command 140, its page
# 170, and 100 for a solid with few triangles. The shelf of scanners took 300, mostly its search.
# Metal under oil took 210: a material of its own for Mitsuba has 140 of them. The stated background
# of rescans and the names of their objects took 65, and a history that follows its checkpoint 5.
MOST_LINES = 74_160
# These are the words in README.md and the pages of docs. Of the last 3,300 the shelf's table with
# its sources has 1,700, the page of rescans 1,050, oil 200, and detectors on rescanned depth 250.
MOST_WORDS = 44_850
FILE_LINES, FUNCTION_LINES, ARGUMENTS = 400, 80, 8

# What is larger than that, with its size. A kernel of Numba has its arrays as arguments.
LONG_FILES: dict[str, int] = {}
LONG_FUNCTIONS: dict[str, int] = {}
MANY_ARGUMENTS = {
    "cell/generate.py generate": 9,
    "robot/grasp_labels/label_run.py label_dataset": 9,
    "robot/pick/pick_run.py pick": 9,
}


@cache
def sources() -> dict[str, str]:
    """The text of each file, by its path from the package's folder."""
    paths = sorted(SOURCE.rglob("*.py"))
    return {path.relative_to(SOURCE).as_posix(): path.read_text() for path in paths}


@cache
def definitions() -> list[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef]]:
    """Each function and class, with its file."""
    kinds = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
    return [
        (name, node)
        for name in sources()
        for node in nodes_of(SOURCE / name)
        if isinstance(node, kinds)
    ]


def functions() -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Each function's file and name, and its tree."""
    for name, node in definitions():
        if not isinstance(node, ast.ClassDef):
            yield f"{name} {node.name}", node


def arguments(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    parameters = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    return len(parameters) - (bool(parameters) and parameters[0].arg in ("self", "cls"))


SIZES = {
    "lines of a file": (
        FILE_LINES,
        LONG_FILES,
        lambda: {name: len(text.splitlines()) for name, text in sources().items()},
    ),
    "lines of a function": (
        FUNCTION_LINES,
        LONG_FUNCTIONS,
        lambda: {name: (node.end_lineno or 0) - node.lineno + 1 for name, node in functions()},
    ),
    "arguments of a function": (
        ARGUMENTS,
        MANY_ARGUMENTS,
        lambda: {name: arguments(node) for name, node in functions()},
    ),
}


@pytest.mark.parametrize("what", SIZES)
def test_what_is_larger_than_its_limit_is_listed_with_its_size(what):
    limit, listed, measure = SIZES[what]
    larger = {name: size for name, size in measure().items() if size > limit}
    assert larger == listed, f"{what}: at most {limit}; the list may only become shorter"


def test_public_classes_have_names_of_their_own():
    places = defaultdict(list)
    for name, node in definitions():
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            places[node.name].append(name)
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


def test_the_package_and_its_pages_grow_by_a_reason_alone():
    """A change that needs more room raises the number here, and its commit says why."""
    assert sum(len(text.splitlines()) for text in sources().values()) <= MOST_LINES
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    assert sum(len(page.read_text().split()) for page in pages) <= MOST_WORDS
