"""Studies and their pages link to each other, and importing a study does no work."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / "studies").glob("[!_]*.py"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_study_and_its_pages_link_to_each_other(file):
    tree = ast.parse(file.read_text(encoding="utf-8"))
    work = (ast.Expr, ast.For, ast.While, ast.With)
    assert not [node for node in tree.body[1:] if isinstance(node, work)]
    if not any(isinstance(node, ast.FunctionDef) and node.name == "main" for node in tree.body):
        return  # a module that studies and tests share
    docstring = ast.get_docstring(tree)
    assert f"python -m studies.{file.stem}" in docstring
    pages = re.findall(r"docs/[\w/-]+\.md", docstring)
    named = [page for page in pages if f"studies.{file.stem}" in text(page).replace("/", ".")]
    assert pages and named == pages


def text(page):
    return (ROOT / page).read_text(encoding="utf-8").replace("\n", " ")
