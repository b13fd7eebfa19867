"""Limit the size of the project, so that one person can still understand it as a whole.

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

# It was 74,160 before every file was read for what could go, and 71,766 after. A file, a function
# or an option that comes needs a reason here, with its lines. What came since ended faults in
# silence: 1,000 lines read labels, depth and models as tools of others leave them or refuse them
# in true sentences, 450 say whether what goes on has the same inputs, 400 find a calibration whose
# devices moved, 350 compile kernels by the digest of all their sources, 250 check the arguments of
# Python's door, 250 give each number of the shelf its source, 1,000 find what moved, became
# brighter, came in another order or was computed between the pictures of a stack. Then 350 choose
# exposures and say what gives the parts depth, 350 choose a scanner whose picture the bin fills and
# draw that part of it, 450 print public values, refuse unknown keywords and take a user's own code,
# 350 enlarge drawings and keep legends and names apart, 400 say which settings do nothing, meet
# rays and planes in compiled loops, refuse millimetres, and cut jaws by the whole finger;
# 200 name two exchanged phase pictures, 60 a camera that moves in half of a stack. Then 2,100 went:
# checks for forged files, films, RF-DETR, labels and arms as code, and two layouts of exports.
# 1,000 fit a material to a scan, 350 scatter a metal's light and vary its reflectance, and 100 give
# a staged surface smooth normals. 400 continue planes into highlights and fit mottle, 300 divide a
# scan into materials, and 100 name array types for editors.
MOST_LINES = 78_600
# These are the words in README.md and the pages of docs that people write. 44,000 describe the
# program without the materials of scans; 1,800 came with these: how a material is fitted and used,
# tables of known materials and of classes, a scan of metal simulated again, and depth at edges.
MOST_WORDS = 45_800
FILE_LINES, FUNCTION_LINES, ARGUMENTS = 400, 80, 8

# These exceptions are larger, with their sizes. A run's last arguments receive its progress.
LONG_FILES: dict[str, int] = {}
LONG_FUNCTIONS: dict[str, int] = {}
MANY_ARGUMENTS = {
    "cell/generate.py generate": 9,
    "robot/grasp_labels/label_run.py label_dataset": 9,
    "robot/pick/pick_run.py pick": 9,
}


@cache
def sources() -> dict[str, str]:
    """Return the text of each file by its path in the package."""
    paths = sorted(SOURCE.rglob("*.py"))
    return {path.relative_to(SOURCE).as_posix(): path.read_text() for path in paths}


@cache
def definitions() -> list[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef]]:
    """Return each function and class with its file."""
    kinds = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
    return [
        (name, node)
        for name in sources()
        for node in nodes_of(SOURCE / name)
        if isinstance(node, kinds)
    ]


def functions() -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Yield the file and name of each function, and its syntax tree."""
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
def test_everything_larger_than_its_limit_is_listed_with_its_size(what):
    limit, listed, measure = SIZES[what]
    larger = {name: size for name, size in measure().items() if size > limit}
    assert larger == listed, f"{what}: at most {limit}; the list may only become shorter"


def test_no_two_public_classes_share_a_name():
    places = defaultdict(list)
    for name, node in definitions():
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            places[node.name].append(name)
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


def test_the_package_and_its_pages_do_not_exceed_their_recorded_size():
    """A change that needs more room raises the number here, and its commit says why."""
    assert sum(len(text.splitlines()) for text in sources().values()) <= MOST_LINES
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    texts = [page.read_text() for page in pages]
    by_hand = [text for text in texts if "<!-- `make reference` writes this page" not in text]
    assert len(by_hand) < len(texts)
    assert sum(len(text.split()) for text in by_hand) <= MOST_WORDS
