"""Writes the equations of the site as MathML, which browsers draw without a script."""

import html
import re
from typing import Any

from latex2mathml.converter import convert

_EQUATION = re.compile(r'<(span|div) class="arithmatex">(\\[(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_page_content(content: str, **_: Any) -> str:
    """Turn each equation that `pymdownx.arithmatex` has found into MathML."""
    return _EQUATION.sub(_math, content)


def _math(found: re.Match[str]) -> str:
    block = found[2] == r"\["
    equation = convert(html.unescape(found[3]).strip(), display="block" if block else "inline")
    return f'<div class="equation">{equation}</div>' if block else equation
