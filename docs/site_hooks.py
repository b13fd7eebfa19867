"""What the site needs beside MkDocs: the pages that are made from the models and the parser, and
equations as MathML, which browsers draw without a script.
"""

import html
import re
from typing import Any

import reference_pages
from latex2mathml.converter import convert
from mkdocs.config import Config
from mkdocs.structure.files import File, Files

_EQUATION = re.compile(r'<(span|div) class="arithmatex">(\\[(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_files(files: Files, config: Config) -> Files:
    """Add the pages of the reference that no file holds."""
    for path, text in reference_pages.pages().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_content(content: str, **_: Any) -> str:
    """Turn each equation that `pymdownx.arithmatex` has found into MathML."""
    return _EQUATION.sub(_math, content)


def _math(found: re.Match[str]) -> str:
    block = found[2] == r"\["
    equation = convert(html.unescape(found[3]).strip(), display="block" if block else "inline")
    return f'<div class="equation">{equation}</div>' if block else equation
