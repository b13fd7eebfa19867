"""Links on the repository's own pages lead to files and headings that exist in a clone.

Hosts of repositories show these pages without running `make docs`.
"""

import json
import os.path
import re
import subprocess
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).resolve().parents[1]
FENCE = re.compile(r"^( *)(```|~~~).*?^\1\2 *$", re.DOTALL | re.MULTILINE)
CODE = re.compile(r"(`+)(?!`).+?(?<!`)\1(?!`)", re.DOTALL)
LINK = re.compile(
    r"\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)|^ *\[[^\]]+\]:\s+(\S+)", re.MULTILINE
)
# This pattern finds mentions of pages in comments, errors, help texts and settings.
MENTION = re.compile(r"(?<![\w./-])docs/[\w/-]+\.md(?:#[\w.-]+)?")
FOREIGN = {"docs/bop_datasets_format.md"}  # This page belongs to the BOP toolkit.


@cache
def files():
    """Return the paths of all files that a clone of this working tree would have."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip("the history of the repository is not here")
    return {path for path in done.stdout.splitlines() if (ROOT / path).exists()}


class Tags(HTMLParser):
    """The anchors and the links in the HTML of a page."""

    def __init__(self, text):
        super().__init__()
        self.anchors, self.links = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        known = {key: value for key, value in attrs if value}
        self.anchors += [known[key] for key in ("id", "name") if key in known]
        self.links += [known[key] for key in ("href", "src") if key in known]


def links_of(text):
    """Return the targets of a page's links and pictures, without those in its code examples."""
    plain = CODE.sub(" ", FENCE.sub(" ", text))
    return [a or b for a, b in LINK.findall(plain)] + Tags(plain).links


def anchors_of(text):
    """Return the anchors of a page: those of its headings, as hosts make them, and its own."""
    plain = FENCE.sub(" ", text)
    anchors, counts = set(Tags(CODE.sub(" ", plain)).anchors), {}
    for heading in re.findall(r"^#{1,6} +(.+?)(?: +#+)? *$", plain, re.MULTILINE):
        words = re.sub(r"<[^>]+>", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading))
        slug = re.sub(r"[^\w\- ]", "", words.strip().lower()).replace(" ", "-")
        anchors.add(f"{slug}-{counts[slug]}" if slug in counts else slug)
        counts[slug] = counts.get(slug, 0) + 1
    return anchors


@cache
def anchors_in(path):
    return anchors_of((ROOT / path).read_text(encoding="utf-8"))


def fault(page, link, paths):
    """Return the fault of a link on a page; the text is empty if the link works."""
    parts = urlsplit(link)
    if parts.scheme or parts.netloc:
        return ""
    path = page
    if parts.path:
        path = os.path.normpath(os.path.join(os.path.dirname(page), unquote(parts.path)))
    if path not in paths and not any(other.startswith(f"{path}/") for other in paths):
        return f"{page} {link} is not in a clone"
    if parts.fragment and path.endswith(".md") and parts.fragment not in anchors_in(path):
        return f"{page} {link} has no such heading or anchor"
    return ""


def pages():
    return sorted(path for path in files() if path.endswith(".md"))


def test_each_link_on_a_page_leads_to_an_existing_file_and_heading():
    paths, count, faults = files(), 0, []
    for page in pages():
        for link in links_of((ROOT / page).read_text(encoding="utf-8")):
            count += 1
            faults.append(fault(page, link, paths))
    assert count > 250
    assert [words for words in faults if words] == []


def test_each_link_in_a_notebook_leads_to_a_file_in_the_repository():
    notebooks = sorted(path for path in files() if path.endswith(".ipynb"))
    assert notebooks
    for path in notebooks:
        cells = json.loads((ROOT / path).read_text(encoding="utf-8"))["cells"]
        text = "\n\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
        assert [words for link in links_of(text) if (words := fault(path, link, files()))] == []


def test_each_page_named_by_a_comment_error_or_help_text_is_in_the_repository():
    kinds = (".py", ".js", ".yaml", ".sh", ".md", ".toml", "Makefile")
    named = [
        (path, mention)
        for path in sorted(files())
        if (path.endswith(kinds) or path.startswith("scripts/")) and path != "tests/test_links.py"
        for mention in MENTION.findall((ROOT / path).read_text(encoding="utf-8"))
    ]
    assert len(named) > 20
    own = [(path, mention) for path, mention in named if mention not in FOREIGN]
    faults = [f"{path} names {words}" for path, to in own if (words := fault("", to, files()))]
    assert faults == []


def test_a_broken_link_is_detected():
    text = (
        "# Some title\n\n## Some title\n\n[a](b.md#no) ![c](d.png) `[e](f)`\n\n<img src='g.png'>\n"
    )
    assert links_of(text) == ["b.md#no", "d.png", "g.png"]
    assert anchors_of(text + "\n<a id='x.y--z'></a>\n") == {"some-title", "some-title-1", "x.y--z"}
    assert fault("docs/index.md", "../out/site/index.html", files()).endswith("not in a clone")
    assert fault("docs/index.md", "tutorial.md#no", files()).endswith("no such heading or anchor")
    assert fault("docs/index.md", "../../elsewhere.md", files()).endswith("not in a clone")
    assert fault("docs/index.md", "../README.md#install", files()) == ""
