"""Numbers, paths, commands and the stated age of figures on the pages are correct."""

import argparse
import ast
import re
import shlex
import subprocess
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

import pytest

from benchmarks import __main__ as benchmarks
from graycast.cli.command import _parser

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
MEASUREMENTS = sorted((ROOT / "docs" / "measurements").glob("*.md"))
OLDER = ROOT / "docs" / "measurements" / "older.md"
FENCE = re.compile(r"^( *)```.*?^\1```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"!?\[([^\]]*)\]\(([^)\s]+)\)")
CODE = re.compile(r"`([^`]+)`")
# A number, with its unit if the unit is one of these.
NUMBER = re.compile(r"(?<![\w.,/-])\d[\d,]*(?:\.\d+)?(?: ?(?:%|mm|m|s|px|°)(?!\w))?")
COMMIT = re.compile(r"`([0-9a-f]{7,8})`")
DATE = re.compile(r"\b\d{4}-\d\d-\d\d\b|\b\d\d?( and \d\d?)? [A-Z][a-z]+ \d{4}\b")
# Numbers in the text that need no link to a measurement, with the reason.
UNMEASURED = {
    "3.11": "a version of Python, which pyproject.toml has",
    "3.13": "a version of Python, which pyproject.toml has",
    "2024": "the year of a paper",
    "68.27 %": "the share of a normal distribution within one sigma",
    "1": "one sigma",
}
PATH = re.compile(r"(?<![\w/.:-])[\w*-]+(?:/[\w.*-]+)*\.(?:py|js|ipynb)\b|(?<![\w/.-])[\w*./-]+")
# These files belong to other projects.
FOREIGN = {"dataset/bop_webdataset.py"}


def name_of(page):
    return page.relative_to(ROOT).as_posix()


def plain(text):
    return " ".join(text.split())


def statements(page):
    """Return each sentence and each table row of a page as one line."""
    text = FENCE.sub(" ", page.read_text(encoding="utf-8"))
    for block in re.split(r"\n\s*\n|\n(?=\s*[-*|] )", text):
        yield from re.split(r"(?<=[.:;]) (?=[A-Z*\[`])", plain(block))


def linked_text(page, target):
    """Return the text to which a link leads, or only one section if the link has an anchor."""
    path, _, anchor = target.partition("#")
    text = ((page.parent / path).resolve()).read_text(encoding="utf-8")
    if not anchor:
        return plain(text)
    for section in re.split(r"^(?=#+ )", text, flags=re.MULTILINE):
        heading = section.partition("\n")[0].lstrip("#").strip().lower()
        if re.sub(r"[^\w-]", "", heading.replace(" ", "-")) == anchor:
            return plain(section)
    raise AssertionError(f"{name_of(page)}: {target} leads to no section")


def missing_numbers(words, text):
    """Return the numbers of a sentence that a text does not contain with the same units."""
    numbers = NUMBER.findall(CODE.sub("", LINK.sub(lambda link: link[1], words)))
    return [
        number
        for number in numbers
        if number not in UNMEASURED
        and not re.search(rf"(?<![\w.,]){re.escape(number)}(?![\d%])(?!\.\d)", text)
    ]


def measured(page):
    """Yield (sentence, text of the linked measurements) for each sentence with such links."""
    for words in statements(page):
        targets = [to for _, to in LINK.findall(words) if "measurements/" in to]
        if targets:
            yield words, " ".join(linked_text(page, target) for target in targets)


def test_each_number_on_a_page_is_in_the_linked_measurement():
    pages = [page for page in PAGES if page.parent != OLDER.parent]
    cited = [(name_of(page), *one) for page in pages for one in measured(page)]
    assert sum(bool(NUMBER.search(words)) for _, words, _ in cited) >= 8
    wrong = {f"{page}: {words}": missing_numbers(words, text) for page, words, text in cited}
    assert {words: numbers for words, numbers in wrong.items() if numbers} == {}


def test_each_number_of_the_readme_has_a_link_to_its_measurement():
    readme = ROOT / "README.md"
    bare = [
        words
        for words in statements(readme)
        if not any("measurements/" in to for _, to in LINK.findall(words))
        and missing_numbers(words, "")
    ]
    assert bare == []


def test_a_wrong_number_is_detected():
    page = "Up to 10.2 % are wrong, at most 1.7 % with guards; 8.8 of 14 rows; 0.190 mm"
    assert missing_numbers("from 10.2 % to 1.7 %", page) == []
    assert missing_numbers("from 8.8 % to 1.4 %, 0.19 mm", page) == ["8.8 %", "1.4 %", "0.19 mm"]


@cache
def repository():
    """Return the top folders, and the paths of all files and folders, without output of runs."""
    tops = "src tests docs configs examples benchmarks studies scripts".split()
    candidates = [path for top in tops for path in (ROOT / top).rglob("*")]
    paths = [path for path in candidates if "__pycache__" not in path.parts]
    paths += [path for path in ROOT.iterdir() if path.is_file()]
    return tops, {path.relative_to(ROOT).as_posix() for path in paths} | set(tops)


def is_there(path):
    """Return whether a path, or its end, is in the repository; a star matches any characters."""
    paths = repository()[1]
    if "*" in path:
        return any(fnmatch(other, path) or fnmatch(other, f"*/{path}") for other in paths)
    return path in paths or any(other.endswith(f"/{path}") for other in paths)


def named_paths(text):
    """Yield the paths in a text: names of scripts, and paths that begin with a top folder."""
    for path in map(lambda match: match.rstrip("./"), PATH.findall(text)):
        is_script = re.search(r"\w\.(py|js|ipynb)$", path) and not path.startswith(("/", "."))
        if is_script or ("/" in path and path.split("/")[0] in repository()[0]):
            yield path


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_each_repository_path_on_a_page_exists(page):
    text = LINK.sub(lambda link: f"{link[1]} ", page.read_text(encoding="utf-8"))
    gone = {path for path in named_paths(text) if not is_there(path)} - FOREIGN
    assert gone == set()


def test_a_missing_path_is_detected():
    named = list(named_paths("`camera/finish.py`, `src/graycast/rig/`, see tests/rig/test_rig.py."))
    assert named == ["camera/finish.py", "src/graycast/rig", "tests/rig/test_rig.py"]
    assert [is_there(path) for path in named] == [False, True, True]
    assert is_there("studies/*_knobs.py") and not is_there("studies/*_knob.py")


def command_of(words):
    """Return the parser of the command at the start of the words, and the remaining words."""
    parser, rest = _parser(), list(words)
    while groups := [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]:
        if not rest or rest[0] not in groups[0].choices:
            return parser, rest
        parser = groups[0].choices[rest.pop(0)]
    return parser, rest


def test_each_command_within_a_sentence_exists_in_the_program():
    """Such a command may omit required arguments; another test parses whole commands."""
    count = 0
    for page in PAGES:
        text = FENCE.sub(" ", page.read_text(encoding="utf-8"))
        for command in re.findall(r"`graycast( [^`]+)`", text):
            words = shlex.split(command)
            if words[0] == "COMMAND":
                continue
            parser, rest = command_of(words)
            known = {flag for action in parser._actions for flag in action.option_strings}
            flags = {word.partition("=")[0] for word in rest if word.startswith("--")}
            assert flags <= known, f"{name_of(page)}: graycast{command}"
            is_group = any(isinstance(a, argparse._SubParsersAction) for a in parser._actions)
            assert not (is_group and rest and not flags), f"{name_of(page)}: graycast{command}"
            count += 1
    assert count > 60


def test_each_benchmark_and_each_study_on_a_page_exists():
    count = 0
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for line in re.findall(r"python -m\s+benchmarks\s+([^`\n#]*)", text):
            words = [word for word in shlex.split(line.replace(" REV", " main")) if word != "\\"]
            if words == ["--help"]:
                continue
            with pytest.raises(SystemExit) as stopped:
                benchmarks.parsed([words[0].rstrip(".,:;"), "--help"])
            assert stopped.value.code == 0, f"{name_of(page)}: python -m benchmarks {line}"
            count += 1
        for study in re.findall(r"python -m\s+studies\.(\w+)", text):
            tree = ast.parse((ROOT / "studies" / f"{study}.py").read_text(encoding="utf-8"))
            assert any(isinstance(n, ast.FunctionDef) and n.name == "main" for n in tree.body)
            count += 1
    assert count > 20


def test_each_make_target_on_a_page_exists():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    texts = [page.read_text(encoding="utf-8") for page in PAGES]
    blocks = "\n".join(block[0] for text in texts for block in FENCE.finditer(text))
    inline = "\n".join(CODE.findall(" ".join(FENCE.sub(" ", text) for text in texts)))
    named = set(re.findall(r"^make ([\w-]+)", f"{blocks}\n{inline}", re.MULTILINE))
    assert {"demo", "test"} < named
    assert {goal for goal in named if not re.search(rf"^{goal}:", makefile, re.M)} == set()


@pytest.mark.parametrize("page", [p for p in MEASUREMENTS if p != OLDER], ids=lambda p: p.stem)
def test_each_table_of_measurements_states_its_commit_and_date(page):
    """Commit and date may be in the table's section, or before the first section."""
    start, *sections = re.split(r"^(?=## )", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    for section in sections or [""]:
        if "\n|" in section or not sections:
            own = start + section
            assert COMMIT.search(own), f"{section.splitlines()[:1]} names no commit"
            assert DATE.search(own), f"{section.splitlines()[:1]} names no date"


def changes():
    """Yield (commit, cell of changed figures, cell of unchanged figures) from older.md."""
    rows = [line for line in OLDER.read_text(encoding="utf-8").splitlines() if "20" in line[:25]]
    for row in rows:
        _, change, moved, unmoved, _ = row.split("|")
        yield COMMIT.findall(change)[0], moved, unmoved


def commits_of(page):
    """Return the commits of a page's figures, except those in the remark on their age."""
    remark = re.compile(r"\*[^*]*older\.md[^*]*\*", re.DOTALL | re.IGNORECASE)
    return set(COMMIT.findall(remark.sub("", page.read_text(encoding="utf-8"))))


def test_exactly_the_listed_pages_say_that_their_figures_are_older():
    listed = {}
    for change, moved, _ in changes():
        for target, commits in re.findall(r"\]\((\S+?)\)([^\[]+)", moved):
            page = OLDER.parent / target
            assert set(COMMIT.findall(commits)) <= commits_of(page), f"{target}: {commits}"
            listed.setdefault(target, set()).add(change)
    for page in MEASUREMENTS:
        text = plain(page.read_text(encoding="utf-8"))
        stated = set()
        for remark in re.findall(r"\*[^*]*older\.md[^*]*\*", text, re.IGNORECASE):
            stated |= set(COMMIT.findall(remark))
        assert page == OLDER or stated == listed.get(page.name, set()), page.name


def git(*words):
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)


def test_figures_older_than_a_change_are_listed():
    """Each commit of figures that lacks the change is listed in one of the two columns."""
    if git("cat-file", "-e", "6f6a6da").returncode:
        pytest.skip("the history of the repository is not here")
    for change, moved, unmoved in changes():
        since = git("rev-list", "--ancestry-path", f"{change}^..HEAD").stdout.split()
        for page in MEASUREMENTS:
            if page == OLDER:
                continue
            for commit in commits_of(page):
                has_change = any(other.startswith(commit) for other in since)
                listed = f"`{commit}`" in moved + unmoved
                assert has_change != listed, f"{page.name}: `{commit}` and the change {change}"
