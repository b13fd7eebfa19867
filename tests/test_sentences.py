"""Check sentences of the code and the docs: a docstring begins with what the function does.

`test_words.py` checks names; this file checks sentences. A table counts unwanted phrases that
remain, and its numbers may only fall.
"""

import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GENERATED = "<!-- `make reference` writes this page"  # Such a page has the words of the source.

# A docstring begins with a verb ("Return the header of a PLY file.") or, for a property or a class,
# with a noun. These words begin a clause that has no verb of its own. "Whether" is allowed, because
# "Whether the part is at rest." is a common way to describe a boolean.
# The text is searched, because parsing all tests would take ten times as long.
OPENING = re.compile(r'^ *r?"""(Of|What|Which|As|So many|By|How|Where)\b', re.MULTILINE)

# Phrases that a technical writer would replace, and their numbers in the source and in the docs.
# Write "as many as", "others'", "no one", "again", "next to" or "with", "the value that ...".
PHRASES_LEFT = {
    "alike": (43, 0),
    "anew": (0, 1),
    "are none": (5, 0),
    "as far as": (4, 1),
    "as it was": (1, 0),
    "beside": (84, 2),
    "by itself": (1, 0),
    "by turns": (0, 0),
    "has none": (9, 1),
    "have none": (5, 0),
    "in the place of": (0, 0),
    "is asked": (0, 0),
    "is none": (22, 0),
    "let go": (0, 0),
    "lies": (32, 1),
    "nobody": (4, 0),
    "none of": (10, 0),
    "of another": (40, 1),
    "of others": (2, 1),
    "one's": (1, 0),
    "so far as": (0, 0),
    "so many": (2, 0),
    "so much": (1, 0),
    "somebody": (0, 0),
    "stands": (43, 0),
    "tells": (13, 1),
    "that is to say": (0, 0),
    "told": (1, 2),
    "what is": (15, 5),
    "what stands": (0, 0),
    "what was": (4, 6),
    "whatever": (5, 0),
    "which one": (1, 0),
    "whoever": (1, 0),
}


def room_of(file: Path) -> str:
    """Return the room of a file, such as "src/graycast/camera" or "tests/camera"."""
    depth = 3 if file.is_relative_to(ROOT / "src") else 2
    return "/".join(file.relative_to(ROOT).parent.parts[:depth])


def openings() -> Counter[str]:
    """Count, for each room, the docstrings that begin with a word of `OPENING`."""
    files = [file for top in ("src/graycast", "tests") for file in (ROOT / top).rglob("*.py")]
    counts: Counter[str] = Counter()
    for file in set(files) - {Path(__file__)}:
        counts[room_of(file)] += len(OPENING.findall(file.read_text(encoding="utf-8")))
    return +counts


def read(file: Path) -> str:
    """Return the text of a file."""
    return file.read_text(encoding="utf-8")


def in_one_line(text: str) -> str:
    """Join the lines of a text, and drop the "#" of a comment that continues in the next line."""
    return re.sub(r"\s+(?:# )?", " ", text)


def phrases(text: str) -> Counter[str]:
    """Count the phrases of the table in a text; a phrase may begin with a capital letter."""
    first_letters = (f"[{name[0].upper()}{name[0]}]{name[1:]}" for name in PHRASES_LEFT)
    any_phrase = re.compile(rf"\b(?:{'|'.join(first_letters)})\b")  # `x is None` does not match.
    return Counter(match[0].lower() for match in any_phrase.finditer(in_one_line(text)))


def phrases_of_source_and_docs() -> dict[str, tuple[int, int]]:
    """Count each phrase in the source and in the docs (README and CHANGELOG included)."""
    source = sorted((ROOT / "src/graycast").rglob("*.py"))
    pages = [*sorted((ROOT / "docs").rglob("*.md")), *sorted(ROOT.glob("*.md"))]
    in_source, in_docs = (
        phrases("\n".join(text for text in map(read, files) if GENERATED not in text))
        for files in (source, pages)
    )
    return {name: (in_source[name], in_docs[name]) for name in PHRASES_LEFT}


def test_no_docstring_begins_with_a_bare_clause():
    assert not openings(), "begin with a verb ('Return ...') or, for a property, with a noun"


def test_no_phrase_becomes_more_frequent():
    more = {
        name: (counts, PHRASES_LEFT[name])
        for name, counts in phrases_of_source_and_docs().items()
        if any(now > limit for now, limit in zip(counts, PHRASES_LEFT[name], strict=True))
    }
    assert not more, "(source, docs) now and at most: say it in plain English"


def test_docstrings_are_read_at_every_place_in_a_file():
    text = '''"""Of a module."""
class Surface:
    """What a class is."""
    def area_m2(self):
        """Return the area."""
    def edge(self):
        r"""How long it is.
        Where it ends.
        """
def plain():
    """Offset of the plane."""
def level():
    """Whether it is level."""
'''
    assert OPENING.findall(text) == ["Of", "What", "How"]


def test_phrases_are_read_across_lines_and_comments():
    text = "# Nobody reads so\n    # many; there is none.\nx is None\n\n'''told so\n    much'''"
    assert phrases(text) == {"nobody": 1, "so many": 1, "is none": 1, "told": 1, "so much": 1}
