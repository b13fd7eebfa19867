"""Syntax trees of the source for tests; each file is parsed once per process."""

import ast
from functools import cache
from pathlib import Path


@cache
def tree_of(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


@cache
def nodes_of(file: Path) -> tuple[ast.AST, ...]:
    """Return all nodes of the file's syntax tree."""
    return tuple(ast.walk(tree_of(file)))
