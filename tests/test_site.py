"""Code blocks of the docs are valid, and the site builds completely."""

import html
import json
import re
import shlex
import subprocess
import sys
import textwrap
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
import yaml

from graycast.cli.command import _parser

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
MATH = re.compile(r"<math.*?</math>", re.DOTALL)
FENCE = re.compile(r"^( *)```(\w+)\n(.*?)^\1```$", re.DOTALL | re.MULTILINE)


def blocks(*languages):
    """Yield (page, code) for the fenced blocks in some languages, also for blocks inside lists."""
    for page in PAGES:
        for _, language, code in FENCE.findall(page.read_text(encoding="utf-8")):
            if language in languages:
                yield page.relative_to(ROOT), textwrap.dedent(code)


def commands():
    """Yield each `graycast ...` command of the pages, with its backslashes joined."""
    for page, code in blocks("sh"):
        for line in code.replace("\\\n", " ").splitlines():
            for command in re.split(r"&&|;|\||>", re.sub(r"(^|\s)#.*", "", line)):
                words = shlex.split(command)
                if words and words[0] in ("graycast", ".venv/bin/graycast"):
                    yield page, words[1:]


def test_every_command_on_the_pages_is_accepted_by_the_parser():
    """Without this test, an old name of an option could stay on the pages."""
    lines = list(commands())
    assert len(lines) > 40
    for page, words in lines:
        try:
            _parser().parse_args(words)
        except SystemExit as stopped:
            assert stopped.code == 0, f"{page}: graycast {' '.join(words)}"


def test_every_python_and_yaml_block_can_be_parsed():
    for page, code in blocks("python"):
        compile(code, str(page), "exec")
    for _, code in blocks("yaml"):
        yaml.safe_load(code)
    for _, code in blocks("json"):
        json.loads(code)


def test_every_file_that_a_page_names_exists():
    """These are paths of the repository in code words: examples, configurations, scripts, ..."""
    named = re.compile(r"`((?:examples|configs|scripts|tests|docs|src)/[\w./-]+\.[a-z]+)`")
    for page in PAGES:
        for path in named.findall(page.read_text(encoding="utf-8")):
            assert (ROOT / path).exists(), f"{page.name} names {path}"


class Links(HTMLParser):
    """Collect the links, the loaded files and the anchors of a page."""

    def __init__(self, text):
        super().__init__()
        self.links, self.loads, self.anchors = [], [], {""}
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.anchors.update(attributes[key] for key in ("id", "name") if attributes.get(key))
        if tag == "a" and attributes.get("href"):
            self.links.append(attributes["href"])
        if tag in ("script", "img", "iframe") and attributes.get("src"):
            self.loads.append(attributes["src"])
        if tag == "link" and attributes.get("rel") in ("stylesheet", "icon", "preload"):
            self.loads.append(attributes["href"])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Return the folder of the site, which MkDocs must build without warnings."""
    pytest.importorskip("mkdocs", reason="needs MkDocs: pip install 'graycast[docs]'")
    folder = tmp_path_factory.mktemp("documentation") / "site"
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_the_site_is_built_without_warnings_and_needs_no_network(site):
    """Every link and anchor leads somewhere, nothing comes from a network, no equation is raw."""
    pages = {
        path.relative_to(site).as_posix(): Links(path.read_text(encoding="utf-8"))
        for path in site.rglob("*.html")
        if path.name != "404.html"  # The paths of this page begin at a server's root.
    }
    expected = {path.relative_to(ROOT / "docs").with_suffix(".html") for path in PAGES[2:]}
    assert {path.as_posix() for path in expected} <= set(pages)
    broken = []
    for name, page in pages.items():
        for link in page.links + page.loads:
            parts = urlsplit(link)
            if parts.scheme in ("http", "https", "mailto"):
                assert link not in page.loads, f"{name} loads {link}"
                continue
            base = (site / name).parent
            target = (base / unquote(parts.path)).resolve() if parts.path else None
            there = name if target is None else str(target.relative_to(site))
            if there in pages and unquote(parts.fragment) not in pages[there].anchors:
                broken.append(f"{name}: {link} has no such anchor")
            elif there not in pages and not (site / there).exists():
                broken.append(f"{name}: {link} is not there")
    assert not broken, "\n".join(broken)
    explanations = sorted((site / "explanation").glob("*.html"))
    equations = "".join(path.read_text(encoding="utf-8") for path in explanations)
    assert equations.count("<math") > 650
    assert "arithmatex" not in equations
    text = html.unescape(re.sub(r"<[^>]+>", " ", " ".join(MATH.findall(equations))))
    assert not re.findall(r"\\[A-Za-z]+", text), "the converter does not know these commands"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "expected"),
    [("settling votes", "reference/"), ("interreflection", "explanation/decoding.html")],
)
def test_the_search_field_works_in_a_site_opened_from_the_disk(site, browser, words, expected):
    """There, a browser starts no worker and fetches no file; nothing may come from a network."""
    with browser.new_page() as page:
        requests = []
        page.on("request", lambda request: requests.append(request.url))
        page.goto((site / "how-to/live.html").as_uri())
        page.wait_for_function("document.querySelector('iframe')")
        page.click("input.md-search__input")
        page.keyboard.type(words, delay=20)
        page.wait_for_selector(".md-search-result__item a")
        links = page.locator(".md-search-result__item a")
        urls = links.evaluate_all("all => all.map(a => a.href)")
        paths = [Path(urlsplit(url).path) for url in urls]
        assert any(path.relative_to(site).as_posix().startswith(expected) for path in paths)
        assert all(path.is_file() for path in paths)
        assert {urlsplit(url).scheme for url in requests} <= {"file", "data"}


def spec_of(section):
    """Return the name of the dataclass that the page shows for a section of the scanner."""
    return section.removesuffix("Section") + "Spec"


@pytest.mark.slow
def test_the_reference_shows_every_public_name(tmp_path):
    """Every public attribute of `graycast` is in the reference."""
    import graycast

    text = "\n".join(
        path.read_text(encoding="utf-8") for path in (ROOT / "docs/reference/api").glob("*.md")
    )
    entries = re.findall(r"^::: graycast\.([\w.]+)$", text, re.MULTILINE)
    modules = {
        name
        for name in entries
        if name in ("world.scene", "base.errors", "robot.pose", "robot.grasp")
    }
    whole = {
        name
        for name, module in graycast._MODULE.items()
        if module in modules
        or any(entry.split(".")[-1] in (name, spec_of(name)) for entry in entries)
    }
    assert set(graycast._MODULE) - whole == set()
