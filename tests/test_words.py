"""Check that names in the code use the terms of CONTRIBUTING.md."""

import ast
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from parsed import nodes_of

ROOT = Path(__file__).resolve().parents[1]

# Names that still contain an unwanted word (keys and outcomes in files), with the number of their
# definitions. These numbers may only decrease.
REMAINING = {
    "COLLISION_SEEN": 1,
    "COLLISION_UNSEEN": 1,
    "GIVEN_UP": 1,
    "NOTHING_FOUND": 1,
    "NOT_HELD": 1,
    "_held_until": 1,
    "found": 2,
    "held": 1,
    "held_until_s": 1,
    "seen": 2,
    "seen_px": 1,
    "shown": 6,
}


def defined(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Yield the names that a file defines: functions, parameters, variables and so on."""
    for node in nodes:
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                yield name
            case ast.ClassDef(name=name) | ast.arg(arg=name):
                yield name
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name
            case ast.alias(asname=str(name)) | ast.ExceptHandler(name=str(name)):
                yield name


def parts(name: str) -> set[str]:
    """Return the words of a name in lower case."""
    return {word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)}


def unused_words() -> set[str]:
    """Return the words in the third column of the table in CONTRIBUTING.md."""
    table = re.findall(r"^\|[^|]+\|[^|]+\|([^|]+)\|$", (ROOT / "CONTRIBUTING.md").read_text(), re.M)
    return {word for cell in table for word in re.findall(r"`(\w+)`", cell)}


def names_with(words: set[str], *folders: str) -> Counter[str]:
    """Count the definitions in folders of names with an unwanted word, except test names."""
    files = {file for folder in folders for file in (ROOT / folder).rglob("*.py")}
    names = Counter(name for file in files - {Path(__file__)} for name in defined(nodes_of(file)))
    left = {name for name in names if parts(name) & words and not name.startswith("test_")}
    return Counter({name: names[name] for name in left})


def test_no_name_in_the_package_has_an_unwanted_word():
    """The unwanted words are read from the table in CONTRIBUTING.md."""
    words = unused_words()
    assert {"told", "held", "seen"} <= words
    left = names_with(words, "src/graycast")
    assert left <= Counter(REMAINING), "say what these are, in the words of CONTRIBUTING.md"
    assert set(REMAINING) <= set(left), "take out of REMAINING what is gone"


@pytest.mark.slow
def test_no_name_in_tests_or_studies_has_an_unwanted_word():
    assert not names_with(unused_words(), "tests", "benchmarks", "studies", "examples")


def test_names_are_read_from_every_kind_of_definition():
    text = """
def told(said, *held, **seen): ...
class JudgedPose: laid: int
for shown in (): self._kept = [made for made in ()]
with open(x) as asked: pass
"""
    names = set(defined(ast.walk(ast.parse(text))))
    assert names == {
        *("told", "said", "held", "seen", "JudgedPose", "laid", "shown"),
        *("_kept", "made", "asked"),
    }
    assert parts("JudgedPose") == {"judged", "pose"} and parts("_HELD_px") == {"held", "px"}
    assert parts("retold") == {"retold"}
