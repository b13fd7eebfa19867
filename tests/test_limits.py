"""Limit the size of the project, so that one person can still understand it as a whole.

Each number is the present size of the project. It may be reduced at any time. A commit that
increases it must say why.
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

# The package had 74,160 lines before a search for code to remove, and 71,766 after it. Each
# addition needs a reason here, with its lines. Additions that end silent errors: 1,000 for reading
# or refusing labels, depth and models of other tools; 450 for checks that a continued run has the
# same inputs; 400 for detecting a calibration whose devices moved; 350 for compiling kernels by a
# digest of their sources; 250 for checking the arguments of the Python interface; 250 for the
# sources of the numbers of scanners; 1,000 for detecting motion, brightness changes, a wrong order
# or computed pictures in a stack. Other additions: 350 for the choice of exposures and advice on
# depth; 350 for the choice of a scanner that a bin fills; 450 for printing public values, refusing
# unknown keywords, and users' own codes; 350 for larger drawings with separate legends and names;
# 400 for reports of settings without effect, compiled ray-plane loops, refusal of millimetres, and
# whole fingers of jaws; 200 for exchanged phase pictures; 60 for a camera that moves within a
# stack. Then 2,100 lines were removed: checks for forged files, films, RF-DETR, labels and arms as
# code, and two layouts of exports. Then came 1,000 for fitting a material to a scan; 350 for
# scattering and varying reflectance of metal; 100 for smooth normals of staged surfaces; 400 for
# planes in highlights and fitted mottle; 300 for dividing a scan into materials; and 100 for names
# of array types in editors. Then came 1,000 for the probability of a wrong depth, its evidence and
# its use by datasets, clouds, merges, grips and detectors; and 200 for fits of materials in Python,
# from pictures, and with plain Gray codes. Then came 50 for folders within `dataset` and
# `robot.pick`, whose docstrings list their modules. Then came 1,700 for hand-eye calibration: two
# thirds of it read scans and poses and name mistakes; 600 for a virtual scanner and the bin below
# it; 500 for ROS 2 bags, recordings of rerun and folders of pose demos; and 100 for doubtful
# positions of stacks without a rig and for checks in several processes. Then came 450 for a scanner
# that replays bags and for lists of settings; 750 for motion while pictures are taken, half of it
# in the decoder; and 100 for checks that print each problem at once. Then came 350 for workers of
# exports, and 500 for parts that move on their own and a steady motion estimated from pictures.
MOST_LINES = 85_200
# This is the number of words in README.md and in the pages of docs that people write. 44,000 words
# describe the program without the materials of scans. 1,800 were added for fitting and using a
# material, tables of materials and classes, a repeated scan of metal, and depth at edges. 3,400
# came with tables of materials for two more rigs, pictures of a PhoXi, and the probability of a
# wrong depth; a third of them are cells of tables. 800 came with the comparison of decoders and
# with polished metal; half of them are cells of tables. 1,600 came with hand-eye calibration, the
# virtual scanner, bags, doubtful positions, and detectors trained with a fitted surface. 900 came
# with motion during a scan, replayed bags, and the value of the probability for robots.
MOST_WORDS = 53_000
FILE_LINES, FUNCTION_LINES, ARGUMENTS = 400, 80, 8

# These are the exceptions with their sizes; the last arguments of a run report its progress.
LONG_FILES: dict[str, int] = {}
LONG_FUNCTIONS: dict[str, int] = {}
MANY_ARGUMENTS = {
    "cell/generate.py generate": 9,
    "robot/grasp_labels/label_run.py label_dataset": 9,
    "robot/pick/results/pick_run.py pick": 9,
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


def scripts() -> list[str]:
    """Return the paths in the package of the pages' scripts, and of the files with their types."""
    paths = [*SOURCE.rglob("*.js"), *SOURCE.rglob("*.ts")]
    return [path.relative_to(SOURCE).as_posix() for path in paths]


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
    "lines of a page's script": (
        FILE_LINES,
        {},
        lambda: {name: len((SOURCE / name).read_text().splitlines()) for name in scripts()},
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
    """A change that needs more lines or words raises the limit, and its commit says why."""
    assert sum(len(text.splitlines()) for text in sources().values()) <= MOST_LINES
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    texts = [page.read_text() for page in pages]
    by_hand = [text for text in texts if "<!-- `make reference` writes this page" not in text]
    assert len(by_hand) < len(texts)
    assert sum(len(text.split()) for text in by_hand) <= MOST_WORDS
